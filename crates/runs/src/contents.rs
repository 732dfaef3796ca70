//! By which files a directory is known as a run's, and where its checkpoints are.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use crate::record::RECORD;
use crate::regular;

/// The configuration's file in a run directory.
pub(crate) const CONFIG: &str = "config.toml";
/// The folder of its checkpoints.
pub(crate) const CHECKPOINTS: &str = "checkpoints";
/// The folder of its event files, which TensorBoard reads.
pub(crate) const TENSORBOARD: &str = "tensorboard";

/// Tells whether a directory is a run's, even if a file in it cannot be read.
pub(crate) fn is_run(path: &Path) -> bool {
    [RECORD, CONFIG].iter().any(|file| path.join(file).exists())
}

/// Lists the checkpoints of a run directory; none if it has no folder for them.
pub(crate) fn checkpoints(path: &Path) -> io::Result<Vec<PathBuf>> {
    let Some(entries) = regular::if_there(fs::read_dir(path.join(CHECKPOINTS)))? else {
        return Ok(Vec::new());
    };
    let files = entries.map(|entry| Ok(entry?.path())).collect::<io::Result<Vec<_>>>()?;
    let is_checkpoint = |file: &PathBuf| file.extension().is_some_and(|e| e == "checkpoint");
    Ok(files.into_iter().filter(is_checkpoint).collect())
}
