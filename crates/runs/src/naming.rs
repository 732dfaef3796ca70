//! Which run a start is about: the named one, the newest unfinished one, or a new one.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use leadtime_config::{Config, identity};
use leadtime_proto::RunName;

use crate::command_line::shell_argument;
use crate::contents::CONFIG;
use crate::directory_error::RunDirError;
use crate::layout::{
    LOCK, RunState, SUPERVISOR_LOCK, TrainingTraces, compare, is_begun, lock, lock_for_supervisor,
    make_directory, read_config,
};
use crate::record::RECORD;
use crate::{RunRecord, clock};

/// Which run a start is about.
#[derive(Clone, Copy, Debug)]
pub enum Naming<'a> {
    /// The run that the configuration names, else the newest unfinished one of the same configuration, else a new one.
    Resume,
    /// A new run, whose name begins with this word.
    New(&'a str),
}

/// A run that a supervisor has chosen, so that no other start chooses it; released when dropped.
#[derive(Debug)]
pub(crate) struct Reservation {
    pub(crate) path: PathBuf,
    pub(crate) name: RunName,
    _lock: File,
}

impl Reservation {
    /// Chooses a run and creates its directory if it does not exist; refuses a directory that holds other files or is in use.
    pub(crate) fn make(config: &Config, naming: &Naming<'_>) -> Result<Self, RunDirError> {
        match (naming, &config.run.name) {
            (Naming::Resume, Some(name)) => Self::named(config, name),
            (Naming::New(stem), _) => Self::named(config, &make_new(config, stem)?),
            (Naming::Resume, None) => {
                for name in unfinished(config) {
                    match Self::named(config, &name) {
                        // One that cannot be written, another user's say, is not ours to resume.
                        Err(RunDirError::Locked(_) | RunDirError::Io { .. }) => {}
                        reserved => return reserved,
                    }
                }
                Self::named(config, &make_new(config, config.domain.as_str())?)
            }
        }
    }

    fn named(config: &Config, name: &RunName) -> Result<Self, RunDirError> {
        let path = config.run.directory.join(name.as_str());
        is_begun(&path)?;
        make_directory(&path)?;
        let supervisor = lock(&path, SUPERVISOR_LOCK, name)?;
        if path.join(LOCK).exists() {
            drop(lock_for_supervisor(&path, name)?);
        }
        Ok(Self { path, name: name.clone(), _lock: supervisor })
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        let Ok(mut entries) = fs::read_dir(&self.path) else { return };
        let is_lock = |entry: io::Result<fs::DirEntry>| {
            entry.is_ok_and(|entry| entry.file_name() == SUPERVISOR_LOCK)
        };
        // Nothing was begun in it. If something is meanwhile, the directory is not empty and stays.
        if entries.all(is_lock) && fs::remove_file(self.path.join(SUPERVISOR_LOCK)).is_ok() {
            drop(fs::remove_dir(&self.path));
        }
    }
}

/// Refuses the `config.toml` of a run that leads to another directory than the one it lies in.
///
/// So it is after a run was moved, copied or renamed, and where a command is given in another folder than the run's first
/// one: another run would go on, or begin anew under the old name. Somebody who says which other name it is to have (`is_named`)
/// means it.
///
/// # Errors
///
/// [`RunDirError::Refused`] with the options that lead to the run that lies there.
pub fn check_place(file: &Path, config: &Config, is_named: bool) -> Result<(), RunDirError> {
    let own = file.parent().filter(|own| !own.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let is_config = file.file_name().is_some_and(|name| name == CONFIG);
    let is_a_runs = is_config && own.join(RECORD).exists();
    let (Some(name), true) = (&config.run.name, is_a_runs) else { return Ok(()) };
    let Ok(place) = own.canonicalize() else { return Ok(()) };
    let leads_to = config.run.directory.join(name.as_str());
    let own_name = place.file_name().unwrap_or_default();
    if leads_to.canonicalize().is_ok_and(|other| other == place)
        || (is_named && own_name != name.as_str())
    {
        return Ok(());
    }
    let runs = own.parent().filter(|_| own.file_name().is_some()).or(place.parent());
    let runs = runs.filter(|runs| !runs.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let go_on = match own_name.to_str().map(RunName::new) {
        Some(Ok(name)) => format!("--runs {} --name {name}", shell_argument(runs.as_os_str())),
        _ => "--runs and --name, once its directory has a name of a-z, 0-9 and `-`".to_owned(),
    };
    Err(RunDirError::Refused(format!(
        "{} is that of the run in {}, and leads to {}: the run was moved or copied, or began in another folder; go on with \
         the one there by {go_on}, or begin a new one under another --name",
        file.display(),
        own.display(),
        leads_to.display()
    )))
}

/// Makes the directory of a new run: `<stem>-<local date and time>`, with a number if need be.
pub(crate) fn make_new(config: &Config, stem: &str) -> Result<RunName, RunDirError> {
    let runs = &config.run.directory;
    let io = |source| RunDirError::Io { path: runs.clone(), source };
    make_directory(runs)?;
    let base = format!("{}-{}", stem.replace('_', "-"), clock::name_stamp());
    let mut number = 1;
    loop {
        let suffix = if number == 1 { String::new() } else { format!("-{number}") };
        let name = RunName::new(format!("{base}{suffix}"))?;
        // Of several starts in one second, only one makes it.
        match fs::create_dir(runs.join(name.as_str())) {
            Ok(()) => return Ok(name),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => number += 1,
            Err(error) => return Err(io(error)),
        }
    }
}

/// Lists the unfinished runs of the same configuration, newest first; a fork is resumed only by its name.
pub(crate) fn unfinished(config: &Config) -> Vec<RunName> {
    let Ok(entries) = fs::read_dir(&config.run.directory) else { return Vec::new() };
    let candidate = |entry: fs::DirEntry| {
        let path = entry.path();
        let name = RunName::new(entry.file_name().to_str()?).ok()?;
        let record = RunRecord::read(&path).ok()?;
        let before = read_config(&path).ok()?;
        let state = compare(&record, &before, &config.table, &name, &[]).ok()?;
        // One that is to become longer is asked for by its name: its learning rate would fall over another length.
        let changes = identity::difference(&before, &config.table);
        let is_same = changes.iter().all(|change| change.key != identity::TOTAL_STEPS);
        let trained = TrainingTraces::find(&path, &record).ok()?;
        trained.check(&path, &name, &before).ok()?;
        let is_open = record.result.is_none() && state == RunState::Unfinished;
        (is_open && is_same && !record.is_fork(&path)).then_some((record.started, name))
    };
    let mut found: Vec<_> = entries.filter_map(Result::ok).filter_map(candidate).collect();
    found.sort();
    found.into_iter().rev().map(|(_, name)| name).collect()
}
