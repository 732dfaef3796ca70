//! The small messages between learner and actors.
//!
//! ```text
//! actor                                   learner
//!   |-- Hello (query ctl/hello) ------------->|   who I am
//!   |<------------------ HelloReply ----------|   the task, the policy's shape, the seed; or why not
//!   |<--- Control::Wait (query ctl/actor) ----|   whoever answers it gets environments
//!   |-- ControlReply ------------------------>|
//!   |<--- Control::Assign (query ctl/actor) --|   these environments, from these snapshots, under this epoch
//!   |-- ControlReply ------------------------>|   followed, or: these environments cannot be restored here
//!   |<------- Announcement (weights) ---------|   version v is there and has this digest; the actor pulls it
//!   |-- Rollout (traj) ---------------------->|
//!   |<------------------- Credit -------------|   received up to n, publish up to m
//!   |<--- Control::Stop ----------------------|
//! ```

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use crate::limits::{MAX_COUNT, MAX_ENVS, MAX_SNAPSHOT_BYTES};
use crate::refusal::{Refusal, RefusalCause};
use crate::{
    ActorId, EnvId, Epoch, Incarnation, Iteration, PolicyVersion, RunName, RunSpec, Sequence,
};

/// The longest fingerprint of a program or a CPU, in bytes: they end up in logs.
const MAX_FINGERPRINT: usize = 200;

/// An actor's first words; said again whenever it suspects that the learner has forgotten it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hello {
    /// The build of the sender's program: equal fingerprints compute the same numbers.
    pub program: String,
    /// The actor's name, unique among the actors of a run.
    pub actor: ActorId,
    /// The start of the actor's process, which keeps it apart from earlier ones of its name.
    pub incarnation: Incarnation,
    /// The class of CPU it runs on: equal fingerprints give equal bits.
    pub cpu: String,
    /// The highest sequence it has published, 0 if none.
    pub published: Sequence,
    /// The lowest sequence it still holds unacknowledged; `published + 1` if none.
    pub first_unacknowledged: Sequence,
}

impl Hello {
    /// Checks the texts in it, which reach logs and records.
    ///
    /// # Errors
    ///
    /// [`Refusal`] if a fingerprint is longer than any real one, or holds a control character.
    pub fn check(&self) -> Result<(), Refusal> {
        let odd = |text: &String| text.len() > MAX_FINGERPRINT || text.contains(char::is_control);
        if odd(&self.program) || odd(&self.cpu) {
            let text = "hello with a fingerprint that is none";
            return Err(Refusal::new(RefusalCause::Malformed, text).of(self.incarnation));
        }
        Ok(())
    }
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
    /// The run that the actor has joined.
    pub run: RunName,
    /// What is computed, and how.
    pub spec: RunSpec,
    /// The most rollouts that may be unacknowledged.
    pub window: u32,
    /// The learner's start, and the weights that it offers.
    pub weights: Announcement,
    /// The sequence from which this actor's rollouts count; lower ones need not be sent again.
    pub resend_from: Sequence,
}

/// One environment given to an actor.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EnvAssignment {
    /// The environment, `0..` number of environments of the run.
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

impl Assignment {
    /// Checks its numbers, which an actor counts on from.
    ///
    /// # Errors
    ///
    /// [`Refusal`] if a number is beyond any that a run reaches, or an environment is named twice.
    pub fn check(&self) -> Result<(), Refusal> {
        let refused = |text: String| Err(Refusal::new(RefusalCause::Assignment, text));
        let mut named = BTreeSet::new();
        if self.epoch.0 > MAX_COUNT {
            return refused(format!("assignment {} is beyond any of a run", self.epoch));
        }
        for env_id in self.envs.iter().map(|env| env.env_id).chain(self.keep.iter().copied()) {
            if env_id.0 as usize >= MAX_ENVS {
                return refused(format!("no run has an environment {env_id}"));
            }
            if !named.insert(env_id) {
                return refused(format!("environment {env_id} is assigned twice"));
            }
        }
        for EnvAssignment { env_id, iteration, snapshot } in &self.envs {
            if iteration.0 > MAX_COUNT || snapshot.len() > MAX_SNAPSHOT_BYTES {
                return refused(format!("environment {env_id} cannot stand where it is assigned"));
            }
        }
        Ok(())
    }
}

