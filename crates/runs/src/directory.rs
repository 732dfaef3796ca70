//! One run, one directory: naming, locking, resuming, refusing.
//!
//! ```text
//! runs/<name>/  config.toml          the checked configuration      run.json             what, where, how it ended
//!               lock                 held by the learner            supervisor.lock      held by a launch
//!               metrics.jsonl        a line per update              tensorboard/         the same, as event files
//!               policy.safetensors   the newest policy              best.safetensors     the best so far
//!               held_out.jsonl       evaluations while it trains  race.json            what a race found out
//!               initial.safetensors  what a fork began with         checkpoints/         the newest ones
//!               report.html          written at every end           playthrough.png      drawn by `smoke`
//!               eval.json            the last evaluation
//!               evaluations/         evaluations kept by `compare`
//! ```
//!
//! A learner takes up the unfinished run of the same name (or, without a name, the newest unfinished run of the same
//! configuration). A named finished run that has lost a policy is opened as well, so that its newest checkpoint makes the
//! policy files again. A changed configuration is refused with the difference; keys that cannot change a run's bits do
//! not count, `learner.total_steps` of a named run may grow, and settings of the learner change where that is asked for. A directory in which nothing was trained yet may be taken anew.
//!
//! Nothing that was trained is ever replaced from nothing: a run that has had checkpoints and lost them is refused.
//! `config.toml` is written last, so a directory without it was never begun, whatever else a killed start left in it.

use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use leadtime_config::Config;
use leadtime_config::identity::{self, Change, TOTAL_STEPS, difference};
use leadtime_learner::write_atomically;
use leadtime_proto::{RunName, hex};
use toml::Table;

use crate::contents::{CHECKPOINTS, checkpoints};
use crate::directory_error::RunDirError;
use crate::held_out::HELD_OUT;
use crate::layout::{
    LOCK, RunState, SUPERVISED, SUPERVISOR_LOCK, TrainingTraces, compare, is_begun, lock,
    make_directory, read_config, read_record, write_config,
};
use crate::naming::{make_new, unfinished};
use crate::policy_file::{BEST_POLICY, Fork, LAST_POLICY, PolicyFileError, weights_digest};
use crate::record::INITIAL_POLICY;
use crate::regular;
use crate::{ForkOrigin, ProgramBuild, ResultCause, RunRecord, RunResult, SettingChange};

/// A locked run directory.
#[derive(Debug)]
pub struct RunDir {
    /// Where the directory is.
    pub path: PathBuf,
    /// The run's name.
    pub name: RunName,
    /// The record of this start.
    pub record: RunRecord,
    /// Whether the record and the configuration on the disk are still those of the last start: they are replaced once this one
    /// can work, because one that cannot (its address is in use) is to cost a finished run nothing.
    pub is_to_be_noted: bool,
    /// How `learner.total_steps` grew since the run was last carried out, if it did.
    pub grown: Option<Change>,
    /// Held for as long as the directory is ours; the system lets go of it even after `kill -9`.
    lock: File,
}

impl RunDir {
    /// Opens the run that the configuration names, or finds or makes one; a fork without a name is a new run.
    ///
    /// # Errors
    ///
    /// [`RunDirError`]; what was trained is untouched then.
    pub fn open(
        config: &Config,
        fork: Option<&Fork>,
        build: &ProgramBuild,
    ) -> Result<(Self, RunState), RunDirError> {
        if let Some(name) = &config.run.name {
            return Self::open_named(config, name, fork, build, &[]);
        }
        let candidates = if fork.is_some() { Vec::new() } else { unfinished(config) };
        for name in candidates {
            let path = config.run.directory.join(name.as_str());
            let Ok(_launched) = lock(&path, SUPERVISOR_LOCK, &name) else { continue };
            match Self::open_named(config, &name, fork, build, &[]) {
                Err(RunDirError::Locked(_)) => {}
                opened => return opened,
            }
        }
        let name = make_new(config, config.domain.as_str())?;
        Self::open_named(config, &name, fork, build, &[])
    }

    /// Opens the run that the configuration names, to go on with other values of these keys.
    ///
    /// What changes is recorded, once: the same command goes on after a kill.
    ///
    /// # Errors
    ///
    /// [`RunDirError`] if the configuration names no run, one in which nothing was trained yet, or one that is finished and
    /// was trained with other values; what was trained is untouched then.
    pub fn open_changed(
        config: &Config,
        keys: &[String],
        build: &ProgramBuild,
    ) -> Result<(Self, RunState), RunDirError> {
        let refused = |what: &str| RunDirError::Refused(format!("--change: {what}"));
        let name = config.run.name.as_ref();
        let name = name.ok_or_else(|| refused("say which run goes on, by --name"))?;
        let path = config.run.directory.join(name.as_str());
        if !is_begun(&path)? {
            let runs = config.run.directory.display();
            return Err(refused(&format!("there is no run `{name}` in {runs}")));
        }
        Self::open_named(config, name, None, build, keys)
    }

