//! `run.json`: what a run is, where it ran and how it ended; written whole, never half.

use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::Path;

use anyhow::Context as _;
use serde::{Deserialize, Serialize};

use crate::{build_id, clock, cpu, threads};

/// The format of a run directory; a newer one is refused with a sentence.
pub const RUN_FORMAT: u32 = 1;

/// The record of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunRecord {
    /// [`RUN_FORMAT`] of the program that made the directory.
    pub format: u32,
    /// The run's name.
    pub name: String,
    /// What it trains on.
    pub domain: String,
    /// Seed of every random stream.
    pub seed: u64,
    /// Release of the program.
    pub version: String,
    /// Commit that the program was built from, if known.
    pub commit: Option<String>,
    /// Class of the learner's CPU: equal classes give equal bits.
    pub cpu: String,
    /// `RAYON_NUM_THREADS` of the learner.
    pub threads: String,
    /// When the run began, UTC.
    pub started: String,
    /// How often a learner took the run up again.
    pub resumed: u32,
    /// How it ended; `None` while it is unfinished.
    pub result: Option<RunResult>,
}

/// What a finished run came to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunResult {
    /// When, UTC.
    pub finished: String,
    /// Optimiser iterations.
    pub updates: u64,
    /// Steps trained on.
    pub steps: u64,
    /// SHA-256 over the final parameters, in hexadecimal: equal for equal seeds in `sync` and `lag`.
    pub weights_sha256: String,
    /// Whether the same seed would give the same bits again: a deterministic schedule, one
    /// build of the program, one class of CPU.
    pub reproducible: bool,
    /// The books, as JSON.
    pub books: serde_json::Value,
}

impl RunRecord {
    /// Starts the record of a new run on this machine.
    pub fn begin(name: &str, domain: &str, seed: u64) -> Self {
        Self {
            format: RUN_FORMAT,
            name: name.to_owned(),
            domain: domain.to_owned(),
            seed,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            commit: build_id::COMMIT.map(str::to_owned),
            cpu: cpu::fingerprint(),
            threads: threads::configured(),
            started: clock::utc_now(),
            resumed: 0,
            result: None,
        }
    }

    /// Reads `run.json`.
    ///
    /// # Errors
    ///
    /// A missing, unreadable or newer record, with its path.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let text =
            fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
        let record: Self = serde_json::from_str(&text)
            .with_context(|| format!("{} is not the record of a run", path.display()))?;
        anyhow::ensure!(
            record.format <= RUN_FORMAT,
            "{} has format {}, this release reads up to {RUN_FORMAT}: use the newer release",
            path.display(),
            record.format
        );
        Ok(record)
    }

    /// Writes `run.json`.
    ///
    /// # Errors
    ///
    /// Whatever the file system says.
    pub fn write(&self, path: &Path) -> io::Result<()> {
        let mut text = serde_json::to_string_pretty(self).map_err(io::Error::other)?;
        text.push('\n');
        write_atomically(path, text.as_bytes())
    }
}

/// Replaces a file by another in one step: whoever reads it sees the old or the new content, whole.
///
/// # Errors
///
/// Whatever the file system says; the old content then stays.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut beside = path.as_os_str().to_owned();
    beside.push(".tmp");
    let mut file = File::create(&beside)?;
    file.write_all(bytes)?;
    file.sync_all()?;
    fs::rename(&beside, path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_survives_the_disk() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("run.json");
        let record = RunRecord::begin("cart-1", "cartpole", 7);
        record.write(&path).unwrap();
        assert_eq!(RunRecord::read(&path).unwrap(), record);
    }

    #[test]
    fn a_newer_format_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("run.json");
        let record = RunRecord { format: RUN_FORMAT + 1, ..RunRecord::begin("a", "cartpole", 7) };
        record.write(&path).unwrap();
        let error = RunRecord::read(&path).unwrap_err().to_string();
        assert!(error.contains("use the newer release"), "{error}");
    }
}
