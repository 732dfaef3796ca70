//! What lies in a run directory, and what it says about the run.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use leadtime_config::Config;
use leadtime_config::identity::{self, Change, STOP_AT, TOTAL_STEPS, difference};
use leadtime_learner::{lock_file, replaced_name, write_atomically};
use leadtime_proto::RunName;
use leadtime_proto::phrase::with_causes;
use toml::Table;

use crate::contents::{CHECKPOINTS, CONFIG, checkpoints, is_run};
use crate::directory_error::RunDirError;
use crate::journal::{JOURNAL, Journal};
use crate::policy_file::{self, BEST_POLICY, LAST_POLICY};
use crate::record::{INITIAL_POLICY, RECORD, RecordError};
use crate::{ResultCause, RunRecord, RunResult, journal, regular};

/// The file that its learner locks.
pub(crate) const LOCK: &str = "lock";
/// The file that its supervisor locks.
pub(crate) const SUPERVISOR_LOCK: &str = "supervisor.lock";
/// What a learner that ends with its supervisor writes into its lock.
pub(crate) const SUPERVISED: &[u8] = b"supervised\n";
/// How the name of a directory begins that is being removed.
pub(crate) const REMOVED: &str = ".removed-";
/// What a start that was killed may leave in a directory that has no configuration yet.
const BEGINNINGS: [&str; 6] = [LOCK, SUPERVISOR_LOCK, INITIAL_POLICY, CHECKPOINTS, RECORD, CONFIG];

/// In which state a run was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunState {
    /// Nothing was trained yet.
    Fresh,
    /// It was begun and not finished.
    Unfinished,
    /// It reached its last step, or the score at which it was to end.
    Finished,
}

/// Returns whether a run was begun in a directory; refuses one that belongs to somebody else.
pub(crate) fn is_begun(path: &Path) -> Result<bool, RunDirError> {
    if path.join(CONFIG).exists() {
        return Ok(true);
    }
    let io = |source| RunDirError::Io { path: path.to_owned(), source };
    let Some(entries) = regular::if_there(fs::read_dir(path)).map_err(io)? else {
        return Ok(false);
    };
    for entry in entries {
        let name = entry.map_err(io)?.file_name();
        let name = name.to_str().unwrap_or_default();
        let is_ours = BEGINNINGS.contains(&replaced_name(name).unwrap_or(name));
        if !is_ours || (name == CHECKPOINTS && !checkpoints(path).map_err(io)?.is_empty()) {
            if path.join(RECORD).exists() {
                return Err(no_config(path));
            }
            return Err(no_run(path, "it holds other files and no config.toml"));
        }
    }
    Ok(false)
}

fn no_run(path: &Path, reason: &str) -> RunDirError {
    RunDirError::Refused(format!("{} is not a run directory: {reason}", path.display()))
}

/// Returns how many updates a run has made, by all that is known of it. Where the disk was full, its files end at different ones.
pub fn n_updates(path: &Path) -> u64 {
    let result = RunRecord::read(path).ok().and_then(|record| record.result);
    n_updates_with(path, result.as_ref())
}

/// As [`n_updates`], with the result of the run's record.
pub(crate) fn n_updates_with(path: &Path, result: Option<&RunResult>) -> u64 {
    told_updates(path, result).into_iter().filter_map(Result::ok).max().unwrap_or(0)
}

/// Returns the updates that the newest checkpoint of a run holds, from which it goes on; 0 without one.
///
/// # Errors
///
/// If the folder of the checkpoints cannot be read.
pub fn n_saved(path: &Path) -> io::Result<u64> {
    let number = |file: &PathBuf| file.file_stem()?.to_str()?.parse::<u64>().ok();
    // One with another name is no reason to take the run for empty.
    let saved = checkpoints(path)?.iter().map(|file| number(file).unwrap_or(1)).max();
    Ok(saved.unwrap_or(0))
}

/// Returns the last update by the checkpoints of a run, by its newest policy, its journal and its result.
fn told_updates(path: &Path, result: Option<&RunResult>) -> [io::Result<u64>; 4] {
    [
        n_saved(path),
        policy_file::n_updates(&path.join(LAST_POLICY)),
        journal::last(path, "update"),
        Ok(result.map_or(0, |result| result.updates)),
    ]
}

/// What of a run's training is on the disk.
pub(crate) struct TrainingTraces {
    pub(crate) n_updates: u64,
    /// Updates of the newest checkpoint; 0 without one.
    pub(crate) n_saved: u64,
    pub(crate) has_checkpoints: bool,
    /// Whether there has been a checkpoint: policies are written after it, and a result at the end.
    had_checkpoints: bool,
}

