//! Which old runs may go, and how one is removed.
//!
//! # Invariants
//!
//! * Only directories that lie in the directory of runs and hold a record are looked at. A symbolic link is none of them,
//!   and nothing that a link points to is touched.
//! * A run that a learner or a supervisor has open stays. Its locks are held while it is removed, so nobody takes it up.
//! * A run leaves the list in one step: it is renamed before it is removed. What a removal that was killed has left goes with the
//!   next one.
//! * Where the best runs stay, so do those that cannot be compared: each of them may be the best. One whose weights are gone is
//!   none, even where it is alone.

use std::collections::BTreeMap;
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use leadtime_config::identity;
use serde::Serialize;

use crate::contents::{CHECKPOINTS, checkpoints};
use crate::evaluation_record::LAST_EVALUATION;
use crate::journal::JOURNAL;
use crate::layout::{LOCK, REMOVED, SUPERVISOR_LOCK, is_left, read_config};
use crate::record::RECORD;
use crate::{ListedRun, RunRecord, clock, held_out, journal, policy_file, regular};

/// Files whose time says when something last happened in a run.
const SIGNS: [&str; 3] = [RECORD, JOURNAL, LAST_EVALUATION];

/// Which runs may go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PruneRule {
    /// Nothing has happened in them for so long.
    pub older: Duration,
    /// Of the runs of one configuration, whatever their seeds, the best one stays.
    pub keep_best: bool,
}

/// Why an old run stays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StaysBecause {
    /// A learner or a supervisor has it open.
    InUse,
    /// It is the best of its configuration.
    Best,
    /// Its files cannot be read, or end before the run did, so it may be the best of its configuration.
    Unreadable,
    /// It was to be removed, and could not be.
    CannotRemove,
}

/// A run that is old enough to be removed, or what is left of one.
#[derive(Clone, Debug, Serialize)]
pub struct OldRun {
    /// Its name in the directory of runs.
    pub name: String,
    /// Days since something happened in it.
    pub days: u64,
    /// Bytes of its files.
    pub bytes: u64,
    /// Why it stays, if it does.
    pub stays: Option<StaysBecause>,
}

/// Lists the old runs of a directory, by name.
///
/// # Errors
///
/// If the directory cannot be read.
pub fn old_runs(runs: &Path, rule: PruneRule) -> io::Result<Vec<OldRun>> {
    let mut all: Vec<(String, PathBuf)> = Vec::new();
    regular::refuse_dead_link(runs)?;
    for entry in fs::read_dir(runs)? {
        let entry = entry?;
        let name = entry.file_name().into_string();
        // `file_type` does not follow links.
        if let (true, Ok(name)) = (entry.file_type()?.is_dir(), name)
            && (is_left(&name) || entry.path().join(RECORD).is_file())
        {
            all.push((name, entry.path()));
        }
    }
    all.sort();
    let best = if rule.keep_best { best_of_each(&all) } else { BTreeMap::new() };
    let old = all.into_iter().filter_map(|(name, path)| {
        let is_left = is_left(&name);
        let age = age(&path).or(is_left.then_some(Duration::ZERO))?;
        (is_left || age >= rule.older).then(|| OldRun {
            stays: if is_in_use(&path) {
                Some(StaysBecause::InUse)
            } else {
                best.get(&name).copied()
            },
            days: age.as_secs() / (24 * 3_600),
            bytes: size(&path),
            name,
        })
    });
    Ok(old.collect())
}

/// Removes a run. Returns false if somebody has it open meanwhile.
///
/// # Errors
///
/// If it cannot be renamed or removed.
pub fn remove(runs: &Path, run: &OldRun) -> io::Result<bool> {
    let path = runs.join(&run.name);
    if !path.symlink_metadata()?.is_dir() {
        return Ok(false);
    }
    let Some(_locks) = locks(&path) else { return Ok(false) };
    let removed = if is_left(&run.name) {
        path
    } else {
        let removed = runs.join(format!("{REMOVED}{}", run.name));
        if removed.symlink_metadata().is_ok_and(|found| found.is_dir()) {
            fs::remove_dir_all(&removed)?;
        }
        fs::rename(&path, &removed)?;
        removed
    };
    fs::remove_dir_all(&removed)?;
    Ok(true)
}

/// Returns how long ago something happened in a run; `None` if that is not known.
fn age(path: &Path) -> Option<Duration> {
    let modified =
        |name: &&str| path.join(name).symlink_metadata().and_then(|it| it.modified()).ok();
    SIGNS.iter().filter_map(modified).max().map(clock::time_since)
}

/// Tells whether a learner, a supervisor or another process has a run open.
pub fn is_in_use(path: &Path) -> bool {
    locks(path).is_none()
}

