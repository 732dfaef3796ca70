//! What lies in a run's directory, read for its report.

use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use crate::layout::{read_config, read_record};
use crate::{RunDirError, RunRecord, held_out, journal, name_in_place};

/// Updates of a quick run, which checks the mechanics only.
pub const QUICK_UPDATES: u64 = 12;

/// What lies in a run's directory.
#[derive(Debug)]
pub struct RunFiles {
    /// The run's directory, as it was named.
    pub directory: PathBuf,
    name: String,
    pub(crate) record: RunRecord,
    pub(crate) journal: Vec<Map<String, Value>>,
    /// Evaluations on held-out episodes.
    pub(crate) held_out: Vec<Map<String, Value>>,
    pub(crate) config: toml::Table,
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
        let io = |source| RunDirError::Io { path: directory.join("metrics.jsonl"), source };
        let journal = journal::read(&directory).map_err(io)?;
        let held_out = held_out::read(&directory);
        let name = name_in_place(&directory, &record);
        Ok(Self { directory, name, record, journal, held_out, config })
    }

    /// Returns the run's name: its directory's.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns how many updates the run has done.
    pub(crate) fn n_updates(&self) -> u64 {
        self.journal.last().and_then(|line| line.get("update")?.as_u64()).unwrap_or(0)
    }

    /// Tells whether the run was only to check the mechanics, and did nothing more.
    pub(crate) fn is_quick(&self) -> bool {
        self.record.quick && self.n_updates() <= QUICK_UPDATES
    }
}
