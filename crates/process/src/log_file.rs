//! The log file, reopened after it was moved away.
//!
//! A program that rotates logs renames the file and may send SIGHUP. Without one the new file is noticed at a line a second later. A line
//! that cannot be written is dropped.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write as _};
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use rustix::fs::{OFlags, fcntl_setfl};
use rustix::io::Errno;
use tokio::signal::unix::{SignalKind, signal};

/// How often it is looked whether the file is still the one that its name says.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// The log file of this process; none until one is opened.
static LOG: OnceLock<LogFile> = OnceLock::new();

/// A log file, which is opened again once its path names another one.
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
    let mut options = OpenOptions::new();
    // A pipe that nobody reads would keep the whole program waiting.
    options.create(true).append(true).custom_flags(OFlags::NONBLOCK.bits().cast_signed());
    let file = options.open(path).map_err(|error| {
        let is_pipe = fs::metadata(path).is_ok_and(|found| found.file_type().is_fifo());
        if is_pipe && error.raw_os_error() == Some(Errno::NXIO.raw_os_error()) {
            return io::Error::new(error.kind(), "it is a pipe that nobody reads");
        }
        error
    })?;
    fcntl_setfl(&file, OFlags::APPEND)?;
    Ok(file)
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
    use std::io::Read as _;
    use std::process::Command;

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

    #[test]
    fn a_pipe_that_nobody_reads_is_refused_and_one_that_is_read_gets_the_lines() {
        let directory = tempfile::tempdir().unwrap();
        let pipe = directory.path().join("pipe");
        assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let error = LogFile::open(&pipe).unwrap_err().to_string();
        assert_eq!(error, "it is a pipe that nobody reads");
        // For both ends, so that nobody waits here either.
        let mut reader = File::options().read(true).write(true).open(&pipe).unwrap();
        LogFile::open(&pipe).unwrap().write(b"one\n");
        let mut line = [0; 4];
        reader.read_exact(&mut line).unwrap();
        assert_eq!(&line, b"one\n");
    }
}
