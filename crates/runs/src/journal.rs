//! `metrics.jsonl`: one JSON object per update, in order, without gaps or repetitions.
//!
//! ```text
//! {"update": 12, "steps": 6144, "time": "2026-01-31T12:00:00Z", "staleness": {"1": 8}, "train/entropy": 1.2, ...}
//! ```
//!
//! A learner that takes a run up again drops the lines of updates that were lost with its predecessor, all of them if
//! there was no checkpoint yet; they are made and written again.

use std::fmt;
use std::fs::{File, OpenOptions};
use std::io::{self, BufRead as _, BufReader, Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

use leadtime_learner::PartialFile;
use serde_json::{Map, Value};

use crate::regular;

/// The journal's file in a run directory.
pub(crate) const JOURNAL: &str = "metrics.jsonl";

/// The journal of a run, open to be written on.
#[derive(Debug)]
pub(crate) struct Journal {
    path: PathBuf,
    file: File,
    /// Whether the last write failed, and may have left a part of its line.
    is_torn: bool,
}

impl Journal {
    /// Opens the journal of a run directory for appending.
    pub(crate) fn open(run_directory: &Path) -> io::Result<Self> {
        let path = run_directory.join(JOURNAL);
        let file = regular::append_to(&path)?;
        Ok(Self { path, file, is_torn: false })
    }

    /// Drops every line about an update after `n_updates`, and what is no whole line. Returns the updates until then that have no
    /// line, if there are some. A journal may be larger than the memory: it is read line by line.
    pub(crate) fn rewind(&mut self, n_updates: u64) -> io::Result<Option<MissingUpdates>> {
        let (mut is_as_it_was, mut found) = (true, FoundUpdates::default());
        self.for_lines_until(n_updates, |line, kept| {
            // Of the last line only its end may be missing.
            is_as_it_was &= kept.is_some() && line.ends_with(b"\n");
            if let Some(update) = kept {
                found.take_in(update);
            }
            Ok(())
        })?;
        found.take_in(n_updates.saturating_add(1));
        if is_as_it_was {
            // Another file in its place would be taken for a rewind by those who follow it.
            return Ok(found.missing);
        }
        let mut kept = io::BufWriter::new(PartialFile::create(&self.path)?);
        self.for_lines_until(n_updates, |line, update| {
            if update.is_none() {
                return Ok(());
            }
            kept.write_all(line)?;
            if line.ends_with(b"\n") { Ok(()) } else { kept.write_all(b"\n") }
        })?;
        kept.into_inner().map_err(io::IntoInnerError::into_error)?.place()?;
        (self.file, self.is_torn) = (OpenOptions::new().append(true).open(&self.path)?, false);
        Ok(found.missing)
    }

    /// Goes through the journal, and tells of every line to which of the first `n_updates` updates it belongs, if to one of them.
    fn for_lines_until(
        &self,
        n_updates: u64,
        mut take: impl FnMut(&[u8], Option<u64>) -> io::Result<()>,
    ) -> io::Result<()> {
        lines(&self.path, |line| {
            let parsed = serde_json::from_slice::<Value>(line).ok();
            let update = parsed.and_then(|line| line["update"].as_u64());
            take(line, update.filter(|&update| update <= n_updates))
        })
    }

    /// Appends one update in a single write.
    pub(crate) fn append(&mut self, line: &Value) -> io::Result<()> {
        // What a full disk has left of an earlier line ends here, and not in this one.
        let end_before = if self.is_torn { "\n" } else { "" };
        let written = self.file.write_all(format!("{end_before}{line}\n").as_bytes());
        self.is_torn = written.is_err();
        written
    }
}

/// Updates of which a journal has no line: a full disk, or damage, has taken them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct MissingUpdates {
    first: u64,
    last: u64,
    n: u64,
}

impl fmt::Display for MissingUpdates {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { first, last, n } = self;
        match n {
            1 => write!(f, "update {first}"),
            n if *n == last - first + 1 => write!(f, "updates {first} to {last}"),
            n => write!(f, "{n} of the updates {first} to {last}"),
        }
    }
}

/// Follows the lines of a journal, and finds what is missing between them.
#[derive(Debug, Default)]
struct FoundUpdates {
    last: u64,
    missing: Option<MissingUpdates>,
}

impl FoundUpdates {
    fn take_in(&mut self, update: u64) {
        let (first, last) = (self.last + 1, update.saturating_sub(1));
        if first <= last {
            let missing = self.missing.get_or_insert(MissingUpdates { first, last, n: 0 });
            (missing.last, missing.n) = (last, missing.n + (last - first + 1));
        }
        self.last = self.last.max(update);
    }
}

/// Reads a run's journal, skipping what is no line of it.
///
/// # Errors
///
/// If the file cannot be read.
pub fn read(run_directory: &Path) -> io::Result<Vec<Map<String, Value>>> {
    let mut lines = Vec::new();
    for_each_line(run_directory, |line| lines.push(line))?;
    Ok(lines)
}

/// Hands the lines of a run's journal on, one at a time, skipping what is no line of it.
///
/// # Errors
///
/// If the file cannot be read.
pub(crate) fn for_each_line(
    run_directory: &Path,
    mut take: impl FnMut(Map<String, Value>),
) -> io::Result<()> {
    lines(&run_directory.join(JOURNAL), |line| {
        if let Ok(line) = serde_json::from_slice(line) {
            take(line);
        }
        Ok(())
    })
}

