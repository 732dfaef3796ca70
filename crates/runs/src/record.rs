//! `run.json`: what a run is, what it began from, which builds worked on it, and how it ended.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use leadtime_learner::write_atomically;
use leadtime_proto::phrase::counted;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::{ProgramBuild, clock, regular};

/// The format of a run directory; a newer one is refused with a sentence.
const RUN_FORMAT: u32 = 1;
/// The record's file in a run directory.
pub(crate) const RECORD: &str = "run.json";
/// The file that holds what a forked run began with.
pub(crate) const INITIAL_POLICY: &str = "initial.safetensors";

/// Why a record cannot be read.
#[derive(Debug, Error)]
pub enum RecordError {
    /// It cannot be read, or not as a record.
    #[error("{what}")]
    Unreadable {
        /// Which file, and what is wrong with it.
        what: String,
        /// What the system says, or where the file stops being a record.
        source: io::Error,
    },
    /// A later release wrote it.
    #[error("{} has format {found}, this release reads up to {RUN_FORMAT}: use the newer release", path.display())]
    Newer {
        /// The record's file.
        path: PathBuf,
        /// The format that it says it has.
        found: u32,
    },
}

/// The record of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunRecord {
    /// Format of the program that made the directory.
    pub format: u32,
    /// The run's name.
    pub name: String,
    /// Whether it was made only to check the mechanics (`smoke --quick`).
    #[serde(default)]
    pub quick: bool,
    /// What it trains on.
    pub domain: String,
    /// Seed of every random stream.
    pub seed: u64,
    /// Release of the program that began the run.
    pub version: String,
    /// Commit that this program was built from, if known.
    pub commit: Option<String>,
    /// Class of the CPU that the run began on: equal classes give equal bits.
    pub cpu: String,
    /// `RAYON_NUM_THREADS` of the learner that began it.
    pub threads: String,
    /// When the run began, UTC.
    pub started: String,
    /// How often a learner took the run up again.
    pub resumed: u32,
    /// The weights that a forked run began with; `None` if it began from fresh ones.
    #[serde(default)]
    pub origin: Option<ForkOrigin>,
    /// The builds of the learner that the run's bits come from, in order; one more whenever another one took over.
    #[serde(default)]
    pub builds: Vec<ProgramBuild>,
    /// The settings of the learner that were changed while the run went on, in order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub changes: Vec<SettingChange>,
    /// How it ended; `None` while it is unfinished.
    pub result: Option<RunResult>,
}

/// A setting of the learner that was changed while a run went on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SettingChange {
    /// The updates that were made with the old value.
    pub after_update: u64,
    /// The full key: `learner.learning_rate`.
    pub key: String,
    /// The old value, as TOML; empty if it had none.
    pub before: String,
    /// The new value, as TOML.
    pub after: String,
    /// The run's identity before the change, in hexadecimal: its older checkpoints have it.
    pub identity: String,
}

impl fmt::Display for SettingChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { after_update, key, before, after, .. } = self;
        let before = if before.is_empty() { "(none)" } else { before };
        write!(f, "{key}: {before} -> {after} after update {after_update}")
    }
}

/// What a forked run began with.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ForkOrigin {
    /// The run or file that `--fork` named.
    pub run: String,
    /// SHA-256 over its parameters, in hexadecimal: that of the run's result, if it was finished.
    pub weights_sha256: String,
}

/// Which setting ended a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ResultCause {
    /// `learner.total_steps`: all steps are made.
    #[default]
    TotalSteps,
    /// `evaluation.stop_at`: the last policy reached this score on held-out episodes.
    StopAt,
}

/// What a finished run came to.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RunResult {
    /// When the run was finished, in UTC.
    pub finished: String,
    /// What ended it; all steps in a record from before there was anything else.
    #[serde(default)]
    pub end: ResultCause,
    /// Updates that made the final policy.
    pub updates: u64,
    /// Steps trained on.
    pub steps: u64,
    /// SHA-256 over the final parameters, in hexadecimal: equal for equal seeds in `sync` and `lag`.
    pub weights_sha256: String,
    /// Whether the same seed (and origin) would give the same bits again: a deterministic schedule, one build of the
    /// program, one class of CPU, and no episode that was replaced because nobody could restore it.
    pub reproducible: bool,
    /// The books, as JSON.
    pub books: serde_json::Value,
}

