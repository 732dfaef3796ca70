//! Why a run directory cannot be used.

use std::io;
use std::path::PathBuf;

use leadtime_proto::ids::InvalidId;

/// Why a run directory cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RunDirError {
    /// It cannot be made, read or written.
    #[error("run directory {} cannot be used", path.display())]
    Io {
        /// The path at fault.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// A learner or a supervisor works on the run of this name.
    #[error("run `{0}` is being trained by another learner right now")]
    Locked(String),
    /// A learner works on the run of this name whose supervisor was killed: it is about to end.
    #[error(
        "run `{0}` is being trained by a learner whose supervisor was killed: it ends within seconds"
    )]
    Orphaned(String),
    /// The directory is no run's, or its run cannot be taken up as asked; the sentence says why, and what helps.
    #[error("{0}")]
    Refused(String),
    /// The name cannot be a key and a path.
    #[error(transparent)]
    Name(#[from] InvalidId),
}
