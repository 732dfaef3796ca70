//! Files that are whole or not there.

use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::Path;

/// Replaces a file in one step: whoever reads it sees the old or the new content, whole, also after a power cut.
///
/// The content is written beside its place as `<name>.partial`, flushed to the disk and renamed, and the directory is
/// flushed.
///
/// # Errors
///
/// If the directory cannot be written or the disk is full; the old content then stays.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    let written = write(Path::new(&partial), bytes).and_then(|()| fs::rename(&partial, path));
    if written.is_err() {
        // A full disk needs the room.
        drop(fs::remove_file(&partial));
    }
    written?;
    let directory = path.parent().filter(|parent| !parent.as_os_str().is_empty());
    File::open(directory.unwrap_or(Path::new(".")))?.sync_all()
}

fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = File::create(path)?;
    file.write_all(bytes)?;
    file.sync_all()
}