/// Says where every rollout went, from the books as a record keeps them; what did not happen is left out.
pub fn books_sentence(books: &serde_json::Value) -> String {
    const FATES: [(&str, &str); 6] = [
        ("trained", "trained on"),
        ("dropped_stale", "too stale to use"),
        ("refused", "refused"),
        ("superseded", "superseded"),
        ("unused_at_end", "unused at the end"),
        ("rolled_back", "rolled back on resuming and made again"),
    ];
    let count = |name: &str| books[name].as_u64().unwrap_or(0);
    let fates = FATES.iter().filter(|(name, _)| count(name) > 0);
    let fates = fates.map(|(name, fate)| format!("{} {fate}", count(name)));
    let balance = if books["balanced"] == true { "all accounted for" } else { "NOT balanced" };
    let parts = std::iter::once(counted(count("published"), "rollout")).chain(fates);
    parts.chain([balance.to_owned()]).collect::<Vec<_>>().join(", ")
}

impl RunRecord {
    /// Starts the record of a new run.
    pub fn begin(name: &str, domain: &str, seed: u64, build: &ProgramBuild) -> Self {
        Self {
            format: RUN_FORMAT,
            name: name.to_owned(),
            quick: false,
            domain: domain.to_owned(),
            seed,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            commit: build.commit.clone(),
            cpu: build.cpu.clone(),
            threads: build.threads.clone(),
            started: clock::utc_now(),
            resumed: 0,
            origin: None,
            builds: vec![build.clone()],
            changes: Vec::new(),
            result: None,
        }
    }

    /// Notes that a build takes the run up.
    pub(crate) fn taken_up_by(&mut self, build: &ProgramBuild, has_checkpoints: bool) {
        if !has_checkpoints {
            // It was killed before its first checkpoint: all of it is made again, by this build, with the settings of now.
            self.builds = vec![build.clone()];
            self.changes.clear();
        }
        self.worked_on_by(build);
        self.resumed += 1;
        self.result = None;
    }

    /// Notes that a build works on the run from here on.
    fn worked_on_by(&mut self, build: &ProgramBuild) {
        if self.builds.is_empty() {
            // A record from before builds were kept: the fingerprint is not known, and so equal to no other.
            self.builds.push(ProgramBuild {
                since: self.started.clone(),
                program: format!("leadtime {}", self.version),
                commit: self.commit.clone(),
                cpu: self.cpu.clone(),
                threads: self.threads.clone(),
            });
        }
        if self.builds.last().is_none_or(|last| !last.computes_like(build)) {
            self.builds.push(build.clone());
        }
    }

    /// Returns whether the same seed and origin would give the same weights again; `None` while the run is unfinished.
    ///
    /// A fork whose record does not say what it began with cannot be made again. Neither can a run whose settings were changed
    /// on the way, by one command.
    pub fn is_reproducible(&self, directory: &Path) -> Option<bool> {
        let is_known = self.origin.is_some() || !self.is_fork(directory);
        let is_whole = self.changes.is_empty();
        self.result.as_ref().map(|result| result.reproducible && is_known && is_whole)
    }

    /// Returns whether the run began with the weights of another one.
    pub(crate) fn is_fork(&self, directory: &Path) -> bool {
        self.origin.is_some() || directory.join(INITIAL_POLICY).exists()
    }

    /// Says what the run in this directory was trained with that its configuration does not show: `is a fork of a`, `went on with
    /// other settings (learner.clip: 0.2 -> 0.1 after update 9)`; `None` if nothing.
    ///
    /// # Errors
    ///
    /// As [`RunRecord::read`].
    pub fn detour(directory: &Path) -> Result<Option<String>, RecordError> {
        let record = Self::read(directory)?;
        if let Some(origin) = &record.origin {
            return Ok(Some(format!("is a fork of {}", origin.run)));
        }
        if record.is_fork(directory) {
            return Ok(Some("is a fork".to_owned()));
        }
        let first = record.changes.first();
        Ok(first.map(|change| format!("went on with other settings ({change})")))
    }

