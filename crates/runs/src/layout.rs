//! What lies in a run directory, and what it says about the run.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use leadtime_config::Config;
use leadtime_config::identity::{self, Change, TOTAL_STEPS, difference};
use leadtime_learner::write_atomically;
use leadtime_proto::RunName;
use toml::Table;

use crate::directory_error::{RunDirError, with_causes};
use crate::policy_file::{self, LAST_POLICY};
use crate::record::{INITIAL_POLICY, RECORD};
use crate::{RunRecord, journal};

/// The configuration's file in a run directory.
const CONFIG: &str = "config.toml";
/// The file that its learner locks.
pub(crate) const LOCK: &str = "lock";
/// The file that its supervisor locks.
pub(crate) const SUPERVISOR_LOCK: &str = "supervisor.lock";
/// The folder of its checkpoints.
pub(crate) const CHECKPOINTS: &str = "checkpoints";
/// What a start that was killed may leave in a directory that has no configuration yet.
const BEGINNINGS: [&str; 6] = [LOCK, SUPERVISOR_LOCK, INITIAL_POLICY, CHECKPOINTS, RECORD, CONFIG];

/// In which state a run was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunState {
    /// Nothing was trained yet.
    Fresh,
    /// It was begun and not finished.
    Unfinished,
    /// It reached its last step.
    Finished,
}

/// Tells whether a run was begun in a directory; refuses one that belongs to somebody else.
pub(crate) fn is_begun(path: &Path) -> Result<bool, RunDirError> {
    if path.join(CONFIG).exists() {
        return Ok(true);
    }
    let Ok(entries) = fs::read_dir(path) else { return Ok(false) };
    let is_ours = |entry: fs::DirEntry| {
        let name = entry.file_name();
        let name = name.to_str().unwrap_or_default();
        let is_ours = BEGINNINGS.contains(&name.trim_end_matches(".partial"));
        is_ours && (name != CHECKPOINTS || checkpoints(path).is_empty())
    };
    if entries.filter_map(Result::ok).all(is_ours) {
        return Ok(false);
    }
    let reason = "it holds other files and no config.toml".to_owned();
    Err(RunDirError::NotARun { path: path.to_owned(), reason })
}

/// What of a run's training is on the disk.
pub(crate) struct TrainingTraces {
    pub(crate) n_updates: u64,
    pub(crate) has_checkpoints: bool,
    /// Whether there has been a checkpoint: policies are written after it, and a result at the end.
    had_checkpoints: bool,
}

impl TrainingTraces {
    pub(crate) fn find(path: &Path, record: &RunRecord) -> Self {
        let checkpoints = checkpoints(path);
        let number = |file: &PathBuf| file.file_stem()?.to_str()?.parse::<u64>().ok();
        // One with another name is no reason to take the run for empty.
        let saved = checkpoints.iter().map(|file| number(file).unwrap_or(1)).max().unwrap_or(0);
        let policy = policy_file::n_updates(&path.join(LAST_POLICY));
        let result = record.result.as_ref().map_or(0, |result| result.updates);
        Self {
            n_updates: journal::last_update(path).max(saved).max(policy).max(result),
            has_checkpoints: !checkpoints.is_empty(),
            had_checkpoints: policy > 0 || record.result.is_some(),
        }
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
        let had_checkpoints = self.had_checkpoints || is_due;
        if had_checkpoints && !self.has_checkpoints {
            let (name, path) = (name.to_string(), path.join(CHECKPOINTS));
            return Err(RunDirError::CheckpointsLost { name, n_updates: self.n_updates, path });
        }
        Ok(())
    }
}

pub(crate) fn checkpoints(path: &Path) -> Vec<PathBuf> {
    let Ok(entries) = fs::read_dir(path.join(CHECKPOINTS)) else { return Vec::new() };
    let files = entries.filter_map(Result::ok).map(|entry| entry.path());
    files.filter(|file| file.extension().is_some_and(|e| e == "checkpoint")).collect()
}

/// Decides whether a run may go on under the requested configuration.
pub(crate) fn compare(
    record: &RunRecord,
    before: &Table,
    now: &Table,
    name: &RunName,
) -> Result<RunState, RunDirError> {
    let mut grows = false;
    let changes: Vec<Change> = difference(before, now)
        .into_iter()
        .filter(|change| !identity::is_free(&change.key))
        .filter(|change| {
            let longer = change.key == TOTAL_STEPS && is_longer(change);
            grows |= longer;
            !longer
        })
        .collect();
    if !changes.is_empty() {
        return Err(RunDirError::Changed { name: name.to_string(), changes });
    }
    Ok(if record.result.is_some() && !grows { RunState::Finished } else { RunState::Unfinished })
}

fn is_longer(change: &Change) -> bool {
    match (change.before.parse::<u64>(), change.after.parse::<u64>()) {
        (Ok(before), Ok(after)) => after > before,
        _ => false,
    }
}

pub(crate) fn lock(path: &Path, file: &str, name: &RunName) -> Result<File, RunDirError> {
    let io = |source| RunDirError::Io { path: path.to_owned(), source };
    let file = File::create(path.join(file)).map_err(io)?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(RunDirError::Locked { name: name.to_string() }),
        Err(TryLockError::Error(source)) => Err(io(source)),
    }
}

pub(crate) fn read_record(path: &Path) -> Result<RunRecord, RunDirError> {
    RunRecord::read(path).map_err(|error| RunDirError::NotARun {
        path: path.to_owned(),
        reason: with_causes(&error),
    })
}

/// Reads the configuration that a run was last carried out with.
///
/// # Errors
///
/// [`RunDirError`] if `config.toml` is missing or unreadable.
pub fn read_config(path: &Path) -> Result<Table, RunDirError> {
    let path = path.join(CONFIG);
    let text = match fs::read_to_string(&path) {
        Ok(text) => text,
        Err(source) => return Err(RunDirError::Io { path, source }),
    };
    let reason = |error| format!("{} is not a configuration: {error}", path.display());
    text.parse().map_err(|error| RunDirError::NotARun { path: path.clone(), reason: reason(error) })
}

pub(crate) fn write_config(path: &Path, config: &Config) -> io::Result<()> {
    write_atomically(&path.join(CONFIG), config.table.to_string().as_bytes())
}
