//! Everything that can wake a learner or an actor from the network, and the room that it takes in a learner's queue.

use std::ops::Deref;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use leadtime_proto::message::{Announcement, Control, Credit, Hello};
use leadtime_proto::{ActorId, Header, Incarnation, Refusal};

use crate::answer::{ControlResponder, HelloResponder};

/// What happens to a learner.
#[derive(Debug)]
pub enum LearnerEvent {
    /// An actor introduces itself; its presence ([`LearnerEvent::Joined`]) is usually reported before.
    Hello {
        /// What the actor says of itself, checked.
        hello: Hello,
        /// Where to answer.
        reply: Box<HelloResponder>,
    },
    /// A rollout that passed [`leadtime_proto::receive::inspect`]; duplicate check, then
    /// [`leadtime_proto::receive::open`], are the consumer's.
    Rollout {
        /// The name in the key that it came on: anyone can publish there, so it is a claim.
        actor: ActorId,
        /// What the sender says in front of the body.
        header: Header,
        /// The body, still encoded.
        payload: Payload,
    },
    /// This start of an actor is there (may be reported more than once).
    Joined(ActorId, Incarnation),
    /// This start of an actor is gone: it left, died, or the connection to it is lost.
    Left(ActorId, Incarnation),
    /// A message was refused; those for which there was no room are counted in
    /// [`crate::LearnerLink::take_uncounted`] instead.
    Refused {
        /// The name in the key that it came on, if the key has one; only [`Refusal::sender`] says who sent it.
        actor: Option<ActorId>,
        /// The reason, and the sender as far as it is known.
        refusal: Refusal,
        /// The event's place in the queue, given back when dropped.
        permit: QueuePermit,
    },
}

/// What happens to an actor.
#[derive(Debug)]
pub enum ActorEvent {
    /// A learner gives an order.
    Control {
        /// The start of the learner that gave it: anybody may be one, so it is for the actor to know its own.
        learner: Incarnation,
        /// What the actor is to do.
        control: Control,
        /// Where to answer it.
        reply: ControlResponder,
    },
    /// The learner acknowledges rollouts and allows more. Only the newest is kept until it is looked at.
    Credit(Credit),
    /// Weights are there to be pulled. Only the newest announcement is kept until it is looked at.
    Announcement(Announcement),
    /// The learner is there (may be reported more than once).
    LearnerJoined(Incarnation),
    /// The learner is gone, or the connection to it is lost.
    LearnerLeft(Incarnation),
}

/// How much of the queue somebody uses.
#[derive(Debug, Default)]
pub(crate) struct QueueUsage {
    pub(crate) n_messages: AtomicUsize,
    pub(crate) n_bytes: AtomicUsize,
}

/// A place (and some bytes) in the event queue, given back when dropped.
#[derive(Debug)]
pub struct QueuePermit {
    of_sender: Arc<QueueUsage>,
    of_all: Arc<QueueUsage>,
    n_bytes: usize,
}

impl QueuePermit {
    /// Takes room for a message. The caller holds the lock under which all room is taken; giving back needs none.
    pub(crate) fn take(
        of_sender: &Arc<QueueUsage>,
        of_all: &Arc<QueueUsage>,
        n_bytes: usize,
    ) -> Self {
        for usage in [of_sender, of_all] {
            usage.n_messages.fetch_add(1, Ordering::Relaxed);
            usage.n_bytes.fetch_add(n_bytes, Ordering::Relaxed);
        }
        Self { of_sender: Arc::clone(of_sender), of_all: Arc::clone(of_all), n_bytes }
    }
}

impl Drop for QueuePermit {
    fn drop(&mut self) {
        for usage in [&self.of_sender, &self.of_all] {
            usage.n_messages.fetch_sub(1, Ordering::Relaxed);
            usage.n_bytes.fetch_sub(self.n_bytes, Ordering::Relaxed);
        }
    }
}

/// The body of a rollout message: bytes that count against their sender's share until dropped.
#[derive(Debug)]
pub struct Payload {
    bytes: Vec<u8>,
    _permit: QueuePermit,
}

impl Payload {
    pub(crate) fn new(bytes: Vec<u8>, permit: QueuePermit) -> Self {
        Self { bytes, _permit: permit }
    }
}

impl Deref for Payload {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.bytes
    }
}
