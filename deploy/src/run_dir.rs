//! One run, one directory: naming, locking, resuming, refusing.
//!
//! ```text
//! runs/<name>/  config.toml          the checked configuration      run.json             what, where, how it ended
//!               lock                 held by the learner            checkpoints/         newest ones, and best
//!               metrics.jsonl        a line per update              tensorboard/         the same, as event files
//!               policy.safetensors   the newest policy              best.safetensors     the best so far
//!               report.html          written at every end    playthrough.png      drawn by `smoke`
//!               evaluations/         judged cells, kept by `compare`
//! ```
//!
//! A learner takes up the unfinished run of the same name (or, without a name, the newest unfinished run of the same
//! configuration). A changed configuration is refused with the difference; keys that cannot change a run's bits do
//! not count, and `learner.total_steps` may grow.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use leadtime_proto::RunName;
use thiserror::Error;
use toml::Table;

use crate::cli::RunChoice;
use crate::clock;
use crate::record::{RunRecord, write_atomically};
use leadtime_config::Config;
use leadtime_config::identity::{self, Change, TOTAL_STEPS, difference};

/// Why a run directory cannot be used.
#[derive(Debug, Error)]
pub enum RunDirError {
    /// It cannot be made, read or written.
    #[error("run directory {path} cannot be used")]
    Io {
        /// The path at fault.
        path: PathBuf,
        /// What the system says.
        #[source]
        source: io::Error,
    },
    /// A learner works on it.
    #[error("run `{name}` is being trained by another learner right now")]
    Locked {
        /// The run.
        name: String,
    },
    /// The configuration is not the one that the run began with.
    #[error(
        "run `{name}` began with another configuration: {}; give the old values, or take another --name, with \
         --fork {name} to start from its weights",
        list(changes)
    )]
    Changed {
        /// The run.
        name: String,
        /// What differs, from the run to the request.
        changes: Vec<Change>,
    },
    /// There is something of that name, and it is no run.
    #[error("{path} is not a run directory: {reason:#}")]
    NotARun {
        /// The path.
        path: PathBuf,
        /// Why not.
        reason: anyhow::Error,
    },
    /// The name cannot be a key and a path.
    #[error(transparent)]
    Name(#[from] leadtime_proto::ids::InvalidId),
}

fn list(changes: &[Change]) -> String {
    changes.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
}

/// In which state a run was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// It is new.
    Fresh,
    /// It was begun and not finished.
    Unfinished,
    /// It reached its last step.
    Finished,
}

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
    /// Opens the run that the configuration names, or finds or makes one.
    ///
    /// # Errors
    ///
    /// [`RunDirError`]; nothing is changed then.
    pub fn open(config: &Config) -> Result<(Self, State), RunDirError> {
        let name = choose_name(config, &RunChoice::default())?;
        Self::open_named(config, &name)
    }

    fn open_named(config: &Config, name: &RunName) -> Result<(Self, State), RunDirError> {
        let path = config.run.directory.join(name.as_str());
        let io = |source| RunDirError::Io { path: path.clone(), source };
        let known = path.join("config.toml").exists();
        if !known && path.exists() && !is_empty(&path) {
            let reason = anyhow::anyhow!("it has no config.toml");
            return Err(RunDirError::NotARun { path, reason });
        }
        fs::create_dir_all(path.join("checkpoints")).map_err(io)?;
        let lock = lock(&path, name)?;
        let record_path = path.join("run.json");
        if !known {
            let record = RunRecord::begin(name.as_str(), config.domain.as_str(), config.seed);
            record.write(&record_path).map_err(io)?;
            write_config(&path, config).map_err(io)?;
            let fresh = Self { path, name: name.clone(), record, grown: None, _lock: lock };
            return Ok((fresh, State::Fresh));
        }
        let not_a_run = |reason| RunDirError::NotARun { path: path.clone(), reason };
        let mut record = RunRecord::read(&record_path).map_err(not_a_run)?;
        let before = read_config(&path).map_err(not_a_run)?;
        let state = compare(&record, &before, &config.table, name)?;
        let changes = difference(&before, &config.table).into_iter();
        let grown = { changes }.find(|change| change.key == TOTAL_STEPS);
        if state == State::Unfinished {
            record.resumed += 1;
            record.result = None;
            record.write(&record_path).map_err(io)?;
            write_config(&path, config).map_err(io)?;
        }
        Ok((Self { path, name: name.clone(), record, grown, _lock: lock }, state))
    }

    /// Returns the directory.
    pub fn path(&self) -> &Path {
        &self.path
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

    /// Writes how the run ended.
    ///
    /// # Errors
    ///
    /// [`RunDirError::Io`].
    pub fn finish(&mut self, result: crate::record::RunResult) -> Result<(), RunDirError> {
        self.record.result = Some(result);
        let path = self.path.join("run.json");
        self.record.write(&path).map_err(|source| RunDirError::Io { path, source })
    }
}

