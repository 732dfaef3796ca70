//! One run, one directory: naming, locking, resuming, refusing.
//!
//! ```text
//! runs/<name>/  config.toml          the checked configuration      run.json             what, where, how it ended
//!               lock                 held by the learner            supervisor.lock      held by a launch
//!               metrics.jsonl        a line per update              tensorboard/         the same, as event files
//!               policy.safetensors   the newest policy              best.safetensors     the best so far
//!               initial.safetensors  what a fork began with         checkpoints/         the newest ones
//!               report.html          written at every end           playthrough.png      drawn by `smoke`
//!               evaluations/         evaluations kept by `compare`
//! ```
//!
//! A learner takes up the unfinished run of the same name (or, without a name, the newest unfinished run of the same
//! configuration). A changed configuration is refused with the difference; keys that cannot change a run's bits do
//! not count, and `learner.total_steps` may grow. A directory in which nothing was trained yet may be taken anew.
//!
//! Nothing that was trained is ever replaced from nothing: a run that has had checkpoints and lost them is refused.
//! `config.toml` is written last, so a directory without it was never begun, whatever else a killed start left in it.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use leadtime_config::Config;
use leadtime_config::identity::{Change, TOTAL_STEPS, difference};
use leadtime_learner::write_atomically;
use leadtime_proto::RunName;

use crate::directory_error::RunDirError;
use crate::layout::{
    CHECKPOINTS, LOCK, RunState, SUPERVISOR_LOCK, TrainingTraces, checkpoints, compare, is_begun,
    lock, read_config, read_record, write_config,
};
use crate::naming::{make_new, unfinished};
use crate::policy_file::{BEST_POLICY, Fork, LAST_POLICY, weights_digest};
use crate::record::INITIAL_POLICY;
use crate::{ForkOrigin, ProgramBuild, RunRecord, RunResult};

/// A locked run directory.
#[derive(Debug)]
pub struct RunDir {
    path: PathBuf,
    name: RunName,
    record: RunRecord,
    grown: Option<Change>,
    /// Held for as long as the directory is ours; the system lets go of it even after `kill -9`.
    _lock: File,
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
            return Self::open_named(config, name, fork, build);
        }
        let candidates = if fork.is_some() { Vec::new() } else { unfinished(config) };
        for name in candidates {
            let is_launched =
                lock(&config.run.directory.join(name.as_str()), SUPERVISOR_LOCK, &name);
            match is_launched.and_then(|_lock| Self::open_named(config, &name, fork, build)) {
                Err(RunDirError::Locked { .. }) => {}
                opened => return opened,
            }
        }
        Self::open_named(config, &make_new(config, config.domain.as_str())?, fork, build)
    }

    fn open_named(
        config: &Config,
        name: &RunName,
        fork: Option<&Fork>,
        build: &ProgramBuild,
    ) -> Result<(Self, RunState), RunDirError> {
        let path = config.run.directory.join(name.as_str());
        let is_begun = is_begun(&path)?;
        let io = |source| RunDirError::Io { path: path.clone(), source };
        fs::create_dir_all(path.join(CHECKPOINTS)).map_err(io)?;
        let lock = lock(&path, LOCK, name)?;
        let (record, grown, state) = if is_begun {
            Self::take_up(&path, config, name, fork, build)?
        } else {
            (begin(&path, name, config, fork, None, build).map_err(io)?, None, RunState::Fresh)
        };
        Ok((Self { path, name: name.clone(), record, grown, _lock: lock }, state))
    }

    fn take_up(
        path: &Path,
        config: &Config,
        name: &RunName,
        fork: Option<&Fork>,
        build: &ProgramBuild,
    ) -> Result<(RunRecord, Option<Change>, RunState), RunDirError> {
        let io = |source| RunDirError::Io { path: path.to_owned(), source };
        let mut record = read_record(path)?;
        adopt_origin(path, &mut record, config);
        let trained = TrainingTraces::find(path, &record);
        if trained.n_updates == 0 {
            let kept = record.origin.filter(|_| fork.is_none());
            let record = begin(path, name, config, fork, kept, build).map_err(io)?;
            return Ok((record, None, RunState::Fresh));
        }
        let before = read_config(path)?;
        let state = compare(&record, &before, &config.table, name)?;
        if let Some(fork) = fork {
            same_origin(name, record.origin.as_ref(), fork)?;
        }
        let changes = difference(&before, &config.table).into_iter();
        let grown = { changes }.find(|change| change.key == TOTAL_STEPS);
        if state == RunState::Unfinished {
            trained.check(path, name, &before)?;
            if !trained.has_checkpoints {
                // It was killed before its first checkpoint: all of it is made again, by this build.
                record.builds = vec![build.clone()];
            }
            record.worked_on_by(build);
            record.resumed += 1;
            record.result = None;
            record.write(path).and_then(|()| write_config(path, config)).map_err(io)?;
        }
        Ok((record, grown, state))
    }

    /// Returns the directory.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the directory of its checkpoints.
    pub fn checkpoints(&self) -> PathBuf {
        self.path.join(CHECKPOINTS)
    }

    /// Returns the run's name.
    pub fn name(&self) -> &RunName {
        &self.name
    }

    /// Returns the record as it was when the directory was opened.
    pub fn record(&self) -> &RunRecord {
        &self.record
    }

    /// Returns how `learner.total_steps` grew since the run was last carried out, if it did.
    pub fn grown(&self) -> Option<&Change> {
        self.grown.as_ref()
    }

    /// Reads the weights that a forked run begins with; `None` if it begins with fresh ones, or has begun.
    ///
    /// # Errors
    ///
    /// [`RunDirError::OriginLost`] if they are missing or are not those on record.
    pub fn initial(&self, config: &Config) -> Result<Option<Arc<[u8]>>, RunDirError> {
        let Some(origin) = &self.record.origin else { return Ok(None) };
        if !checkpoints(&self.path).is_empty() {
            return Ok(None);
        }
        let path = self.path.join(INITIAL_POLICY);
        let lost = |reason: String| {
            let (name, path) = (self.name.to_string(), path.clone());
            RunDirError::OriginLost { name, path, reason }
        };
        let bytes = fs::read(&path).map_err(|error| lost(error.to_string()))?;
        let digest =
            weights_digest(&bytes, &config.policy).map_err(|error| lost(error.to_string()))?;
        if digest != origin.weights_sha256 {
            return Err(lost("their digest is not the one on record".to_owned()));
        }
        Ok(Some(bytes.into()))
    }

    /// Writes how the run ended; it is reproducible only if one build on one class of CPU trained all of it.
    ///
    /// # Errors
    ///
    /// [`RunDirError::Io`] if the record cannot be written.
    pub fn finish(&mut self, mut result: RunResult) -> Result<(), RunDirError> {
        result.reproducible &= self.record.builds.len() == 1;
        self.record.result = Some(result);
        let io = |source| RunDirError::Io { path: self.path.clone(), source };
        self.record.write(&self.path).map_err(io)
    }
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
    let policies = [LAST_POLICY, BEST_POLICY].map(|name| path.join(name));
    for file in checkpoints(path).into_iter().chain(policies).filter(|file| file.exists()) {
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
    let Ok(bytes) = fs::read(path.join(INITIAL_POLICY)) else { return };
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
    let origin = origin.map(|origin| origin.run.clone());
    Err(RunDirError::OtherOrigin { name: name.to_string(), origin })
}

#[cfg(test)]
#[path = "directory_tests.rs"]
mod tests;