impl TrainingTraces {
    /// Looks for them; what cannot be read is an error, because it is not the same as nothing.
    pub(crate) fn find(path: &Path, record: &RunRecord) -> io::Result<Self> {
        let [saved, policy, journal, result] = told_updates(path, record.result.as_ref());
        let (saved, policy) = (saved?, policy?);
        Ok(Self {
            n_updates: saved.max(policy).max(journal?).max(result?),
            n_saved: saved,
            has_checkpoints: !checkpoints(path)?.is_empty(),
            had_checkpoints: policy > 0 || record.result.is_some(),
        })
    }

    /// Rewinds the journal of a run that begins again: the next start must not count the old updates as trained.
    pub(crate) fn forget_lost_updates(&self, path: &Path) -> io::Result<()> {
        if self.has_checkpoints { Ok(()) } else { Journal::open(path)?.rewind(0).map(|_none| ()) }
    }

    /// Tells whether the run has lost a policy that its last checkpoint still holds, or its only policy.
    pub(crate) fn has_lost_policies(&self, path: &Path) -> bool {
        has_lost_policies(path, self.has_checkpoints)
    }

    /// Refuses a run whose checkpoints are gone: it would begin anew, over what it had trained.
    pub(crate) fn check(
        &self,
        path: &Path,
        name: &RunName,
        config: &Table,
    ) -> Result<(), RunDirError> {
        let interval = config.get("run").and_then(|run| run.get("checkpoint_every")?.as_integer());
        let is_due = interval.is_some_and(|interval| self.n_updates > interval.cast_unsigned());
        if self.has_checkpoints || !(self.had_checkpoints || is_due) {
            return Ok(());
        }
        let weights = if policy_file::is_in(path) {
            format!(", with --fork {name} to start from its weights")
        } else {
            String::new()
        };
        // The disk may have been full all the time. That nobody has removed them cannot be known.
        let anew = if self.had_checkpoints {
            String::new()
        } else {
            let journal = path.join(JOURNAL);
            format!("; if none could be written, remove {} to begin anew", journal.display())
        };
        let (n_updates, path) = (self.n_updates, path.join(CHECKPOINTS));
        Err(RunDirError::Refused(format!(
            "run `{name}` has {n_updates} updates on record and no checkpoint in {}, so it cannot be continued; put the \
             checkpoints back, or take another --name{weights}{anew}",
            path.display()
        )))
    }
}

/// Returns whether the run in a directory has reached its end, and has its policies as far as they can be had.
pub fn is_finished(path: &Path) -> bool {
    let has_ended = RunRecord::read(path).is_ok_and(|record| record.result.is_some());
    let has_checkpoints = !checkpoints(path).is_ok_and(|it| it.is_empty());
    has_ended && !has_lost_policies(path, has_checkpoints)
}

/// As [`TrainingTraces::has_lost_policies`].
fn has_lost_policies(path: &Path, has_checkpoints: bool) -> bool {
    let is_lost = |name: &str| !path.join(name).is_file();
    let (last, best) = (is_lost(LAST_POLICY), is_lost(BEST_POLICY));
    if has_checkpoints { last || best } else { last && best }
}

/// Decides whether a run may go on under the requested configuration; the `allowed` keys may have changed.
pub(crate) fn compare(
    record: &RunRecord,
    before: &Table,
    now: &Table,
    name: &RunName,
    allowed: &[String],
) -> Result<RunState, RunDirError> {
    let is_longer = |change: &Change| {
        let [before, after] = [&change.before, &change.after].map(|number| number.parse::<f64>());
        match change.key.as_str() {
            TOTAL_STEPS => matches!((before, after), (Ok(a), Ok(b)) if b > a),
            STOP_AT => before.is_ok_and(|a| after.is_ok_and(|b| b > a) || change.after.is_empty()),
            _ => false,
        }
    };
    let mut changes = difference(before, now);
    changes.retain(|change| {
        identity::decides_weights(&change.key, now) && !allowed.contains(&change.key)
    });
    let longer: Vec<Change> = changes.extract_if(.., |change| is_longer(change)).collect();
    if !changes.is_empty() {
        let changes = changes.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ");
        return Err(RunDirError::Refused(format!(
            "run `{name}` began with another configuration: {changes}; give the old values, take another --name, with \
             --fork {name} to start from its weights, or go on with other settings of the learner by --change KEY=VALUE"
        )));
    }
    // One that has made all its steps makes no more of them because it may reach more.
    let goes_on = |result: &RunResult| {
        longer.iter().any(|change| change.key == TOTAL_STEPS || result.end == ResultCause::StopAt)
    };
    let is_over = record.result.as_ref().is_some_and(|result| !goes_on(result));
    Ok(if is_over { RunState::Finished } else { RunState::Unfinished })
}