/// Takes the locks that a run has; `None` if somebody else has one of them.
fn locks(path: &Path) -> Option<Vec<File>> {
    let mut held = Vec::new();
    for name in [SUPERVISOR_LOCK, LOCK, &format!("{CHECKPOINTS}/{LOCK}")] {
        let file = path.join(name);
        // Opening something else than a file, such as a pipe, could wait for ever.
        if !file.symlink_metadata().is_ok_and(|found| found.is_file()) {
            continue;
        }
        let file = File::open(file).ok()?;
        match file.try_lock() {
            Ok(()) => held.push(file),
            Err(TryLockError::WouldBlock | TryLockError::Error(_)) => return None,
        }
    }
    Some(held)
}

/// Names the best run of each configuration, by held-out episodes where it has some, else by its training episodes; and those
/// that may be it, because they cannot be read. One without weights is none.
fn best_of_each(runs: &[(String, PathBuf)]) -> BTreeMap<String, StaysBecause> {
    let mut stays = BTreeMap::new();
    let mut best: BTreeMap<[u8; 32], (f64, String)> = BTreeMap::new();
    for (name, path) in runs.iter().filter(|(name, _)| !is_left(name)) {
        let (Ok(config), Ok(record), Ok(told)) =
            (read_config(path), RunRecord::read(path), journal::last(path, "update"))
        else {
            stays.insert(name.clone(), StaysBecause::Unreadable);
            continue;
        };
        let listed = ListedRun::new(path, record);
        let has_weights =
            policy_file::is_in(path) || !checkpoints(path).is_ok_and(|found| found.is_empty());
        if !has_weights {
            continue;
        }
        // Its best policy is gone or damaged, and its checkpoints may hold it; or a full disk let its files end before the run did.
        let is_known = listed.held_out.is_some() || held_out::read(path).is_empty();
        if !is_known || (listed.held_out.is_none() && told < listed.updates) {
            stays.insert(name.clone(), StaysBecause::Unreadable);
            continue;
        }
        let score = listed.held_out.or(listed.success).or(listed.episode_return);
        let score = score.unwrap_or(f64::NEG_INFINITY);
        let entry = best.entry(identity::of_training(&config));
        let found = entry.or_insert_with(|| (score, name.clone()));
        if score > found.0 {
            *found = (score, name.clone());
        }
    }
    stays.extend(best.into_values().map(|(_, name)| (name, StaysBecause::Best)));
    stays
}

