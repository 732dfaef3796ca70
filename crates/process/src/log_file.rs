//! The log file, reopened after it was moved away.
//!
//! A program that rotates logs renames the file and may send SIGHUP. Without one the new file is noticed at a line a second later. A line
//! that cannot be written, on a full disk or into a pipe whose reader has stopped, is dropped: the process never waits for its log.
//! Once lines can be written again, one says how many are missing.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write as _};
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use leadtime_proto::phrase::counted;
use leadtime_runs::clock;
use rustix::fs::{OFlags, fcntl_setfl};
use rustix::io::Errno;
use serde_json::Map;
use tokio::signal::unix::{SignalKind, signal};

use crate::log_line::json_line;

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
    /// Lines that could not be written since the last one that could.
    n_dropped: u64,
    /// The last line in the file has no end.
    is_torn: bool,
}

impl OpenLog {
    /// Writes a line, or drops it.
    fn put(&mut self, line: &[u8]) {
        if self.n_dropped > 0 && self.write_whole(missing(self.n_dropped, line).as_bytes()) {
            self.n_dropped = 0;
        }
        // As long as it was not said that lines are missing, none follows them.
        if self.n_dropped > 0 || !self.write_whole(line) {
            self.n_dropped += 1;
        }
    }

    /// Writes a line; `false` if that is not possible now.
    fn write_whole(&mut self, line: &[u8]) -> bool {
        let end_before: &[u8] = if self.is_torn { b"\n" } else { b"" };
        let whole = [end_before, line].concat();
        let mut rest = whole.as_slice();
        while !rest.is_empty() {
            match self.file.write(rest) {
                Ok(n) if n > 0 => rest = &rest[n..],
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Ok(_) | Err(_) => break,
            }
        }
        if rest.len() < whole.len() {
            self.is_torn = !rest.is_empty();
        }
        rest.is_empty()
    }
}

/// Says how many lines are missing, in the form of the line that comes next.
fn missing(n: u64, next: &[u8]) -> String {
    let message = format!("{} of the log could not be written", counted(n, "line"));
    if next.starts_with(b"{") {
        return format!("{}\n", json_line("warn", module_path!(), &message, Map::new()));
    }
    format!("{}  WARN {message}\n", clock::utc_now())
}

impl LogFile {
    fn open(path: &Path) -> io::Result<Self> {
        let file = append_to(path)?;
        let open = OpenLog { file, looked: Instant::now(), n_dropped: 0, is_torn: false };
        Ok(Self { path: path.to_owned(), open: Mutex::new(open) })
    }

    fn lock(&self) -> MutexGuard<'_, OpenLog> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reopens the file; the old one stays open if that fails.
    fn reopen(&self, open: &mut OpenLog) {
        if let Ok(file) = append_to(&self.path) {
            (open.file, open.is_torn) = (file, false);
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
        open.put(bytes);
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
    // One whose reader has stopped would do the same as soon as it is full, and so would a terminal that is halted.
    if file.metadata()?.is_file() {
        fcntl_setfl(&file, OFlags::APPEND)?;
    }
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

    #[test]
    fn a_pipe_whose_reader_stops_blocks_nobody_and_the_missing_lines_are_counted() {
        let directory = tempfile::tempdir().unwrap();
        let pipe = directory.path().join("pipe");
        assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let mut reader = File::options();
        reader.read(true).custom_flags(OFlags::NONBLOCK.bits().cast_signed());
        let mut reader = reader.open(&pipe).unwrap();
        let mut read = || {
            let (mut text, mut buffer) = (Vec::new(), [0; 4_096]);
            while let Ok(n @ 1..) = reader.read(&mut buffer) {
                text.extend_from_slice(&buffer[..n]);
            }
            String::from_utf8(text).unwrap()
        };
        let log = LogFile::open(&pipe).unwrap();
        let line = "x".repeat(99) + "\n";
        for _ in 0..20_000 {
            log.write(line.as_bytes());
        }
        let mut text = read();
        log.write(b"last\n");
        text += &read();
        assert!(text.ends_with(" could not be written\nlast\n"), "{text}");
        let n_kept = text.lines().filter(|kept| *kept == line.trim_end()).count();
        let missing = text.lines().filter_map(|told| {
            told.split_once("  WARN ")?.1.split(' ').next()?.parse::<usize>().ok()
        });
        assert_eq!(n_kept + missing.sum::<usize>(), 20_000);

        // A line for which there is only some room is ended before the next one.
        let long = "y".repeat(4 << 20) + "\n";
        log.write(long.as_bytes());
        assert!(read().starts_with('y'));
        log.write(b"{}\n");
        let rest = read();
        let lines: Vec<&str> = rest.lines().collect();
        assert!(lines.len() == 3 && lines[0].is_empty() && lines[2] == "{}", "{rest}");
        let told = "\"message\":\"1 line of the log could not be written\"";
        assert!(lines[1].contains(told), "{rest}");
    }
}
