//! Why a message is refused: counted by kind, told to the actor in words.

use leadtime_proto::codec::CodecError;
use leadtime_proto::rollout::InvalidRollout;
use leadtime_proto::{EnvId, Iteration, PolicyVersion, Sequence};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// What refusals are counted by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RefusalKind {
    /// Refused by the network layer, before anyone looked at what it says.
    Transport,
    /// The payload is not the one that was sent.
    Checksum,
    /// The payload is no rollout.
    Malformed,
    /// Wrong shapes, impossible actions, or numbers that are not finite.
    Invalid,
    /// An environment that the run does not have.
    Environment,
    /// A policy version that should not have acted this rollout.
    Version,
    /// A rollout that skips others.
    Iteration,
    /// More rollouts than the learner gave credit for.
    Credit,
    /// A sender that never said hello.
    Stranger,
}

/// Why one rollout is refused.
#[derive(Debug, Error)]
pub enum Refusal {
    /// See [`RefusalKind::Checksum`].
    #[error("its checksum does not match")]
    Checksum,
    /// See [`RefusalKind::Malformed`].
    #[error(transparent)]
    Malformed(#[from] CodecError),
    /// See [`RefusalKind::Invalid`].
    #[error(transparent)]
    Invalid(#[from] InvalidRollout),
    /// See [`RefusalKind::Environment`].
    #[error("the run has no environment {env_id}")]
    Environment {
        /// As sent.
        env_id: EnvId,
    },
    /// See [`RefusalKind::Version`].
    #[error("version {found} acted it where {expected} had to")]
    Version {
        /// As sent.
        found: PolicyVersion,
        /// By the schedule; in `async` the newest one that exists.
        expected: PolicyVersion,
    },
    /// See [`RefusalKind::Iteration`].
    #[error("it is rollout {found} of its environment where {expected} is next")]
    Iteration {
        /// As sent.
        found: Iteration,
        /// The next one.
        expected: Iteration,
    },
    /// See [`RefusalKind::Credit`].
    #[error("its sequence {found} is over the limit {limit}")]
    Credit {
        /// As sent.
        found: Sequence,
        /// As permitted.
        limit: Sequence,
    },
}

impl Refusal {
    /// Returns what this refusal is counted by.
    pub fn kind(&self) -> RefusalKind {
        match self {
            Self::Checksum => RefusalKind::Checksum,
            Self::Malformed(_) => RefusalKind::Malformed,
            Self::Invalid(_) => RefusalKind::Invalid,
            Self::Environment { .. } => RefusalKind::Environment,
            Self::Version { .. } => RefusalKind::Version,
            Self::Iteration { .. } => RefusalKind::Iteration,
            Self::Credit { .. } => RefusalKind::Credit,
        }
    }
}