/// What the learner orders one actor to do.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Control {
    /// Step these environments from now on.
    Assign(Assignment),
    /// Leave the run; the actor ends.
    Stop {
        /// One sentence for the actor's log.
        reason: String,
        /// The actor did something wrong and should exit with an error.
        cut_off: bool,
    },
    /// Wait for environments. Only who answers it gets some: behind a hello and a presence there may be nobody.
    Wait,
}

impl Control {
    /// Checks an order before it is followed.
    ///
    /// # Errors
    ///
    /// As [`Assignment::check`].
    pub fn check(&self) -> Result<(), Refusal> {
        match self {
            Self::Assign(assignment) => assignment.check(),
            Self::Stop { .. } | Self::Wait => Ok(()),
        }
    }
}

/// An actor's answer to a [`Control`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ControlReply {
    /// The order is followed.
    Followed {
        /// The assignment that the actor now follows.
        epoch: Epoch,
    },
    /// The assignment is followed except for environments whose snapshots cannot be restored here: their state has
    /// another layout (an actor of another build made it), or was never one.
    ///
    /// The actor does not step these environments and says no more of them, so the learner has to give them again,
    /// under a new epoch, or they stand still for ever: from an older snapshot that is known to be good, or from the
    /// beginning of a fresh episode (which the books count). The sender of the snapshot is to blame, not the one that reports it.
    CannotRestore {
        /// The assignment that the actor now follows.
        epoch: Epoch,
        /// The environments that it does not step, in ascending order.
        envs: Vec<EnvId>,
    },
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

/// Says which versions of the weights there are to be pulled, and how to know them.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Announcement {
    /// The start of the learner that offers them.
    pub learner: Incarnation,
    /// The versions that are kept, the newest last, each with the SHA-256 of its parameters' bytes.
    ///
    /// All of them are listed every time: announcements may be lost, and what is pulled is used only if it has the
    /// digest that the learner announced.
    pub versions: Vec<(PolicyVersion, [u8; 32])>,
}

impl Announcement {
    /// Returns the newest version; 0 as long as there is none.
    pub fn newest(&self) -> PolicyVersion {
        self.versions.last().map_or(PolicyVersion(0), |(version, _)| *version)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_order_that_no_learner_gives_is_refused() {
        let env = |env_id, iteration, n_bytes| EnvAssignment {
            env_id: EnvId(env_id),
            iteration: Iteration(iteration),
            snapshot: vec![0; n_bytes],
        };
        let order = |epoch, envs, keep: &[u32]| {
            let keep = keep.iter().copied().map(EnvId).collect();
            Control::Assign(Assignment { epoch: Epoch(epoch), envs, keep }).check()
        };
        let last = MAX_ENVS as u32 - 1;
        assert!(order(MAX_COUNT, vec![env(0, MAX_COUNT, MAX_SNAPSHOT_BYTES)], &[last]).is_ok());
        let refused = [
            order(u64::MAX, Vec::new(), &[]),
            order(MAX_COUNT + 1, Vec::new(), &[]),
            order(1, vec![env(u32::MAX, 0, 0)], &[]),
            order(1, Vec::new(), &[last + 1]),
            order(1, vec![env(3, 0, 0), env(3, 0, 0)], &[]),
            order(1, vec![env(3, 0, 0)], &[3]),
            order(1, vec![env(0, u64::MAX, 0)], &[]),
            order(1, vec![env(0, 0, MAX_SNAPSHOT_BYTES + 1)], &[]),
        ];
        for (index, refused) in refused.into_iter().enumerate() {
            assert_eq!(refused.unwrap_err().cause, RefusalCause::Assignment, "{index}");
        }
        assert!(Control::Stop { reason: String::new(), cut_off: true }.check().is_ok());
    }
}
