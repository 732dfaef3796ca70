//! `metrics.jsonl`: one JSON object per update, in order, without gaps or repetitions.
//!
//! ```text
//! {"update": 12, "steps": 6144, "time": "2026-01-31T12:00:00Z", "staleness": {"1": 8}, "train/entropy": 1.2, ...}
//! ```
//!
//! A learner that takes a run up again drops the lines of updates that were lost with its predecessor, all of them if
//! there was no checkpoint yet; they are made and written again.

use std::fs::{File, OpenOptions};
use std::io::{self, Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use crate::regular;

/// The journal of a run, open to be written on.
#[derive(Debug)]
pub(crate) struct Journal {
    path: PathBuf,
    file: File,
}

impl Journal {
    /// Opens the journal of a run directory for appending.
    pub(crate) fn open(run_directory: &Path) -> io::Result<Self> {
        let path = run_directory.join("metrics.jsonl");
        let file = regular::append_to(&path)?;
        Ok(Self { path, file })
    }

    /// Drops every line about an update after `n_updates`, and a torn last line.
    pub(crate) fn rewind(&mut self, n_updates: u64) -> io::Result<()> {
        let bytes = regular::read(&self.path)?;
        let belongs = |line: &&[u8]| {
            let update =
                serde_json::from_slice(line).ok().and_then(|line: Value| line["update"].as_u64());
            update.is_some_and(|update| update <= n_updates)
        };
        let kept: Vec<&[u8]> =
            bytes.split_inclusive(|&byte| byte == b'\n').filter(belongs).collect();
        let kept = kept.concat();
        if kept.len() == bytes.len() {
            // Another file in its place would be taken for a rewind by those who follow it.
            return Ok(());
        }
        leadtime_learner::write_atomically(&self.path, &kept)?;
        self.file = OpenOptions::new().append(true).open(&self.path)?;
        Ok(())
    }

    /// Appends one update in a single write.
    pub(crate) fn append(&mut self, line: &Value) -> io::Result<()> {
        self.file.write_all(format!("{line}\n").as_bytes())
    }
}

/// Reads a run's journal, skipping what is no line of it.
///
/// # Errors
///
/// If the file cannot be read.
pub fn read(run_directory: &Path) -> io::Result<Vec<Map<String, Value>>> {
    let bytes = regular::read(&run_directory.join("metrics.jsonl"))?;
    let lines = bytes.split(|&byte| byte == b'\n');
    Ok(lines.filter_map(|line| serde_json::from_slice(line).ok()).collect())
}

/// The longest end of a journal that is read to find its last line, in bytes.
const TAIL: u64 = 16_384;

/// Returns the steps of a run's last update; 0 before the first.
pub fn last_steps(run_directory: &Path) -> u64 {
    last(run_directory, "steps").unwrap_or(0)
}

/// Returns the number of a run's last update; 0 before the first.
pub fn last_update(run_directory: &Path) -> u64 {
    last(run_directory, "update").unwrap_or(0)
}

/// Returns a number of a run's last line; 0 if there is none.
///
/// # Errors
///
/// If there is a journal that cannot be read.
pub(crate) fn last(run_directory: &Path, key: &str) -> io::Result<u64> {
    let Some(tail) = regular::if_there(tail(run_directory))? else { return Ok(0) };
    let text = String::from_utf8_lossy(&tail);
    let mut lines = text.lines().rev();
    let line = lines.find_map(|line| serde_json::from_str::<Map<String, Value>>(line).ok());
    Ok(line.and_then(|line| line.get(key)?.as_u64()).unwrap_or(0))
}

fn tail(run_directory: &Path) -> io::Result<Vec<u8>> {
    let mut file = regular::open(&run_directory.join("metrics.jsonl"))?;
    let length = file.metadata()?.len();
    file.seek(SeekFrom::Start(length.saturating_sub(TAIL)))?;
    let mut bytes = Vec::new();
    file.take(TAIL).read_to_end(&mut bytes)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_last_whole_line_tells_how_far_a_run_is_and_a_rewound_journal_has_no_gap_and_no_repetition()
     {
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(last_steps(dir.path()), 0);
        let mut journal = Journal::open(dir.path()).unwrap();
        let append = |journal: &mut Journal, update: u64| {
            journal.append(&json!({"update": update, "steps": update * 128})).unwrap();
        };
        (1..=600).for_each(|update| append(&mut journal, update));
        journal.file.write_all(b"{\"update\": 601, \"ste").unwrap();
        assert_eq!(last_steps(dir.path()), 600 * 128);
        // A power cut may leave bytes that are no text at all.
        journal.file.write_all(b"\xff\xfe\0\n").unwrap();
        assert_eq!(read(dir.path()).unwrap().len(), 600);
        journal.rewind(3).unwrap();
        append(&mut journal, 4);
        let lines = read(dir.path()).unwrap();
        assert!(lines.iter().map(|line| line["update"].as_u64().unwrap()).eq(1..=4), "{lines:?}");
    }

    #[test]
    fn a_journal_that_leads_nowhere_says_where() {
        let dir = tempfile::tempdir().unwrap();
        std::os::unix::fs::symlink("/nowhere/m", dir.path().join("metrics.jsonl")).unwrap();
        let error = Journal::open(dir.path()).unwrap_err().to_string();
        assert_eq!(error, "metrics.jsonl is a link to /nowhere/m, and nothing is there");
        assert_eq!(last_update(dir.path()), 0, "to a reader it is not there");
    }
}
