//! Everything that can wake a learner or an actor from the network.

use leadtime_proto::message::{Announcement, Control, Credit, Hello};
use leadtime_proto::{ActorId, Header, Incarnation, Refusal};

use crate::permit::{Payload, QueuePermit};
use crate::responder::{ControlResponder, HelloResponder};

/// What happens to a learner.
#[derive(Debug)]
pub enum LearnerEvent {
    /// An actor introduces itself; its presence ([`LearnerEvent::Joined`]) is usually reported before.
    Hello {
        /// The checked message.
        hello: Hello,
        /// Where to answer.
        reply: HelloResponder,
    },
    /// A rollout that passed [`leadtime_proto::receive::inspect`]; duplicate check, then
    /// [`leadtime_proto::receive::open`], are the consumer's.
    Rollout {
        /// The name in the key that it came on: anyone can publish there, so it is a claim.
        actor: ActorId,
        /// The header.
        header: Header,
        /// The body, still encoded.
        payload: Payload,
    },
    /// An actor is there (may be reported more than once).
    Joined {
        /// The actor's name.
        actor: ActorId,
        /// The start of it that is there.
        incarnation: Incarnation,
    },
    /// An actor is gone: it left, died, or the connection to it is lost.
    Left {
        /// The actor's name.
        actor: ActorId,
        /// The start of it that is gone.
        incarnation: Incarnation,
    },
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
    /// The learner gives an order.
    Control {
        /// The order.
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
