//! What a coordinator starts from, how far it is, and what it asks for.

use leadtime_proto::message::{Control, Credit, EnvAssignment};
use leadtime_proto::{ActorId, Epoch, Incarnation, PolicyVersion, RunSpec};

use crate::books::{Books, SenderKey};
use crate::report::RunEvent;

/// What a run agreed on, as far as decisions depend on it.
#[derive(Clone, Debug)]
pub struct Terms {
    /// This start of the learner.
    pub learner: Incarnation,
    /// What is computed, and how: rollouts must fit it.
    pub spec: RunSpec,
    /// The most rollouts an actor may have unacknowledged.
    pub window: u32,
    /// Actors that must be there before a run starts.
    pub actors_min: usize,
    /// The fingerprint of the learner's own build.
    pub program: String,
    /// The learner's own CPU fingerprint.
    pub cpu: String,
}

/// Where a coordinator starts: the beginning, or a checkpoint.
#[derive(Clone, Debug)]
pub struct Start {
    /// Where every environment stands.
    pub places: Vec<EnvAssignment>,
    /// The newest assignment so far.
    pub epoch: Epoch,
    /// The policy's version.
    pub version: PolicyVersion,
    /// The books so far.
    pub books: Books,
}

/// What has to be done about something that happened.
#[derive(Clone, Debug)]
pub enum Effect {
    /// Tell an actor something, in this order.
    Control {
        /// Whom.
        to: SenderKey,
        /// What.
        control: Control,
    },
    /// Acknowledge and permit.
    Credit {
        /// Whom.
        to: ActorId,
        /// What.
        credit: Credit,
    },
    /// Tell the person.
    Event(RunEvent),
}

/// Why a hello is answered with a refusal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum HelloRefusal {
    /// The actor was cut off.
    #[error(
        "this actor was cut off because it kept sending messages that were refused: restart it"
    )]
    CutOff,
    /// Another start of it is here; said with a sentence of its own.
    #[error("an actor of this name is already here")]
    Taken,
    /// Its counts contradict each other, or what this learner knows.
    #[error("its counts of published and unacknowledged rollouts make no sense")]
    Nonsense,
}

/// How far a run is, as far as moving environments is concerned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stage {
    /// Too few actors so far.
    Gathering,
    /// Environments are moved when they have to be.
    Running,
    /// Actors are leaving, and nothing is moved any more.
    Closing,
}