    /// Reads the record of a run directory.
    ///
    /// # Errors
    ///
    /// [`RecordError`]: it is missing, unreadable, or of a newer format.
    pub fn read(directory: &Path) -> Result<Self, RecordError> {
        let path = directory.join(RECORD);
        let unreadable = |what, source| Err(RecordError::Unreadable { what, source });
        let text = match regular::read_to_string(&path) {
            Ok(text) => text,
            Err(error) => return unreadable(format!("reading {}", path.display()), error),
        };
        let record: Self = match serde_json::from_str(&text) {
            Ok(record) => record,
            Err(error) => {
                let what = format!("{} is not the record of a run", path.display());
                return unreadable(what, error.into());
            }
        };
        if record.format > RUN_FORMAT {
            return Err(RecordError::Newer { path, found: record.format });
        }
        Ok(record)
    }

    /// Writes the record into a run directory.
    ///
    /// # Errors
    ///
    /// If the file cannot be written; the old one then stays.
    pub fn write(&self, directory: &Path) -> io::Result<()> {
        let mut text = serde_json::to_string_pretty(self).map_err(io::Error::other)?;
        text.push('\n');
        write_atomically(&directory.join(RECORD), text.as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn build(program: &str, cpu: &str) -> ProgramBuild {
        let (program, cpu) = (program.to_owned(), cpu.to_owned());
        ProgramBuild { program, cpu, ..ProgramBuild::default() }
    }

    fn record() -> RunRecord {
        RunRecord::begin("cart-1", "cartpole", 7, &build("a", "x86_64"))
    }

    #[test]
    fn a_record_survives_the_disk_a_newer_format_is_refused_and_an_older_one_is_read() {
        let dir = tempfile::tempdir().unwrap();
        let mut record = record();
        record.origin = Some(ForkOrigin { run: "r".to_owned(), weights_sha256: "00".to_owned() });
        record.write(dir.path()).unwrap();
        assert_eq!(RunRecord::read(dir.path()).unwrap(), record);
        RunRecord { format: RUN_FORMAT + 1, ..record }.write(dir.path()).unwrap();
        let error = RunRecord::read(dir.path()).unwrap_err().to_string();
        assert!(error.contains("use the newer release"), "{error}");
        let old = r#"{"format": 1, "name": "r", "domain": "cartpole", "seed": 1, "version": "0.1.0", "commit": "abc",
            "cpu": "x86_64", "threads": "1", "started": "2026-01-01T00:00:00Z", "resumed": 0, "result": null}"#;
        fs::write(dir.path().join(RECORD), old).unwrap();
        let mut old = RunRecord::read(dir.path()).unwrap();
        old.worked_on_by(&build("a", "x86_64"));
        assert_eq!(old.builds.len(), 2, "an unknown build is equal to none");
    }

    #[test]
    fn books_are_told_in_a_sentence() {
        let mut books = serde_json::json!({"published": 10, "trained": 8, "unused_at_end": 2, "refused": 0, "balanced": true});
        let told = "10 rollouts, 8 trained on, 2 unused at the end, all accounted for";
        assert_eq!(books_sentence(&books), told);
        books["balanced"] = false.into();
        assert!(books_sentence(&books).ends_with("NOT balanced"));
    }

    #[test]
    fn every_build_and_class_of_cpu_that_takes_over_is_on_record() {
        let mut record = record();
        let threads = "4".to_owned();
        record.worked_on_by(&ProgramBuild { threads, ..build("a", "x86_64") });
        assert_eq!(record.builds.len(), 1, "threads change no bit");
        record.worked_on_by(&build("b", "x86_64"));
        record.worked_on_by(&build("b", "aarch64"));
        assert_eq!(record.builds.len(), 3);
    }
}
