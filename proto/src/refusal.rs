//! Why a message is not taken: one vocabulary for the whole way from the socket to the books.

use std::borrow::Cow;
use std::fmt;

use thiserror::Error;

use crate::Incarnation;

/// A message that is not taken: how it is counted, in words, and whose it was.
///
/// It is made where the fault is found and passed on unchanged; the learner's books are the only place that counts it.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{text}")]
pub struct Refusal {
    /// What it is counted by.
    pub cause: RefusalCause,
    /// One sentence for the log, and for the sender if it gets an answer.
    pub text: Cow<'static, str>,
    /// The start of the process that sent it. `None` if there was no readable header: then no sender can be blamed,
    /// since anyone can publish under anyone's key.
    pub sender: Option<Incarnation>,
}

impl Refusal {
    /// Refuses a message whose sender is not known (yet).
    pub fn new(cause: RefusalCause, text: impl Into<Cow<'static, str>>) -> Self {
        Self { cause, text: text.into(), sender: None }
    }

    /// Says whose message it was.
    pub fn of(self, sender: Incarnation) -> Self {
        Self { sender: Some(sender), ..self }
    }
}

macro_rules! causes {
    ($($(#[$doc:meta])* $variant:ident = $name:literal,)*) => {
        /// Every reason for which a message is refused, countable and with a stable name.
        #[derive(
            Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, serde::Deserialize,
        )]
        #[serde(rename_all = "snake_case")]
        pub enum RefusalCause {
            $($(#[$doc])* $variant,)*
        }

        impl RefusalCause {
            /// Lists all causes, about in the order of the checks.
            pub const ALL: &[Self] = &[$(Self::$variant,)*];

            /// Returns the name under which it is counted in metrics and books.
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)* }
            }
        }
    };
}

causes! {
    /// On a key that names no actor.
    Key = "key",
    /// Larger than its kind may be.
    Oversize = "oversize",
    /// No header, or not ours.
    Header = "header",
    /// A sender of another protocol version.
    Protocol = "protocol",
    /// Another kind of message than the key carries.
    Schema = "schema",
    /// More than the receiver's queue holds.
    Overflow = "overflow",
    /// From a sender that was cut off.
    CutOff = "cut_off",
    /// From a sender that has not said hello.
    Stranger = "stranger",
    /// A sequence beyond the sender's credit.
    Credit = "credit",
    /// A payload that is not the header's.
    Checksum = "checksum",
    /// A payload that cannot be decoded.
    Malformed = "malformed",
    /// An environment that the sender was never given, or an iteration out of order.
    Assignment = "assignment",
    /// A policy version that cannot have acted.
    Version = "version",
    /// An array whose length is not what the run agreed on.
    Shape = "shape",
    /// A NaN or an infinity.
    NonFinite = "non_finite",
    /// An action that could not have been sampled.
    Action = "action",
    /// Episode ends out of range or out of order.
    EpisodeEnd = "episode_end",
    /// No snapshot, or one over the limit.
    Snapshot = "snapshot",
    /// A number that no environment and no policy comes to.
    Magnitude = "magnitude",
    /// A message that does not prove which process it comes from.
    Proof = "proof",
    /// A state that no actor could restore, of a rollout that is trained: a fresh episode takes the place of the one that went on
    /// there. New causes come last, because checkpoints hold causes by their order.
    FreshEpisode = "fresh_episode",
}

impl RefusalCause {
    /// Returns whether an honest actor comes to it as well if the state that it was given leads there.
    pub fn may_be_inherited(self) -> bool {
        matches!(self, Self::NonFinite | Self::Magnitude | Self::Action | Self::Snapshot)
    }
}

impl fmt::Display for RefusalCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn names_of_causes_are_distinct() {
        let names: BTreeSet<&str> = RefusalCause::ALL.iter().map(|cause| cause.name()).collect();
        assert_eq!(names.len(), RefusalCause::ALL.len());
    }
}
