//! Why a run directory cannot be used.

use std::error::Error;
use std::io;
use std::path::PathBuf;

use leadtime_config::identity::Change;
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
    /// A learner or a supervisor works on it.
    #[error("run `{name}` is being trained by another learner right now")]
    Locked {
        /// The run.
        name: String,
    },
    /// The configuration is not the one that the run began with.
    #[error(
        "run `{name}` began with another configuration: {}; give the old values, or take another --name, with \
         --fork {name} to start from its weights",
        list(changes)
    )]
    Changed {
        /// The run.
        name: String,
        /// What differs, from the run to the request.
        changes: Vec<Change>,
    },
    /// The run began with other weights than those that `--fork` names.
    #[error(
        "run `{name}` has already begun, from {}: leave --fork out to continue it, or take another --name",
        origin.as_deref().map_or_else(|| "fresh weights".to_owned(), |run| format!("the weights of `{run}`"))
    )]
    OtherOrigin {
        /// The run.
        name: String,
        /// What it was forked from, if it was.
        origin: Option<String>,
    },
    /// The run has had checkpoints, and there is none.
    #[error(
        "run `{name}` has {n_updates} updates on record and no checkpoint in {}, so it cannot be continued; put the \
         checkpoints back, or take another --name, with --fork {name} to start from its weights",
        path.display()
    )]
    CheckpointsLost {
        /// The run.
        name: String,
        /// Updates on record.
        n_updates: u64,
        /// Where checkpoints should be.
        path: PathBuf,
    },
    /// The weights that a forked run begins with are missing or are others than on record.
    #[error("{} does not hold the weights that run `{name}` was forked from ({reason}); fork it again under another --name", path.display())]
    OriginLost {
        /// The run.
        name: String,
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The directory holds something else, or its record or configuration cannot be read.
    #[error("{} is not a run directory: {reason}", path.display())]
    NotARun {
        /// The path.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The name cannot be a key and a path.
    #[error(transparent)]
    Name(#[from] InvalidId),
}

/// Writes an error with its causes.
pub(crate) fn with_causes(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text = format!("{text}: {error}");
        cause = error.source();
    }
    text
}

fn list(changes: &[Change]) -> String {
    changes.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
}
