//! What passes between a notifier, the listener and their world: messages one way, reactions the other.

use serde::{Deserialize, Serialize};

/// A notification: what to do, when it can be understood, how long it takes to say.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Message {
    /// Content topic c: index into [`Domain::topics`](crate::Domain::topics).
    pub topic: usize,
    /// Comprehension time k, in words.
    pub comprehension: u32,
    /// Conveyance time l, in words; at least k.
    pub conveyance: u32,
}

/// The reaction that the listener carries out in the coming step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReactionStep {
    /// What was asked for.
    pub topic: usize,
    /// This is the first step of this reaction: a reaction that acts once acts now.
    pub first: bool,
}

/// How a reaction went in a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReactionStatus {
    /// The listener did (at least part of) what was asked for.
    Followed,
    /// The world did not let them, and they went on by their own plan; the reaction's time runs on.
    Refused,
    /// The world ended the reaction (after this step).
    Ended,
}
