//! The small messages between learner and actors.
//!
//! ```text
//! actor                                   learner
//!   |-- Hello (query ctl/hello) ------------->|   who I am
//!   |<------------------ HelloReply ----------|   the task, the policy's shape, the seed; or why not
//!   |<--- Control::Assign (query ctl/actor) --|   these environments, from these snapshots, under this epoch
//!   |-- ControlAck -------------------------->|
//!   |<------- Announcement (weights) ---------|   version v is there; the actor pulls it
//!   |-- Rollout (traj) ---------------------->|
//!   |<------------------- Credit -------------|   received up to n, publish up to m
//!   |<--- Control::Stop ----------------------|
//! ```

use serde::{Deserialize, Serialize};

use crate::{
    ActorId, EnvId, EnvSpec, Epoch, Incarnation, Iteration, PolicySpec, PolicyVersion, RunName,
    Schedule, Sequence, TaskSpec,
};

/// An actor's first words; said again whenever it suspects that the learner has forgotten it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hello {
    /// [`crate::header::PROTOCOL_VERSION`] of the sender.
    pub protocol: u32,
    /// The build of the sender's program: equal fingerprints compute the same numbers.
    pub program: String,
    /// The actor.
    pub actor: ActorId,
    /// Its start.
    pub incarnation: Incarnation,
    /// The class of CPU it runs on: equal fingerprints give equal bits.
    pub cpu: String,
    /// The highest sequence it has published, 0 if none.
    pub published: Sequence,
    /// The lowest sequence it still holds unacknowledged; `published + 1` if none.
    pub first_unacknowledged: Sequence,
}

/// The answer to a [`Hello`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum HelloReply {
    /// The actor is in; an assignment follows.
    Welcome(Box<Welcome>),
    /// The actor is not wanted.
    Refused {
        /// One sentence: what is wrong and what to do.
        reason: String,
    },
    /// Another start of an actor of this name is there, alive.
    Taken,
}

/// Everything an actor needs to know about a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Welcome {
    /// The run.
    pub run: RunName,
    /// The learner's start.
    pub learner: Incarnation,
    /// Seed of every random stream.
    pub run_seed: u64,
    /// What to simulate.
    pub task: TaskSpec,
    /// What the simulation must look like; an actor whose task differs says so and leaves.
    pub env: EnvSpec,
    /// What the weights are for.
    pub policy: PolicySpec,
    /// Steps per rollout.
    pub n_steps: u32,
    /// Who waits for whom.
    pub schedule: Schedule,
    /// The most rollouts that may be unacknowledged.
    pub window: u32,
    /// The learner's newest version.
    pub version: PolicyVersion,
    /// The sequence from which this actor's rollouts count; lower ones need not be sent again.
    pub resend_from: Sequence,
}

/// One environment given to an actor.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EnvAssignment {
    /// The environment.
    pub env_id: EnvId,
    /// The rollout that it goes on with.
    pub iteration: Iteration,
    /// Its state before that rollout; empty: from the beginning.
    #[serde(with = "serde_bytes")]
    pub snapshot: Vec<u8>,
}

/// The environments of an actor, replacing whatever it had.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Assignment {
    /// Number of this assignment; rollouts carry it.
    pub epoch: Epoch,
    /// The whole set. Environments that the actor already steps under an older epoch, at the same iteration or
    /// beyond, are listed in `keep` instead, so that they go on undisturbed.
    pub envs: Vec<EnvAssignment>,
    /// Environments that stay with the actor as they are.
    pub keep: Vec<EnvId>,
}

/// What the learner tells one actor.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Control {
    /// Step these environments.
    Assign(Assignment),
    /// Finish the rollout at hand and wait.
    Pause,
    /// Go on after a pause.
    Resume,
    /// Leave.
    Stop {
        /// One sentence for the actor's log.
        reason: String,
        /// The actor did something wrong and should exit with an error.
        cut_off: bool,
    },
}

/// An actor's acknowledgement of a [`Control`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ControlAck {
    /// The assignment that the actor now follows.
    pub epoch: Epoch,
}

/// The learner's cumulative acknowledgement and permission, repeated so that a lost one does no harm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Credit {
    /// The actor's start that this is about; an older one's credit is ignored.
    pub incarnation: Incarnation,
    /// The learner's start; a new one means that the actor must say hello again.
    pub learner: Incarnation,
    /// Every sequence up to this one was received (and accepted, or refused with a reason).
    pub acknowledged: Sequence,
    /// The highest sequence that may be published.
    pub limit: Sequence,
}

/// Says that a version of the weights is there to be pulled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Announcement {
    /// The learner's start.
    pub learner: Incarnation,
    /// The newest version.
    pub version: PolicyVersion,
    /// Size of the parameters in bytes.
    pub size: u64,
    /// SHA-256 of the parameters' bytes.
    pub sha256: [u8; 32],
}
