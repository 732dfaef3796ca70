//! Why a run cannot start or go on.

use std::path::PathBuf;

use leadtime_ppo::TrainError;
use thiserror::Error;

use crate::checkpoint::CheckpointError;

/// Why a run ended without a report.
#[derive(Debug, Error)]
pub enum Error {
    /// The network cannot be used, or the session has ended.
    #[error("network of the learner failed")]
    Link(#[from] leadtime_link::Error),
    /// A checkpoint cannot be read or written.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// An update failed, for example because a number was not finite.
    #[error("training failed")]
    Train(#[from] TrainError),
    /// The policy's parameters cannot be written.
    #[error("policy cannot be offered")]
    Policy(#[from] leadtime_policy::Error),
    /// The run of this checkpoint was begun with another configuration.
    #[error(
        "{} belongs to a run with another configuration: use that configuration, or another run name",
        .0.display()
    )]
    ConfigurationChanged(PathBuf),
    /// The thread that trains could not be started.
    #[error("the training thread cannot be started")]
    Thread(#[source] std::io::Error),
    /// The thread that trains is gone, which is a bug.
    #[error("the training thread ended unexpectedly; please report this")]
    TrainerGone,
    /// The network layer ended, which is a bug.
    #[error("the network ended unexpectedly; please report this")]
    LinkGone,
}

impl Error {
    /// Returns whether training diverged: the run goes on from its checkpoint, and with the same settings may diverge again.
    pub fn is_divergence(&self) -> bool {
        matches!(self, Self::Train(TrainError::Diverged(_)))
    }
}
