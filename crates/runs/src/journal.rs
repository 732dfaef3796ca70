//! `metrics.jsonl`: one JSON object per update, in order, without gaps or repetitions.
//!
//! ```text
//! {"update": 12, "steps": 6144, "time": "2026-01-31T12:00:00Z", "staleness": {"1": 8}, "train/entropy": 1.2, ...}
//! ```
//!
//! A learner that takes a run up again drops the lines of updates that were lost with its predecessor, all of them if
//! there was no checkpoint yet; they are made and written again.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::{Map, Value};

/// The open journal.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: File,
}

/// What is needed of a line to place it.
#[derive(Deserialize)]
struct Line {
    update: u64,
}

impl Journal {
    /// Opens the journal of a run directory for appending.
    ///
    /// # Errors
    ///
    /// If the file cannot be made or opened.
    pub fn open(run_directory: &Path) -> io::Result<Self> {
        let path = run_directory.join("metrics.jsonl");
        let file = OpenOptions::new().create(true).append(true).open(&path)?;
        Ok(Self { path, file })
    }

    /// Drops every line about an update after `n_updates`, and a torn last line.
    ///
    /// # Errors
    ///
    /// If the file cannot be read or replaced.
    pub fn rewind(&mut self, n_updates: u64) -> io::Result<()> {
        let text = fs::read_to_string(&self.path)?;
        let belongs = |line: &str| {
            serde_json::from_str::<Line>(line).is_ok_and(|line| line.update <= n_updates)
        };
        let kept: String =
            text.split_inclusive('\n').filter(|line| belongs(line.trim_end())).collect();
        leadtime_learner::write_atomically(&self.path, kept.as_bytes())?;
        self.file = OpenOptions::new().append(true).open(&self.path)?;
        Ok(())
    }

    /// Appends one update in a single write.
    ///
    /// # Errors
    ///
    /// If the line cannot be written.
    pub fn append(&mut self, line: Map<String, Value>) -> io::Result<()> {
        let mut text = Value::Object(line).to_string();
        text.push('\n');
        self.file.write_all(text.as_bytes())
    }
}

/// Reads a run's journal, skipping what is no line of it.
///
/// # Errors
///
/// If the file cannot be read.
pub fn read(run_directory: &Path) -> io::Result<Vec<Map<String, Value>>> {
    let text = fs::read_to_string(run_directory.join("metrics.jsonl"))?;
    Ok(text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect())
}

/// The longest end of a journal that is read to find its last line, in bytes.
const TAIL: u64 = 16_384;

/// Returns the steps of a run's last update; 0 before the first.
pub fn last_steps(run_directory: &Path) -> u64 {
    last(run_directory, "steps")
}

/// Returns the number of a run's last update; 0 before the first.
pub fn last_update(run_directory: &Path) -> u64 {
    last(run_directory, "update")
}

fn last(run_directory: &Path, key: &str) -> u64 {
    let line = tail(run_directory).unwrap_or_default();
    line.get(key).and_then(Value::as_u64).unwrap_or(0)
}

fn tail(run_directory: &Path) -> io::Result<Map<String, Value>> {
    let mut file = File::open(run_directory.join("metrics.jsonl"))?;
    let length = file.metadata()?.len();
    file.seek(SeekFrom::Start(length.saturating_sub(TAIL)))?;
    let mut bytes = Vec::new();
    file.take(TAIL).read_to_end(&mut bytes)?;
    let text = String::from_utf8_lossy(&bytes);
    let last = text.lines().rev().find_map(|line| serde_json::from_str(line).ok());
    Ok(last.unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(update: u64) -> Map<String, Value> {
        Map::from_iter([("update".to_owned(), Value::from(update))])
    }

    #[test]
    fn the_last_whole_line_tells_how_far_a_run_is() {
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(last_steps(dir.path()), 0);
        let mut journal = Journal::open(dir.path()).unwrap();
        for update in 1..=600 {
            let mut whole = line(update);
            whole.insert("steps".to_owned(), (update * 128).into());
            journal.append(whole).unwrap();
        }
        journal.file.write_all(b"{\"update\": 601, \"ste").unwrap();
        assert_eq!(last_steps(dir.path()), 600 * 128);
    }

    #[test]
    fn a_rewound_journal_has_no_gap_and_no_repetition() {
        let dir = tempfile::tempdir().unwrap();
        let mut journal = Journal::open(dir.path()).unwrap();
        for update in 1..=5 {
            journal.append(line(update)).unwrap();
        }
        journal.file.write_all(b"{\"update\": 6, \"tor").unwrap();
        journal.rewind(3).unwrap();
        journal.append(line(4)).unwrap();
        let updates: Vec<u64> =
            read(dir.path()).unwrap().iter().map(|line| line["update"].as_u64().unwrap()).collect();
        assert_eq!(updates, [1, 2, 3, 4]);
    }
}
