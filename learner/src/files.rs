//! Files that are whole or not there.

use std::fs::{self, File, TryLockError};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

/// How the name of a file ends that is being written.
const PARTIAL: &str = ".partial";

/// Replaces a file in one step: a reader sees the old or the new content, whole, also after a power cut.
///
/// The content is written next to its place as `<name>.<process id>.partial`, flushed to the disk and renamed, and the
/// directory is flushed. So processes that replace one file at the same time do not disturb each other.
///
/// # Errors
///
/// If the directory cannot be written or the disk is full; the old content then stays.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = PartialFile::create(path)?;
    file.write_all(bytes)?;
    file.place()
}

/// A file that is written piece by piece and replaces another one in one step, as [`write_atomically`] does; removed if it is let
/// go before. A process that is killed leaves `<name>.<process id>.partial` behind.
#[derive(Debug)]
pub struct PartialFile {
    path: PathBuf,
    partial: PathBuf,
    file: File,
    is_placed: bool,
}

impl PartialFile {
    /// Begins a file that will be at this path.
    ///
    /// # Errors
    ///
    /// If the directory cannot be written.
    pub fn create(path: &Path) -> io::Result<Self> {
        let mut partial = path.as_os_str().to_owned();
        partial.push(format!(".{}{PARTIAL}", std::process::id()));
        let partial = PathBuf::from(partial);
        // What a killed process of the same id has left is in the way. A link or a pipe in its place is not written to.
        if partial.symlink_metadata().is_ok() {
            fs::remove_file(&partial)?;
        }
        let file = File::create_new(&partial)?;
        Ok(Self { path: path.to_owned(), partial, file, is_placed: false })
    }

    /// Puts the file where it belongs.
    ///
    /// # Errors
    ///
    /// If it cannot be flushed to the disk or renamed; the old content then stays, unless it is only the directory that cannot be
    /// flushed.
    pub fn place(mut self) -> io::Result<()> {
        self.file.sync_all()?;
        fs::rename(&self.partial, &self.path)?;
        self.is_placed = true;
        let directory = self.path.parent().filter(|parent| !parent.as_os_str().is_empty());
        File::open(directory.unwrap_or(Path::new(".")))?.sync_all()
    }
}

impl Write for PartialFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Drop for PartialFile {
    fn drop(&mut self) {
        if !self.is_placed {
            // A full disk needs the room.
            drop(fs::remove_file(&self.partial));
        }
    }
}

/// Returns which file of the same directory `name` was to replace, if [`write_atomically`] gave it that name.
///
/// # Example
///
/// ```
/// use leadtime_learner::replaced_name;
///
/// assert_eq!(replaced_name("run.json.12.partial"), Some("run.json"));
/// assert_eq!(replaced_name("run.json"), None);
/// ```
pub fn replaced_name(name: &str) -> Option<&str> {
    let name = name.strip_suffix(PARTIAL)?;
    // An earlier release wrote no process id.
    let id = name.rsplit_once('.').filter(|(_, id)| id.bytes().all(|byte| byte.is_ascii_digit()));
    Some(id.map_or(name, |(name, _)| name))
}

/// How often a lock is looked for again. A program that another thread is just starting holds copies of all open files until it
/// begins, so a lock that was let go may live on for a moment.
const N_LOCK_LOOKS: u32 = 10;
/// The pause before that.
const LOCK_PAUSE: Duration = Duration::from_millis(5);

/// Locks a file against other processes until it is dropped, and makes it if it is not there. What is in it stays, and a link
/// is not followed: it would lead to what is somebody else's.
///
/// # Errors
///
/// [`TryLockError::WouldBlock`] if somebody else holds the lock; [`TryLockError::Error`] if the file cannot be made or opened, or
/// if a link, a pipe or something else than a file is in its place.
pub fn lock_file(path: &Path) -> Result<File, TryLockError> {
    let mut options = File::options();
    options.read(true).write(true);
    let file = match options.clone().create_new(true).open(path) {
        Err(error) if error.kind() == ErrorKind::AlreadyExists => {
            let found = fs::symlink_metadata(path).map_err(TryLockError::Error)?;
            if !found.is_file() {
                let name = path.file_name().unwrap_or(path.as_os_str()).display();
                let what = if found.is_symlink() { "is a link" } else { "is not a file" };
                let error = io::Error::new(ErrorKind::InvalidInput, format!("{name} {what}"));
                return Err(TryLockError::Error(error));
            }
            options.open(path)
        }
        made => made,
    };
    let file = file.map_err(TryLockError::Error)?;
    for _ in 0..N_LOCK_LOOKS {
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => thread::sleep(LOCK_PAUSE),
            tried => return tried.map(|()| file),
        }
    }
    file.try_lock()?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_not_finished_leaves_the_old_one_and_nothing_beside_it() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("steps.jsonl");
        fs::write(&path, "old").unwrap();
        let mut file = PartialFile::create(&path).unwrap();
        file.write_all(b"half of the n").unwrap();
        assert_eq!(fs::read_dir(place.path()).unwrap().count(), 2);
        drop(file);
        assert_eq!(fs::read_to_string(&path).unwrap(), "old");
        assert_eq!(fs::read_dir(place.path()).unwrap().count(), 1);
        let mut file = PartialFile::create(&path).unwrap();
        file.write_all(b"new").unwrap();
        file.place().unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "new");
        assert_eq!(fs::read_dir(place.path()).unwrap().count(), 1);
    }

    #[test]
    fn what_is_in_the_way_of_a_file_that_is_written_is_removed_and_not_followed() {
        let place = tempfile::tempdir().unwrap();
        let [path, other] = ["run.json", "other"].map(|name| place.path().join(name));
        fs::write(&other, "precious").unwrap();
        let partial = place.path().join(format!("run.json.{}{PARTIAL}", std::process::id()));
        std::os::unix::fs::symlink(&other, &partial).unwrap();
        write_atomically(&path, b"new").unwrap();
        assert_eq!(fs::read_to_string(&other).unwrap(), "precious");
        assert!(!path.is_symlink());
        assert!(std::process::Command::new("mkfifo").arg(&partial).status().unwrap().success());
        write_atomically(&path, b"newer").unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "newer");
        fs::write(&partial, "left of one that was killed, and longer").unwrap();
        write_atomically(&path, b"newest").unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "newest");
    }

    #[test]
    fn a_lock_keeps_what_is_in_its_file_and_follows_no_link() {
        let place = tempfile::tempdir().unwrap();
        let [lock, other, missing] =
            ["lock", "other", "missing"].map(|name| place.path().join(name));
        fs::write(&lock, "whose it is").unwrap();
        let held = lock_file(&lock).unwrap();
        assert!(matches!(lock_file(&lock), Err(TryLockError::WouldBlock)));
        drop(held);
        assert_eq!(fs::read_to_string(&lock).unwrap(), "whose it is");
        fs::write(&other, "precious").unwrap();
        let refused = |path| io::Error::from(lock_file(path).unwrap_err()).to_string();
        for target in [&other, &missing] {
            fs::remove_file(&lock).unwrap();
            std::os::unix::fs::symlink(target, &lock).unwrap();
            assert!(refused(&lock).contains("lock is a link"));
        }
        assert!(!missing.exists());
        fs::remove_file(&lock).unwrap();
        fs::create_dir(&lock).unwrap();
        assert!(refused(&lock).contains("lock is not a file"));
    }
}