/// Reads a file line by line, with the end of each, however long it is.
fn lines(path: &Path, mut take: impl FnMut(&[u8]) -> io::Result<()>) -> io::Result<()> {
    let (mut file, mut line) = (BufReader::new(regular::open(path)?), Vec::new());
    while file.read_until(b'\n', &mut line)? > 0 {
        take(&line)?;
        line.clear();
    }
    Ok(())
}

/// The longest end of a journal that is read to find its last line, in bytes.
const TAIL: u64 = 16_384;

/// Returns a number of a run's last line; 0 if there is none.
///
/// # Errors
///
/// If there is a journal that cannot be read.
pub(crate) fn last(run_directory: &Path, key: &str) -> io::Result<u64> {
    Ok(last_line(run_directory)?.get(key).and_then(Value::as_u64).unwrap_or(0))
}

/// Returns a run's last line; an empty one if there is none. Only the end of the journal is read.
///
/// # Errors
///
/// If there is a journal that cannot be read.
pub(crate) fn last_line(run_directory: &Path) -> io::Result<Map<String, Value>> {
    let Some(tail) = regular::if_there(tail(run_directory))? else { return Ok(Map::new()) };
    let mut lines = tail.rsplit(|&byte| byte == b'\n');
    Ok(lines.find_map(|line| serde_json::from_slice(line).ok()).unwrap_or_default())
}

fn tail(run_directory: &Path) -> io::Result<Vec<u8>> {
    let mut file = regular::open(&run_directory.join(JOURNAL))?;
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
        assert_eq!(last(dir.path(), "steps").unwrap(), 0);
        let mut journal = Journal::open(dir.path()).unwrap();
        let append = |journal: &mut Journal, update: u64| {
            journal.append(&json!({"update": update, "steps": update * 128})).unwrap();
        };
        (1..=600).for_each(|update| append(&mut journal, update));
        journal.file.write_all(b"{\"update\": 601, \"ste").unwrap();
        assert_eq!(last(dir.path(), "steps").unwrap(), 600 * 128);
        // A power cut may leave bytes that are no text at all.
        journal.file.write_all(b"\xff\xfe\0\n").unwrap();
        assert_eq!(read(dir.path()).unwrap().len(), 600);
        journal.rewind(3).unwrap();
        append(&mut journal, 4);
        let lines = read(dir.path()).unwrap();
        assert!(lines.iter().map(|line| line["update"].as_u64().unwrap()).eq(1..=4), "{lines:?}");
    }

    #[test]
    fn a_line_after_one_that_could_not_be_written_stands_alone() {
        let dir = tempfile::tempdir().unwrap();
        let mut journal = Journal::open(dir.path()).unwrap();
        journal.append(&json!({"update": 1})).unwrap();
        // The part for which there was room.
        journal.file.write_all(b"{\"upda").unwrap();
        let full = File::options().write(true).open("/dev/full").unwrap();
        let whole = std::mem::replace(&mut journal.file, full);
        journal.append(&json!({"update": 2})).unwrap_err();
        journal.file = whole;
        (3..=4).for_each(|update| journal.append(&json!({"update": update})).unwrap());
        let updates = |journal: &[Map<String, Value>]| -> Vec<u64> {
            journal.iter().map(|line| line["update"].as_u64().unwrap()).collect()
        };
        assert_eq!(updates(&read(dir.path()).unwrap()), [1, 3, 4]);
        // Killed between a line and its end.
        journal.file.write_all(b"{\"update\": 5}").unwrap();
        journal.rewind(5).unwrap();
        journal.append(&json!({"update": 6})).unwrap();
        assert_eq!(updates(&read(dir.path()).unwrap()), [1, 3, 4, 5, 6]);
    }

    #[test]
    fn a_rewind_tells_of_which_updates_the_journal_has_no_line() {
        let missing = |updates: &[u64], n_updates: u64| {
            let dir = tempfile::tempdir().unwrap();
            let mut journal = Journal::open(dir.path()).unwrap();
            for update in updates {
                journal.append(&json!({"update": update})).unwrap();
            }
            journal.file.write_all(b"{\"update\": 9, \"sta").unwrap();
            let told = [(); 2].map(|()| journal.rewind(n_updates).unwrap());
            assert_eq!(told[0], told[1], "also where nothing is dropped");
            told[0].map(|missing| missing.to_string())
        };
        assert_eq!(missing(&[], 0), None);
        assert_eq!(missing(&[1, 2, 3, 4], 3), None);
        assert_eq!(missing(&[1, 2, 2, 3], 3), None, "written twice");
        assert_eq!(missing(&[1, 3], 3).unwrap(), "update 2");
        assert_eq!(missing(&[3, 4, 5], 5).unwrap(), "updates 1 to 2");
        assert_eq!(missing(&[1, 9], 6).unwrap(), "updates 2 to 6");
        assert_eq!(missing(&[2, 3], 6).unwrap(), "4 of the updates 1 to 6");
    }

    #[test]
    fn a_journal_that_leads_nowhere_says_where() {
        let dir = tempfile::tempdir().unwrap();
        std::os::unix::fs::symlink("/nowhere/m", dir.path().join("metrics.jsonl")).unwrap();
        let error = Journal::open(dir.path()).unwrap_err().to_string();
        assert_eq!(error, "metrics.jsonl is a link to /nowhere/m, and nothing is there");
        assert_eq!(last(dir.path(), "update").unwrap(), 0, "to a reader it is not there");
    }
}