/// Returns the run's configured name, else the newest unfinished run of the same configuration, else a new name.
///
/// A fork is a new run.
///
/// # Errors
///
/// [`RunDirError::Name`] if the domain cannot be part of a name.
pub fn choose_name(config: &Config, choice: &RunChoice) -> Result<RunName, RunDirError> {
    let take_up = || if choice.fork.is_some() { None } else { unfinished(config) };
    let named = config.run.name.clone().or_else(take_up);
    named.map_or_else(|| fresh_name(config, config.domain.as_str()), Ok)
}

/// Makes a name that is not taken: `<stem>-<local date and time>`, with a number if need be.
///
/// # Errors
///
/// [`RunDirError::Name`] if the stem cannot be part of a name.
pub fn fresh_name(config: &Config, stem: &str) -> Result<RunName, RunDirError> {
    let base = format!("{}-{}", stem.replace('_', "-"), clock::name_stamp());
    let mut name = base.clone();
    let mut number = 1;
    while config.run.directory.join(&name).exists() {
        number += 1;
        name = format!("{base}-{number}");
    }
    Ok(RunName::new(name)?)
}

/// Finds the newest unfinished run of the same configuration that nobody works on.
fn unfinished(config: &Config) -> Option<RunName> {
    let mut candidates: Vec<(String, RunName)> = fs::read_dir(&config.run.directory)
        .ok()?
        .filter_map(Result::ok)
        .filter_map(|entry| {
            let path = entry.path();
            let name = RunName::new(entry.file_name().to_str()?).ok()?;
            let record = RunRecord::read(&path.join("run.json")).ok()?;
            let same = compare(&record, &read_config(&path).ok()?, &config.table, &name).ok()?;
            let free = record.result.is_none() && same == State::Unfinished;
            (free && lock(&path, &name).is_ok()).then_some((record.started, name))
        })
        .collect();
    candidates.sort();
    candidates.pop().map(|(_, name)| name)
}

/// Judges whether a run may go on under the requested configuration.
fn compare(
    record: &RunRecord,
    before: &Table,
    now: &Table,
    name: &RunName,
) -> Result<State, RunDirError> {
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
    Ok(if record.result.is_some() && !grows { State::Finished } else { State::Unfinished })
}

fn is_longer(change: &Change) -> bool {
    match (change.before.parse::<u64>(), change.after.parse::<u64>()) {
        (Ok(before), Ok(after)) => after > before,
        _ => false,
    }
}

fn lock(path: &Path, name: &RunName) -> Result<File, RunDirError> {
    let io = |source| RunDirError::Io { path: path.to_owned(), source };
    let file = File::create(path.join("lock")).map_err(io)?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(RunDirError::Locked { name: name.to_string() }),
        Err(TryLockError::Error(source)) => Err(io(source)),
    }
}

fn is_empty(path: &Path) -> bool {
    fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_none())
}

/// Reads the configuration that a run was last carried out with.
///
/// # Errors
///
/// A missing or unreadable `config.toml`.
pub fn read_config(path: &Path) -> anyhow::Result<Table> {
    let file = path.join("config.toml");
    Ok(fs::read_to_string(&file)
        .map_err(|error| anyhow::anyhow!("reading {}: {error}", file.display()))?
        .parse::<Table>()?)
}

fn write_config(path: &Path, config: &Config) -> io::Result<()> {
    write_atomically(&path.join("config.toml"), config.table.to_string().as_bytes())
}

