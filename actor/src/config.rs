//! What an actor process is told, and what it leaves behind.

use std::time::Duration;

use leadtime_link::{ConnectSettings, RUN_IS_ENDING, StartKey};
use leadtime_proto::{ActorId, PolicyVersion, RunName, Sequence};

/// Everything an actor needs before it meets a learner; the rest comes with the welcome.
#[derive(Clone, Debug)]
pub struct ActorSettings {
    /// The name by which a learner knows this actor.
    pub actor: ActorId,
    /// The keys of this start of the actor, drawn for every start.
    pub start: StartKey,
    /// The run to join; `None`: the only one at the address.
    pub run: Option<RunName>,
    /// Where to look for it, and for how long.
    pub connect: ConnectSettings,
    /// How long to look for a learner that was lost: longer than at the start, because a network fails for longer than
    /// a typing error lasts.
    pub reconnect_timeout: Duration,
    /// Whether the learner goes first on the cores that this actor shares with it: all actors wait for its updates.
    pub yields_to_learner: bool,
    /// Fingerprint of the program's build: equal ones compute the same numbers.
    pub program: String,
    /// CPU fingerprint: equal fingerprints give equal bits.
    pub cpu: String,
}

/// The state of an actor at one moment, for its status page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ActorProgress {
    /// Environment steps simulated since the process began.
    pub n_steps: u64,
    /// Rollouts sent and not acknowledged.
    pub n_unacknowledged: u64,
    /// The newest version of the weights that this actor has.
    pub version: Option<PolicyVersion>,
    /// Hellos after the first.
    pub n_reconnects: u64,
    /// Whether it has environments to step.
    pub is_assigned: bool,
    /// Whether it looks for a learner that was lost.
    pub is_searching: bool,
}

/// Why an actor left in good order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ActorEnd {
    /// The learner dismissed it.
    Dismissed {
        /// Why, in the learner's words.
        reason: String,
    },
    /// This process was asked to stop.
    Cancelled,
}

/// An actor's own account of what it did: the other half of the learner's books.
#[derive(Clone, Debug)]
pub struct ActorReport {
    /// The run that it took part in.
    pub run: RunName,
    /// Why it left.
    pub end: ActorEnd,
    /// Environment steps simulated since the process began.
    pub n_steps: u64,
    /// Rollouts made and numbered.
    pub made: Sequence,
    /// Rollouts handed to the network at least once.
    pub sent: Sequence,
    /// Rollouts that the learner acknowledged.
    pub acknowledged: Sequence,
    /// Hellos after the first: losses of the learner that were survived, and doubts about them.
    pub n_reconnects: u64,
}

impl ActorReport {
    /// Reports an actor that came when its run was ending, and did nothing.
    pub(crate) fn of_latecomer(run: RunName) -> Self {
        let nothing = Sequence(0);
        Self {
            run,
            end: ActorEnd::Dismissed { reason: RUN_IS_ENDING.to_owned() },
            n_steps: 0,
            made: nothing,
            sent: nothing,
            acknowledged: nothing,
            n_reconnects: 0,
        }
    }
}