    /// Reads the weights that a run is to start from; `None` if they cannot be read and the run that the configuration names has
    /// begun from them: it has its own copy of the weights.
    ///
    /// # Errors
    ///
    /// [`PolicyFileError`] if there are none, or if they do not fit the new run's networks.
    pub fn fork(config: &Config, from: &Path) -> Result<Option<Fork>, PolicyFileError> {
        let has_begun = |name: &RunName| {
            let path = config.run.directory.join(name.as_str());
            let origin = RunRecord::read(&path).ok().and_then(|record| record.origin);
            let is_same = origin.is_some_and(|origin| origin.run == from.display().to_string());
            is_same && is_begun(&path).unwrap_or(false)
        };
        match Fork::read(config, from) {
            Err(_) if config.run.name.as_ref().is_some_and(has_begun) => Ok(None),
            read => read.map(Some),
        }
    }

    fn open_named(
        config: &Config,
        name: &RunName,
        fork: Option<&Fork>,
        build: &ProgramBuild,
        allowed: &[String],
    ) -> Result<(Self, RunState), RunDirError> {
        let path = config.run.directory.join(name.as_str());
        // Before anything is made in somebody else's directory; it counts only once the lock is held.
        is_begun(&path)?;
        let io = |source| RunDirError::Io { path: path.clone(), source };
        make_directory(&path.join(CHECKPOINTS))?;
        let lock = lock(&path, LOCK, name)?;
        let mut kept = None;
        if is_begun(&path)? {
            let mut record = read_record(&path)?;
            adopt_origin(&path, &mut record, config);
            let trained = TrainingTraces::find(&path, &record).map_err(io)?;
            if trained.n_updates > 0 {
                let before = read_config(&path)?;
                let state = compare(&record, &before, &config.table, name, allowed)?;
                let changes = difference(&before, &config.table);
                if state == RunState::Finished {
                    refuse_late_change(config, name, &record, &changes, allowed)?;
                }
                // A learner writes them again from the last checkpoint. The result stays until then.
                let is_restored = state == RunState::Finished && trained.has_lost_policies(&path);
                let is_opened = state == RunState::Unfinished || is_restored;
                fork.map_or(Ok(()), |fork| same_origin(name, record.origin.as_ref(), fork))?;
                let grown = changes.iter().find(|change| change.key == TOTAL_STEPS).cloned();
                if is_opened {
                    trained.check(&path, name, &before)?;
                }
                if state == RunState::Unfinished {
                    // The learning rate has fallen over another length so far: no single command gives the same weights.
                    let is_bent = config.learner.anneal && trained.n_saved > 0;
                    let is_bending = |key: &str| is_bent && key == TOTAL_STEPS;
                    let counts = |key: &str| is_bending(key) || allowed.iter().any(|it| it == key);
                    record.changes.extend(changed(&before, changes, counts, trained.n_saved));
                    // Somebody may have renamed or copied its directory.
                    name.as_str().clone_into(&mut record.name);
                    trained.forget_lost_updates(&path).map_err(io)?;
                    record.taken_up_by(build, trained.has_checkpoints);
                }
                let is_to_be_noted = state == RunState::Unfinished;
                let state = if is_opened { RunState::Unfinished } else { state };
                let run = Self { path, name: name.clone(), record, is_to_be_noted, grown, lock };
                return Ok((run, state));
            }
            kept = record.origin.filter(|_| fork.is_none());
        }
        if !allowed.is_empty() {
            let says = format!("--change: nothing was trained yet in run `{name}`; use --set");
            return Err(RunDirError::Refused(says));
        }
        let record = begin(&path, name, config, fork, kept, build).map_err(io)?;
        let (name, is_to_be_noted, grown) = (name.clone(), false, None);
        Ok((Self { path, name, record, is_to_be_noted, grown, lock }, RunState::Fresh))
    }

    /// Notes that its learner ends when its supervisor does, so that the next supervisor waits for it.
    pub fn note_supervisor(&self) {
        let mut lock = &self.lock;
        // Where it cannot be written nobody waits.
        drop(lock.write_all(SUPERVISED));
    }

    /// Returns the directory of its checkpoints.
    pub fn checkpoints(&self) -> PathBuf {
        self.path.join(CHECKPOINTS)
    }

