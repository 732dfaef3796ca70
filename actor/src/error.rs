//! Why an actor cannot go on.

use std::time::Duration;

use leadtime_proto::codec::CodecError;
use leadtime_proto::phrase::duration;
use leadtime_proto::spec::SpecError;
use leadtime_proto::{EnvId, RunName};
use leadtime_sims::{SnapshotError, TaskError};
use thiserror::Error;

/// Why an actor failed.
#[derive(Debug, Error)]
pub enum Error {
    /// Nobody at the address, several runs, refused by the learner, and the like.
    #[error(transparent)]
    Link(#[from] leadtime_link::Error),
    /// This process was asked to stop before it was in a run.
    #[error("stopped before a run was joined")]
    CancelledEarly,
    /// The run's task cannot be built here.
    #[error("this program cannot build the run's task")]
    Task(#[from] TaskError),
    /// What the learner says of the run contradicts itself.
    #[error("the learner describes an impossible run")]
    Spec(#[from] SpecError),
    /// This program and the learner have different tasks under the domain's name.
    #[error(
        "domain `{0}` has another observation, action space or metrics here than in the learner: \
         run the same release on both sides"
    )]
    SpecMismatch(String),
    /// An environment's snapshot cannot be restored here.
    #[error("environment {env_id} cannot go on from its snapshot: run the same release everywhere")]
    Snapshot {
        /// Which environment of the assignment it is.
        env_id: EnvId,
        /// What is wrong with the snapshot.
        source: SnapshotError,
    },
    /// What steps an environment outside of this process has failed.
    #[error("{reason}")]
    Outside {
        /// Which environment, and what failed.
        reason: String,
    },
    /// What steps an environment outside of this process has failed before a first rollout was whole: it never worked here.
    #[error("{reason}")]
    NeverWorked {
        /// Which environment, and what failed.
        reason: String,
    },
    /// The weights do not fit the policy's shape.
    #[error("the learner's weights cannot be used")]
    Policy(#[from] leadtime_policy::Error),
    /// A rollout cannot be encoded.
    #[error("a rollout cannot be encoded")]
    Codec(#[from] CodecError),
    /// The learner cut this actor off.
    #[error("run `{run}` cut this actor off: {reason}")]
    CutOff {
        /// The run whose learner did it.
        run: RunName,
        /// Why, in the learner's words.
        reason: String,
    },
    /// The learner was lost and not found again.
    #[error("the learner of run `{run}` was lost and did not come back within {}", duration(*timeout))]
    LearnerLost {
        /// The run that is without a learner.
        run: RunName,
        /// How long it was looked for.
        timeout: Duration,
        /// What the last attempt met.
        source: leadtime_link::Error,
    },
    /// A learner of the same run name came back with another task.
    #[error("run `{0}` has become another run: start this actor again")]
    RunChanged(RunName),
    /// A thread could not be started.
    #[error("a thread of the actor cannot be started")]
    Thread(#[source] std::io::Error),
    /// A thread of ours ended, which is a bug (or a domain that panicked).
    #[error("the thread `{0}` ended unexpectedly")]
    ThreadGone(&'static str),
}