/// Makes a directory with those above it, unless it is there; what is in the way is named.
pub(crate) fn make_directory(path: &Path) -> Result<(), RunDirError> {
    fs::create_dir_all(path).map_err(|source| {
        let is_in_the_way = |at: &&Path| at.symlink_metadata().is_ok() && !at.is_dir();
        let Some(at) = path.ancestors().find(is_in_the_way) else {
            return RunDirError::Io { path: path.to_owned(), source };
        };
        let sentence = regular::dead_link(at);
        let sentence = sentence.unwrap_or_else(|| "it is not a directory".to_owned());
        RunDirError::Io { path: at.to_owned(), source: io::Error::new(source.kind(), sentence) }
    })
}

pub(crate) fn lock(path: &Path, file: &str, name: &RunName) -> Result<File, RunDirError> {
    let path = path.join(file);
    let io = |source| RunDirError::Io { path: path.clone(), source };
    let file = lock_file(&path).map_err(|error| match error {
        TryLockError::WouldBlock => RunDirError::Locked(name.to_string()),
        TryLockError::Error(source) => io(source),
    })?;
    // What its holder has written stays until the lock is ours.
    file.set_len(0).map(|()| file).map_err(io)
}

/// Takes the learner's lock for a supervisor, which holds its own.
///
/// # Errors
///
/// As [`lock`]; [`RunDirError::Orphaned`] if the learner that holds it had a supervisor, which is gone: it is about to end.
pub(crate) fn lock_for_supervisor(path: &Path, name: &RunName) -> Result<File, RunDirError> {
    lock(path, LOCK, name).map_err(|error| match error {
        RunDirError::Locked(name) if is_orphaned(path) => RunDirError::Orphaned(name),
        error => error,
    })
}

/// Tells whether the learner that holds the lock was started by a supervisor; the caller knows that this one is gone.
fn is_orphaned(path: &Path) -> bool {
    regular::read(&path.join(LOCK)).is_ok_and(|text| text == SUPERVISED)
}

pub(crate) fn read_record(path: &Path) -> Result<RunRecord, RunDirError> {
    RunRecord::read(path).map_err(|error| match error {
        RecordError::Newer { .. } => RunDirError::Refused(error.to_string()),
        RecordError::Unreadable { .. } if is_run(path) => damaged(path, &with_causes(&error)),
        RecordError::Unreadable { .. } => no_run(path, &with_causes(&error)),
    })
}

/// Tells whether a directory is what a removal that was killed has left of a run.
pub(crate) fn is_left(name: &str) -> bool {
    name.starts_with(REMOVED)
}

/// Says which file of a run is damaged, and what helps.
fn damaged(path: &Path, what: &str) -> RunDirError {
    let name = path.file_name().unwrap_or(path.as_os_str()).display();
    let weights = if policy_file::is_in(path) {
        format!(", from the policy of this one by --fork {name}")
    } else {
        String::new()
    };
    RunDirError::Refused(format!(
        "{what}; put a copy of the file back, or begin a new run under another --name{weights}"
    ))
}

/// Says that a run has lost its configuration, and what helps.
fn no_config(path: &Path) -> RunDirError {
    damaged(path, &format!("the run in {} has no {CONFIG} any more", path.display()))
}

/// Reads the configuration that a run was last carried out with.
///
/// # Errors
///
/// [`RunDirError`] if `config.toml` is missing or unreadable.
pub fn read_config(path: &Path) -> Result<Table, RunDirError> {
    let file = path.join(CONFIG);
    let io = |source| RunDirError::Io { path: file.clone(), source };
    let not_one = |why: &str| damaged(path, &format!("{} {why}", file.display()));
    let text = match regular::read_to_string(&file) {
        Err(error) if error.kind() == io::ErrorKind::InvalidData => {
            return Err(not_one("is not a configuration: it is no text in UTF-8"));
        }
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Err(no_config(path)),
        text => text.map_err(io)?,
    };
    if text.trim().is_empty() {
        return Err(not_one("is empty"));
    }
    text.parse::<Table>()
        .map_err(|error| not_one(&format!("is not a configuration: {}", error.message())))
}

pub(crate) fn write_config(path: &Path, config: &Config) -> io::Result<()> {
    write_atomically(&path.join(CONFIG), config.table.to_string().as_bytes())
}
