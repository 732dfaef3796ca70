//! Files that are whole or not there, and keys that nobody else can read.

use std::fs::{self, File, Permissions};
use std::io::Write as _;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use crate::{Error, Result};

/// Who may read a file.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Readers {
    Owner,
    Everybody,
}

/// Whether a file has to be on the disk before anybody may rely on it.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Durability {
    /// It takes the place of one that is needed, or cannot be made again.
    Flushed,
    /// Were it lost in a power cut, it would be made again.
    Eventual,
}

/// The largest file that is read: a certificate has one or two thousand bytes.
const MAX_BYTES: u64 = 1 << 20;

/// Replaces a file in one step.
pub(crate) fn write(
    path: &Path,
    text: &str,
    readers: Readers,
    durability: Durability,
) -> Result<()> {
    let written = || {
        let directory = path.parent().filter(|parent| !parent.as_os_str().is_empty());
        let directory = directory.unwrap_or(Path::new("."));
        // Made for its owner alone.
        let mut file = NamedTempFile::new_in(directory)?;
        file.write_all(text.as_bytes())?;
        if matches!(readers, Readers::Everybody) {
            file.as_file().set_permissions(Permissions::from_mode(0o644))?;
        }
        if matches!(durability, Durability::Flushed) {
            file.as_file().sync_all()?;
        }
        file.persist(path)?;
        if matches!(durability, Durability::Flushed) {
            // So that its name is there, too, after a power cut.
            File::open(directory)?.sync_all()?;
        }
        Ok(())
    };
    written().map_err(|source| failed("write", path)(source))
}

/// Reads a file of limited size.
pub(crate) fn read(path: &Path) -> Result<Vec<u8>> {
    let fail = || failed("read", path);
    check_is_file(path)?;
    let n_bytes = fs::metadata(path).map_err(fail())?.len();
    if n_bytes > MAX_BYTES {
        let found = format!("{n_bytes} bytes: that is no certificate or key");
        return Err(Error::Content { path: path.to_owned(), found });
    }
    fs::read(path).map_err(fail())
}

/// Returns whether something is there that would be lost if another file took its place. An empty file is not: a power cut leaves
/// one where a file was about to be.
pub(crate) fn holds_something(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|found| !found.is_file() || found.len() > 0)
}

/// Refuses what is no file, such as a pipe: its reader could wait for ever.
fn check_is_file(path: &Path) -> Result<()> {
    if fs::metadata(path).map_err(failed("read", path))?.is_file() {
        return Ok(());
    }
    Err(failed("read", path)(std::io::Error::other("it is not a file")))
}

/// Refuses a key that everybody can read. Its group may: that is how secrets are handed to containers.
pub(crate) fn check_key_is_secret(path: &Path) -> Result<()> {
    check_is_file(path)?;
    let mode = fs::metadata(path).map_err(failed("read", path))?.permissions().mode() & 0o777;
    let everybody = mode & 0o007;
    if everybody == 0 {
        return Ok(());
    }
    Err(Error::OpenKey { path: path.to_owned(), mode })
}

/// Takes a directory for this process alone, until the file is dropped. The file is made if it is not there.
pub(crate) fn lock(path: &Path, directory: &Path) -> Result<File> {
    if path.exists() {
        check_is_file(path)?;
    }
    let file = File::options().read(true).write(true).create(true).truncate(false).open(path);
    let file = file.map_err(failed("write", path))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(fs::TryLockError::WouldBlock) => Err(Error::Busy(directory.to_owned())),
        Err(fs::TryLockError::Error(source)) => Err(failed("lock", path)(source)),
    }
}

pub(crate) fn failed(
    action: &'static str,
    path: &Path,
) -> impl FnOnce(std::io::Error) -> Error + use<> {
    let path: PathBuf = path.to_owned();
    move |source| Error::File { action, path, source }
}
