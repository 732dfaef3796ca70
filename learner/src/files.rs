//! Files that are whole or not there.

use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::Path;

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
    let mut partial = path.as_os_str().to_owned();
    partial.push(format!(".{}{PARTIAL}", std::process::id()));
    let written = write(Path::new(&partial), bytes).and_then(|()| fs::rename(&partial, path));
    if written.is_err() {
        // A full disk needs the room.
        drop(fs::remove_file(&partial));
    }
    written?;
    let directory = path.parent().filter(|parent| !parent.as_os_str().is_empty());
    File::open(directory.unwrap_or(Path::new(".")))?.sync_all()
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

fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = File::create(path)?;
    file.write_all(bytes)?;
    file.sync_all()
}
