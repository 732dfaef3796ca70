//! Reads regular files only: a pipe would keep its reader waiting for ever.

use std::fs;
use std::io;
use std::path::Path;

use super::error::PipelineError;

/// Reads a whole file.
pub(super) fn read(path: &Path) -> Result<Vec<u8>, PipelineError> {
    check_if_there(path)?;
    fs::read(path).map_err(PipelineError::file(path))
}

/// Reads a whole file of text.
pub(super) fn read_to_string(path: &Path) -> Result<String, PipelineError> {
    check_if_there(path)?;
    fs::read_to_string(path).map_err(PipelineError::file(path))
}

/// Refuses something else than a file, but not that nothing is there.
pub(super) fn check_if_there(path: &Path) -> Result<(), PipelineError> {
    if fs::metadata(path).is_ok_and(|found| !found.is_file()) {
        let error = io::Error::new(io::ErrorKind::InvalidInput, "it is not a file");
        return Err(PipelineError::file(path)(error));
    }
    Ok(())
}
