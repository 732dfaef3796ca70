//! What lies in a run's directory, read for its report.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use crate::journal::JOURNAL;
use crate::layout::{n_updates_with, read_config, read_record};
use crate::{RunDirError, RunRecord, held_out, journal, name_in_place};

/// Updates of a quick run, which checks the mechanics only.
pub const QUICK_UPDATES: u64 = 12;

/// What is drawn of a journal over the steps.
const DRAWN: [&str; 5] =
    ["episodes/success", "episodes/return", "episodes/length", "train/entropy", "train/approx_kl"];
/// What is summed up over a journal.
const SUMMED: [&str; 2] = ["system/train_seconds", "system/wait_seconds"];

/// What a report says of a journal. The whole of it may be larger than the memory of a learner.
#[derive(Debug, Default)]
pub(crate) struct JournalSummary {
    /// Steps and value of every update, by what is drawn.
    curves: BTreeMap<&'static str, Vec<[f64; 2]>>,
    sums: BTreeMap<&'static str, f64>,
    /// How many rollouts were so many versions old.
    pub(crate) staleness: BTreeMap<u64, u64>,
}

impl JournalSummary {
    fn read(directory: &Path) -> io::Result<Self> {
        let mut summary = Self::default();
        journal::for_each_line(directory, |line| summary.take_in(&line))?;
        Ok(summary)
    }

    fn take_in(&mut self, line: &Map<String, Value>) {
        for key in DRAWN {
            self.curves.entry(key).or_default().extend(point(line, key));
        }
        for key in SUMMED {
            *self.sums.entry(key).or_default() +=
                line.get(key).and_then(Value::as_f64).unwrap_or(0.0);
        }
        let of_line = line.get("staleness").and_then(Value::as_object);
        for (staleness, n) in of_line.into_iter().flatten() {
            if let (Ok(staleness), Some(n)) = (staleness.parse(), n.as_u64()) {
                *self.staleness.entry(staleness).or_default() += n;
            }
        }
    }

    /// Returns the curve of one of [`DRAWN`].
    pub(crate) fn curve(&self, key: &str) -> &[[f64; 2]] {
        self.curves.get(key).map(Vec::as_slice).unwrap_or_default()
    }

    /// Returns the sum of one of [`SUMMED`].
    pub(crate) fn sum(&self, key: &str) -> f64 {
        self.sums.get(key).copied().unwrap_or_default()
    }
}

/// Returns what a line says of a curve: steps and value.
pub(crate) fn point(line: &Map<String, Value>, key: &str) -> Option<[f64; 2]> {
    Some([line.get("steps")?.as_f64()?, line.get(key)?.as_f64()?])
}

/// What lies in a run's directory.
#[derive(Debug)]
pub struct RunFiles {
    /// The run's directory, as it was named.
    pub directory: PathBuf,
    name: String,
    pub(crate) record: RunRecord,
    pub(crate) journal: JournalSummary,
    /// Evaluations on held-out episodes.
    pub(crate) held_out: Vec<Map<String, Value>>,
    pub(crate) config: toml::Table,
    n_updates: u64,
}

impl RunFiles {
    /// Reads a run's record, journal and configuration.
    ///
    /// # Errors
    ///
    /// [`RunDirError`] if one of them is missing or cannot be read.
    pub fn read(directory: &Path) -> Result<Self, RunDirError> {
        let directory = directory.to_owned();
        let (record, config) = (read_record(&directory)?, read_config(&directory)?);
        let io = |source| RunDirError::Io { path: directory.join(JOURNAL), source };
        let journal = JournalSummary::read(&directory).map_err(io)?;
        let held_out = held_out::read(&directory);
        let name = name_in_place(&directory, &record);
        let n_updates = n_updates_with(&directory, record.result.as_ref());
        Ok(Self { directory, name, record, journal, held_out, config, n_updates })
    }

    /// Returns the run's name: its directory's.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns how many updates the run has done.
    pub(crate) fn n_updates(&self) -> u64 {
        self.n_updates
    }

    /// Tells whether the run was only to check the mechanics, and did nothing more.
    pub(crate) fn is_quick(&self) -> bool {
        self.record.quick && self.n_updates() <= QUICK_UPDATES
    }
}