/// Adds up the files of a directory; links count as nothing.
fn size(path: &Path) -> u64 {
    let (mut bytes, mut open) = (0, vec![path.to_owned()]);
    while let Some(directory) = open.pop() {
        for entry in fs::read_dir(directory).into_iter().flatten().filter_map(Result::ok) {
            match entry.metadata() {
                Ok(found) if found.is_dir() => open.push(entry.path()),
                Ok(found) if found.is_file() => bytes += found.len(),
                _ => {}
            }
        }
    }
    bytes
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;
    use crate::RunResult;

    const ALL: PruneRule = PruneRule { older: Duration::ZERO, keep_best: false };

    fn make(runs: &Path, name: &str) -> PathBuf {
        let path = runs.join(name);
        fs::create_dir_all(path.join(CHECKPOINTS)).unwrap();
        fs::write(path.join(RECORD), "{}").unwrap();
        path
    }

    fn names(runs: &Path, rule: PruneRule) -> Vec<(String, Option<StaysBecause>)> {
        let found = old_runs(runs, rule).unwrap();
        found.into_iter().map(|run| (run.name, run.stays)).collect()
    }

    #[test]
    fn only_runs_in_the_directory_are_found_and_no_link_is_followed() {
        let (runs, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let precious = make(elsewhere.path(), "precious");
        make(runs.path(), "a");
        symlink(&precious, runs.path().join("link")).unwrap();
        symlink(&precious, runs.path().join("a/inside")).unwrap();
        fs::create_dir(runs.path().join("notes")).unwrap();
        fs::write(runs.path().join("file"), "x").unwrap();
        assert_eq!(names(runs.path(), ALL), [("a".to_owned(), None)]);
        let run = old_runs(runs.path(), ALL).unwrap().remove(0);
        assert_eq!(run.bytes, 2, "what a link points to is not counted");
        assert!(remove(runs.path(), &run).unwrap());
        assert!(!runs.path().join("a").exists() && precious.join(RECORD).exists());
        let linked = OldRun { name: "link".to_owned(), ..run };
        assert!(!remove(runs.path(), &linked).unwrap());
        assert!(precious.join(RECORD).exists() && runs.path().join("link").exists());
        let left = fs::read_dir(runs.path()).unwrap().count();
        assert_eq!(left, 3, "a link, a file, a directory");
    }

    #[test]
    fn a_young_run_is_not_listed_and_an_open_one_stays() {
        let runs = tempfile::tempdir().unwrap();
        let path = make(runs.path(), "a");
        let day = PruneRule { older: Duration::from_hours(24), ..ALL };
        assert_eq!(names(runs.path(), day), []);
        for name in [SUPERVISOR_LOCK, LOCK, "checkpoints/lock"] {
            let lock = File::create(path.join(name)).unwrap();
            lock.lock().unwrap();
            assert_eq!(names(runs.path(), ALL), [("a".to_owned(), Some(StaysBecause::InUse))]);
            let run = old_runs(runs.path(), ALL).unwrap().remove(0);
            assert!(!remove(runs.path(), &run).unwrap());
            drop(lock);
        }
        assert_eq!(names(runs.path(), ALL), [("a".to_owned(), None)]);
    }

    #[test]
    fn leftovers_of_a_killed_removal_go_with_the_next_one() {
        let runs = tempfile::tempdir().unwrap();
        make(runs.path(), "a");
        // The record may be gone already.
        fs::create_dir_all(runs.path().join(".removed-a/checkpoints")).unwrap();
        fs::create_dir_all(runs.path().join(".removed-b/checkpoints")).unwrap();
        assert_eq!(ListedRun::all(runs.path()).unwrap().len(), 1);
        let day = PruneRule { older: Duration::from_hours(24), keep_best: true };
        let left = [".removed-a", ".removed-b"].map(|name| (name.to_owned(), None::<StaysBecause>));
        assert_eq!(names(runs.path(), day), left);
        let run = old_runs(runs.path(), ALL).unwrap().pop().unwrap();
        assert_eq!(run.name, "a");
        assert!(remove(runs.path(), &run).unwrap(), "what is left of an older one is in the way");
        let run = old_runs(runs.path(), day).unwrap().pop().unwrap();
        assert!(remove(runs.path(), &run).unwrap());
        assert_eq!(fs::read_dir(runs.path()).unwrap().count(), 0);
    }

    #[test]
    fn the_best_of_each_configuration_stays() {
        let runs = tempfile::tempdir().unwrap();
        for (name, seed, rate, success) in
            [("a", 1, 0.1, 0.5), ("b", 2, 0.1, 0.9), ("c", 3, 0.1, 0.7), ("d", 1, 0.2, 0.1)]
        {
            let path = make(runs.path(), name);
            let config = format!("seed = {seed}\n[learner]\nlearning_rate = {rate}\n");
            fs::write(path.join("config.toml"), config).unwrap();
            let record = serde_json::json!({
                "format": 1, "name": name, "domain": "lander", "seed": seed, "version": "0.1.0", "commit": null,
                "cpu": "c", "threads": "1", "started": "2026-01-01T00:00:00Z", "resumed": 0, "result": null,
            });
            fs::write(path.join(RECORD), record.to_string()).unwrap();
            let line = format!("{{\"update\": 1, \"episodes/success\": {success}}}\n");
            fs::write(path.join("metrics.jsonl"), line).unwrap();
            fs::write(path.join("policy.safetensors"), "weights").unwrap();
        }
        let found = names(runs.path(), PruneRule { keep_best: true, ..ALL });
        let best = Some(StaysBecause::Best);
        let expected = [("a", None), ("b", best), ("c", None), ("d", best)];
        assert_eq!(found, expected.map(|(name, stays)| (name.to_owned(), stays)));
        // The weights of the best are gone, and those of a run that is alone with its configuration.
        for name in ["b", "d"] {
            fs::remove_file(runs.path().join(name).join("policy.safetensors")).unwrap();
        }
        let found = names(runs.path(), PruneRule { keep_best: true, ..ALL });
        let expected = [("a", None), ("b", None), ("c", best), ("d", None)];
        assert_eq!(found, expected.map(|(name, stays)| (name.to_owned(), stays)));
        // It was evaluated, and the policy that this is about cannot be told any more.
        let evaluated = "{\"update\": 7, \"held_out/success\": 0.8}\n";
        fs::write(runs.path().join("a/held_out.jsonl"), evaluated).unwrap();
        fs::write(runs.path().join("a/checkpoints/000000000007.checkpoint"), "state").unwrap();
        let found = names(runs.path(), PruneRule { keep_best: true, ..ALL });
        assert_eq!(found[0].1, Some(StaysBecause::Unreadable));
        // A full disk let its journal end before the run did.
        let late = runs.path().join("d");
        let mut record = RunRecord::read(&late).unwrap();
        record.result = Some(RunResult { updates: 9, ..RunResult::default() });
        record.write(&late).unwrap();
        fs::write(late.join("policy.safetensors"), "weights").unwrap();
        let found = names(runs.path(), PruneRule { keep_best: true, ..ALL });
        assert_eq!(found[3].1, Some(StaysBecause::Unreadable));
        // What cannot be compared may be the best.
        fs::write(runs.path().join("a/config.toml"), "").unwrap();
        fs::write(runs.path().join("b").join(RECORD), "").unwrap();
        fs::remove_file(runs.path().join("c/metrics.jsonl")).unwrap();
        fs::create_dir(runs.path().join("c/metrics.jsonl")).unwrap();
        let found = names(runs.path(), PruneRule { keep_best: true, ..ALL });
        let unknown = Some(StaysBecause::Unreadable);
        let expected = [("a", unknown), ("b", unknown), ("c", unknown), ("d", unknown)];
        assert_eq!(found, expected.map(|(name, stays)| (name.to_owned(), stays)));
    }
}
