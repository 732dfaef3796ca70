//! Reads regular files only.
//!
//! Anything may lie where a run's files are looked for, or be given for one. A pipe would keep its reader waiting for ever.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read as _};
use std::path::Path;

/// Opens a regular file.
///
/// # Errors
///
/// If it is not there, is something else than a file, or cannot be opened.
pub fn open(path: &Path) -> io::Result<File> {
    check(path)?;
    File::open(path)
}

/// Reads a whole file.
///
/// # Errors
///
/// If it is not there, is something else than a file, or cannot be read.
pub fn read(path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    open(path)?.read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Reads a whole file of text.
///
/// # Errors
///
/// If it is not there, is something else than a file, cannot be read, or holds something else than text.
pub fn read_to_string(path: &Path) -> io::Result<String> {
    let mut text = String::new();
    open(path)?.read_to_string(&mut text)?;
    Ok(text)
}

/// Refuses something else than a file, and what is not there.
pub(crate) fn check(path: &Path) -> io::Result<()> {
    let found = fs::metadata(path);
    if found.map_err(|error| refuse_dead_link(path).err().unwrap_or(error))?.is_file() {
        return Ok(());
    }
    let name = path.file_name().unwrap_or(path.as_os_str()).display();
    Err(io::Error::new(io::ErrorKind::InvalidInput, format!("{name} is not a file")))
}

/// Refuses something else than a file, but not that nothing is there.
fn check_if_there(path: &Path) -> io::Result<()> {
    // A link that leads nowhere is there.
    if path.symlink_metadata().is_ok() { check(path) } else { Ok(()) }
}

/// Opens a file to write at its end, and makes it where nothing is there.
pub(crate) fn append_to(path: &Path) -> io::Result<File> {
    check_if_there(path)?;
    OpenOptions::new().create(true).append(true).open(path)
}

/// Makes nothing of what is not there.
///
/// # Errors
///
/// That of what was looked for, unless it is not there.
pub fn if_there<T>(found: io::Result<T>) -> io::Result<Option<T>> {
    match found {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        found => found.map(Some),
    }
}

/// Says where a link leads at whose end nothing is, as on a disk that is not mounted; `None` for everything else.
pub(crate) fn dead_link(path: &Path) -> Option<String> {
    let target = fs::read_link(path).ok()?;
    let name = path.file_name().unwrap_or(path.as_os_str()).display();
    let is_dead = fs::metadata(path).is_err_and(|error| error.kind() == io::ErrorKind::NotFound);
    is_dead.then(|| format!("{name} is a link to {}, and nothing is there", target.display()))
}

/// Refuses a link at whose end nothing is. For those who can do without what it leads to, that is not there.
pub(crate) fn refuse_dead_link(path: &Path) -> io::Result<()> {
    match dead_link(path) {
        Some(sentence) => Err(io::Error::new(io::ErrorKind::NotFound, sentence)),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;
    use std::process::Command;

    use super::*;

    #[test]
    fn a_pipe_and_a_directory_are_no_files_and_nobody_waits_for_them() {
        let place = tempfile::tempdir().unwrap();
        let pipe = place.path().join("run.json");
        assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        assert_eq!(read(&pipe).unwrap_err().to_string(), "run.json is not a file");
        let error = read_to_string(place.path()).unwrap_err();
        assert!(error.to_string().ends_with(" is not a file"), "{error}");
        assert!(if_there(open(&place.path().join("none"))).unwrap().is_none());
        let missing = open(&place.path().join("none")).unwrap_err();
        assert_eq!(missing.kind(), io::ErrorKind::NotFound);
        symlink("/nowhere/run.json", place.path().join("link")).unwrap();
        let dead = open(&place.path().join("link")).unwrap_err();
        assert_eq!(dead.kind(), io::ErrorKind::NotFound);
        assert_eq!(dead.to_string(), "link is a link to /nowhere/run.json, and nothing is there");
        assert_eq!(dead_link(&place.path().join("none")), None);
        assert_eq!(dead_link(place.path()), None);
        fs::write(place.path().join("text"), "words").unwrap();
        assert_eq!(read_to_string(&place.path().join("text")).unwrap(), "words");
    }
}