/// Computes the hash over everything that must not change when a run is taken up again.
pub fn identity(config: &Config) -> [u8; 32] {
    identity::of_run(&config.table)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::RunResult;
    use leadtime_config::{Catalog, ConfigSource, Override};
    use leadtime_sims::registry::Registry;

    fn config(runs: &Path, name: Option<&str>, set: &[&str]) -> Config {
        let catalog = Catalog::built_in();
        let source = ConfigSource {
            file: catalog.file(Some("cartpole")),
            set: set.iter().map(|text| Override::parse(text).unwrap()).collect(),
            seed: None,
            runs: Some(runs.to_owned()),
            name: name.map(str::to_owned),
        };
        Config::load(&source, &catalog, &Registry::builtin()).unwrap()
    }

    fn open(runs: &Path, name: Option<&str>, set: &[&str]) -> Result<(RunDir, State), RunDirError> {
        RunDir::open(&config(runs, name, set))
    }

    fn result() -> RunResult {
        RunResult {
            finished: clock::utc_now(),
            updates: 1,
            steps: 1,
            weights_sha256: String::new(),
            reproducible: true,
            books: serde_json::Value::Null,
        }
    }

    #[test]
    fn an_unfinished_run_of_the_same_configuration_is_taken_up_again() {
        let runs = tempfile::tempdir().unwrap();
        let (first, state) = open(runs.path(), None, &[]).unwrap();
        assert_eq!(state, State::Fresh);
        let name = first.name().clone();
        let (other, _) = open(runs.path(), None, &[]).unwrap();
        assert_ne!(other.name(), &name, "a run that is being trained is left alone");
        drop((first, other));
        let (changed, state) = open(runs.path(), None, &["learner.clip=0.1"]).unwrap();
        assert_eq!(state, State::Fresh);
        assert_ne!(changed.name(), &name);
        let (again, state) = open(runs.path(), Some(name.as_str()), &[]).unwrap();
        assert_eq!((state, again.record().resumed), (State::Unfinished, 1));
    }

    #[test]
    fn a_changed_configuration_is_refused_with_the_difference() {
        let runs = tempfile::tempdir().unwrap();
        drop(open(runs.path(), Some("r"), &[]).unwrap());
        let error = open(runs.path(), Some("r"), &["learner.clip=0.1", "seed=5"]).unwrap_err();
        let text = error.to_string();
        assert!(text.contains("learner.clip: 0.2 -> 0.1; seed: 1 -> 5"), "{text}");
        let (_, state) =
            open(runs.path(), Some("r"), &["run.actors_min=3", "actor.window=5"]).unwrap();
        assert_eq!(state, State::Unfinished, "how a run is carried out may change");
    }

    #[test]
    fn a_run_from_before_a_setting_came_stays_the_same_run() {
        let runs = tempfile::tempdir().unwrap();
        drop(open(runs.path(), Some("r"), &[]).unwrap());
        let file = runs.path().join("r/config.toml");
        let now = std::fs::read_to_string(&file).unwrap();
        let before: Vec<&str> = now.lines().filter(|line| !line.contains("length_bias")).collect();
        assert_eq!(before.len() + 1, now.lines().count());
        std::fs::write(&file, before.join("\n")).unwrap();
        assert_eq!(open(runs.path(), Some("r"), &[]).unwrap().1, State::Unfinished);
        std::fs::write(&file, before.join("\n")).unwrap();
        let error = open(runs.path(), Some("r"), &["policy.length_bias=-1"]).unwrap_err();
        assert!(error.to_string().contains("policy.length_bias: (none) -> -1.0"), "{error}");
        let mut old = config(runs.path(), Some("r"), &[]);
        let known = identity(&old);
        old.table["policy"].as_table_mut().unwrap().remove("length_bias").unwrap();
        assert_eq!(identity(&old), known);
    }

    #[test]
    fn a_finished_run_stays_finished_unless_it_may_go_on_for_longer() {
        let runs = tempfile::tempdir().unwrap();
        let (mut run, _) = open(runs.path(), Some("r"), &[]).unwrap();
        run.finish(result()).unwrap();
        drop(run);
        assert_eq!(open(runs.path(), Some("r"), &[]).unwrap().1, State::Finished);
        let longer = ["learner.total_steps=600000"];
        assert_eq!(open(runs.path(), Some("r"), &longer).unwrap().1, State::Unfinished);
        let error = open(runs.path(), Some("r"), &["learner.total_steps=1000"]).unwrap_err();
        assert!(matches!(error, RunDirError::Changed { .. }));
    }

    #[test]
    fn a_directory_that_is_no_run_is_left_alone() {
        let runs = tempfile::tempdir().unwrap();
        std::fs::create_dir(runs.path().join("r")).unwrap();
        std::fs::write(runs.path().join("r/novel.txt"), "mine").unwrap();
        let error = open(runs.path(), Some("r"), &[]).unwrap_err();
        assert!(matches!(error, RunDirError::NotARun { .. }), "{error}");
    }

    #[test]
    fn identity_ignores_what_cannot_change_a_runs_bits() {
        let runs = tempfile::tempdir().unwrap();
        let of = |set: &[&str]| identity(&config(runs.path(), Some("r"), set));
        assert_eq!(
            of(&[]),
            of(&["run.actors_min=3", "learner.total_steps=1000", "actor.window=2"])
        );
        assert_ne!(of(&[]), of(&["learner.gamma=0.5"]));
    }
}