    /// Reads the weights that a forked run begins with; `None` if it begins with fresh ones, or has begun.
    ///
    /// # Errors
    ///
    /// [`RunDirError`] if they are missing or are not those on record.
    pub fn initial(&self, config: &Config) -> Result<Option<Arc<[u8]>>, RunDirError> {
        let Some(origin) = &self.record.origin else { return Ok(None) };
        let io = |source| RunDirError::Io { path: self.path.clone(), source };
        if !checkpoints(&self.path).map_err(io)?.is_empty() {
            return Ok(None);
        }
        let (path, name) = (self.path.join(INITIAL_POLICY), &self.name);
        let lost = |reason: String| {
            RunDirError::Refused(format!(
                "{} does not hold the weights that run `{name}` was forked from ({reason}); fork it again under another --name",
                path.display()
            ))
        };
        let bytes = regular::read(&path).map_err(|error| lost(error.to_string()))?;
        let digest = weights_digest(&bytes, &config.policy);
        if digest.map_err(|error| lost(error.to_string()))? != origin.weights_sha256 {
            return Err(lost("their digest is not the one on record".to_owned()));
        }
        Ok(Some(bytes.into()))
    }

    /// Writes how the run ended.
    ///
    /// # Errors
    ///
    /// [`RunDirError::Io`] if the record cannot be written.
    pub fn finish(&mut self, result: RunResult) -> Result<(), RunDirError> {
        self.record.result = Some(result);
        let io = |source| RunDirError::Io { path: self.path.clone(), source };
        self.record.write(&self.path).map_err(io)
    }
}

/// Refuses an allowed change in a run that has made all its steps, or has reached its mark: nothing would be trained with it.
fn refuse_late_change(
    config: &Config,
    name: &RunName,
    record: &RunRecord,
    changes: &[Change],
    allowed: &[String],
) -> Result<(), RunDirError> {
    let late = changes.iter().find(|change| allowed.contains(&change.key));
    let Some(Change { key, after, .. }) = late else { return Ok(()) };
    let further = match record.result.as_ref().map(|result| result.end) {
        Some(ResultCause::StopAt) => "raise `evaluation.stop_at`, or leave it out".to_owned(),
        _ => format!("add --steps above {}", config.learner.total_steps),
    };
    Err(RunDirError::Refused(format!(
        "--change: run `{name}` is finished, so nothing is trained with `{key} = {after}`: {further}"
    )))
}

/// Lists the settings whose change counts, of all differences.
fn changed(
    before: &Table,
    changes: Vec<Change>,
    counts: impl Fn(&str) -> bool,
    after_update: u64,
) -> impl Iterator<Item = SettingChange> {
    let identity = hex::encode(&identity::of_run(before));
    let changes = changes.into_iter().filter(move |change| counts(&change.key));
    changes.map(move |Change { key, before, after }| {
        let identity = identity.clone();
        SettingChange { after_update, key, before, after, identity }
    })
}

/// Writes what a new run consists of; the configuration comes last, and with it the run is begun.
///
/// `kept` is the origin of a fork in whose directory nothing was trained yet.
fn begin(
    path: &Path,
    name: &RunName,
    config: &Config,
    fork: Option<&Fork>,
    kept: Option<ForkOrigin>,
    build: &ProgramBuild,
) -> io::Result<RunRecord> {
    let initial = path.join(INITIAL_POLICY);
    if let Some(fork) = fork {
        write_atomically(&initial, &fork.bytes)?;
    } else if kept.is_none() && initial.exists() {
        fs::remove_file(&initial)?;
    }
    // A run that was stopped before its first update has left the state that it began with.
    let policies = [LAST_POLICY, BEST_POLICY, HELD_OUT].map(|name| path.join(name));
    for file in checkpoints(path)?.into_iter().chain(policies).filter(|file| file.exists()) {
        fs::remove_file(file)?;
    }
    let mut record = RunRecord::begin(name.as_str(), config.domain.as_str(), config.seed, build);
    record.origin = fork.map(|fork| fork.origin.clone()).or(kept);
    record.write(path)?;
    write_config(path, config)?;
    Ok(record)
}

/// Adds the origin to the record of a fork from before it was kept there, as far as it can be known.
fn adopt_origin(path: &Path, record: &mut RunRecord, config: &Config) {
    if record.origin.is_some() {
        return;
    }
    let Ok(bytes) = regular::read(&path.join(INITIAL_POLICY)) else { return };
    let digest = weights_digest(&bytes, &config.policy).unwrap_or_default();
    record.origin = Some(ForkOrigin { run: "unknown".to_owned(), weights_sha256: digest });
}

/// Makes sure that a fork names the weights that a run has begun with.
fn same_origin(
    name: &RunName,
    origin: Option<&ForkOrigin>,
    fork: &Fork,
) -> Result<(), RunDirError> {
    // A run that trains on has other weights by now, and is still the one that was named.
    let is_same = |origin: &ForkOrigin| {
        origin.run == fork.origin.run || origin.weights_sha256 == fork.origin.weights_sha256
    };
    if origin.is_some_and(is_same) {
        return Ok(());
    }
    let fresh = "fresh weights".to_owned();
    let began = origin.map_or(fresh, |origin| format!("the weights of `{}`", origin.run));
    Err(RunDirError::Refused(format!(
        "run `{name}` has already begun, from {began}: leave --fork out to continue it, or take another --name"
    )))
}

#[cfg(test)]
#[path = "directory_tests.rs"]
mod tests;
