//! Why a rollout is refused: counted by cause, told to the actor in words.

use leadtime_proto::receive::{Refusal, RefusalCause};
use leadtime_proto::rollout::InvalidRollout;
use leadtime_proto::{EnvId, Iteration, PolicyVersion, Sequence};
use thiserror::Error;

/// What is wrong with one rollout.
#[derive(Debug, Error)]
pub enum Fault {
    /// It did not arrive whole, or is none.
    #[error(transparent)]
    Wire(#[from] Refusal),
    /// Wrong shapes, impossible actions, or numbers that are not finite or absurd.
    #[error(transparent)]
    Invalid(#[from] InvalidRollout),
    /// The run has no such environment.
    #[error("the run has no environment {env_id}")]
    Environment {
        /// As sent.
        env_id: EnvId,
    },
    /// Another policy version should have acted it.
    #[error("policy version {found} acted it where {expected} had to")]
    Version {
        /// As sent.
        found: PolicyVersion,
        /// By the schedule; in `async` the newest one that exists.
        expected: PolicyVersion,
    },
    /// It skips others.
    #[error("it is rollout {found} of its environment where {expected} is next")]
    Iteration {
        /// As sent.
        found: Iteration,
        /// The next one.
        expected: Iteration,
    },
    /// The actor had no credit for it.
    #[error("its sequence {found} is over the limit {limit}")]
    Credit {
        /// As sent.
        found: Sequence,
        /// As permitted.
        limit: Sequence,
    },
}

impl Fault {
    /// Returns the cause that this is counted under.
    pub fn cause(&self) -> RefusalCause {
        match self {
            Self::Wire(refusal) => refusal.cause(),
            Self::Invalid(invalid) => invalid.into(),
            Self::Environment { .. } | Self::Iteration { .. } => RefusalCause::Assignment,
            Self::Version { .. } => RefusalCause::Version,
            Self::Credit { .. } => RefusalCause::Credit,
        }
    }
}
