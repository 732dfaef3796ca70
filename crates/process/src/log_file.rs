//! The log file, reopened after it was moved away.
//!
//! A program that rotates logs renames the file and may send SIGHUP. Without one the new file is noticed at a line a second later. A line
//! that cannot be written is dropped.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write as _};
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use tokio::signal::unix::{SignalKind, signal};

/// How often it is looked whether the file is still the one that its name says.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// The log file of this process; none until one is opened.
static LOG: OnceLock<LogFile> = OnceLock::new();

/// A log file.
#[derive(Debug)]
struct LogFile {
    path: PathBuf,
    open: Mutex<OpenLog>,
}

#[derive(Debug)]
struct OpenLog {
    file: File,
    looked: Instant,
}

impl LogFile {
    fn open(path: &Path) -> io::Result<Self> {
        let file = append_to(path)?;
        let open = Mutex::new(OpenLog { file, looked: Instant::now() });
        Ok(Self { path: path.to_owned(), open })
    }

    fn lock(&self) -> MutexGuard<'_, OpenLog> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reopens the file; the old one stays open if that fails.
    fn reopen(&self, open: &mut OpenLog) {
        if let Ok(file) = append_to(&self.path) {
            open.file = file;
        }
    }

    fn write(&self, bytes: &[u8]) {
        let mut open = self.lock();
        if open.looked.elapsed() >= LOOK_EVERY {
            open.looked = Instant::now();
            if self.was_moved(&open.file) {
                self.reopen(&mut open);
            }
        }
        drop(open.file.write_all(bytes));
    }

    fn was_moved(&self, file: &File) -> bool {
        let identity = |found: fs::Metadata| (found.dev(), found.ino());
        let ours = file.metadata().ok().map(identity);
        ours != fs::metadata(&self.path).ok().map(identity)
    }
}

fn append_to(path: &Path) -> io::Result<File> {
    OpenOptions::new().create(true).append(true).open(path)
}

/// Sends the log of this process to a file from now on.
///
/// # Errors
///
/// If the file cannot be opened, or the log goes to one already.
pub fn open(path: &Path) -> io::Result<()> {
    let file = LogFile::open(path)?;
    // There is one command per process, so nobody has set it before.
    LOG.set(file).map_err(|_set| io::ErrorKind::AlreadyExists.into())
}

/// Writes lines to the log file. Returns false if there is none.
pub(crate) fn write(bytes: &[u8]) -> bool {
    LOG.get().map(|log| log.write(bytes)).is_some()
}

/// Reopens the log file at every SIGHUP from now on. Returns `false` without a log file.
pub(crate) fn reopen_on_hangup() -> io::Result<bool> {
    let Some(log) = LOG.get() else { return Ok(false) };
    let mut hangups = signal(SignalKind::hangup())?;
    tokio::spawn(async move {
        while hangups.recv().await.is_some() {
            log.reopen(&mut log.lock());
        }
    });
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_was_moved_away_is_made_anew() {
        let directory = tempfile::tempdir().unwrap();
        let [path, moved] = ["log", "log.1"].map(|name| directory.path().join(name));
        let log = LogFile::open(&path).unwrap();
        log.write(b"one\n");
        fs::rename(&path, &moved).unwrap();
        log.write(b"two\n");
        log.lock().looked = Instant::now().checked_sub(LOOK_EVERY).unwrap();
        log.write(b"three\n");
        assert_eq!(fs::read_to_string(&moved).unwrap(), "one\ntwo\n");
        assert_eq!(fs::read_to_string(&path).unwrap(), "three\n");
        fs::rename(&path, &moved).unwrap();
        log.reopen(&mut log.lock());
        log.write(b"four\n");
        assert_eq!(fs::read_to_string(&path).unwrap(), "four\n");
        assert!(LogFile::open(&directory.path().join("no/log")).is_err());
    }
}
