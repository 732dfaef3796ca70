//! A file that a command writes as it goes, and that must not be there before: nothing of the user's is overwritten.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

/// A file that was not there; removed again unless it is kept.
#[derive(Debug)]
pub struct NewFile {
    path: PathBuf,
    file: File,
    is_kept: bool,
}

impl NewFile {
    /// Makes it.
    ///
    /// # Errors
    ///
    /// If it is there already, or the system refuses it.
    pub fn create(path: &Path) -> io::Result<Self> {
        let file = File::options().write(true).create_new(true).open(path);
        let file = file.map_err(|error| match error.kind() {
            kind @ io::ErrorKind::AlreadyExists => {
                let sentence = "it is there already, and is left as it is: choose another name";
                io::Error::new(kind, sentence)
            }
            _ => error,
        })?;
        Ok(Self { path: path.to_owned(), file, is_kept: false })
    }

    /// Returns where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Opens it once more, at the place where it is being written.
    ///
    /// # Errors
    ///
    /// If the system refuses it.
    pub fn handle(&self) -> io::Result<File> {
        self.file.try_clone()
    }

    /// Lets the file stay when this is dropped.
    pub fn keep(&mut self) {
        self.is_kept = true;
    }
}

impl Drop for NewFile {
    fn drop(&mut self) {
        if !self.is_kept {
            drop(fs::remove_file(&self.path));
        }
    }
}
