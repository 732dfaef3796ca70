//! The doorman: what a receiver does with a message before it believes a byte of it.
//!
//! ```text
//! inspect   size limit -> header (48 bytes, magic) -> protocol -> schema          cheap, in a callback
//! (the receiver's own: duplicate? known sender? within its credit?)
//! open      checksum -> decode with a limit -> everything consumed                costs the payload's length
//! (the receiver's own: shapes, ranges, finiteness; `Rollout::check`)
//! ```
//!
//! What fails is a [`Refusal`]: a sentence for a person, and a countable [`RefusalCause`] for the books. The causes
//! of the receiver's own steps are listed here too, so that one table counts them all.

use std::fmt;

use serde::de::DeserializeOwned;
use thiserror::Error;

use crate::codec::{self, CodecError};
use crate::header::{HEADER_BYTES, HeaderError, PROTOCOL_VERSION, Schema};
use crate::rollout::InvalidRollout;
use crate::{Header, limits};

/// What may arrive at a key: one schema, up to a size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Expected {
    /// The only schema that is read.
    pub schema: Schema,
    /// The largest payload, in bytes.
    pub max_bytes: usize,
}

impl Expected {
    const fn new(schema: Schema, max_bytes: usize) -> Self {
        Self { schema, max_bytes }
    }
}

/// What arrives where actors say hello.
pub const HELLO: Expected = Expected::new(Schema::Hello, limits::MAX_HELLO_BYTES);
/// What an actor gets for a hello.
pub const HELLO_REPLY: Expected = Expected::new(Schema::HelloReply, limits::MAX_CONTROL_BYTES);
/// What arrives where an actor takes orders.
pub const CONTROL: Expected = Expected::new(Schema::Control, limits::MAX_CONTROL_BYTES);
/// What a learner gets for an order.
pub const CONTROL_ACK: Expected = Expected::new(Schema::ControlAck, limits::MAX_NOTICE_BYTES);
/// What arrives where a learner takes rollouts.
pub const ROLLOUT: Expected = Expected::new(Schema::Rollout, limits::MAX_ROLLOUT_BYTES);
/// What arrives where an actor is told its credit.
pub const CREDIT: Expected = Expected::new(Schema::Credit, limits::MAX_NOTICE_BYTES);
/// What arrives where weights are announced.
pub const ANNOUNCEMENT: Expected = Expected::new(Schema::Announcement, limits::MAX_NOTICE_BYTES);
/// What arrives for a pull of weights.
pub const WEIGHTS: Expected = Expected::new(Schema::Weights, limits::MAX_WEIGHTS_BYTES);
/// What arrives where metrics are reported.
pub const METRICS: Expected = Expected::new(Schema::Metrics, limits::MAX_METRICS_BYTES);

/// Why a message was refused, as a person reads it.
#[derive(Debug, Error)]
pub enum Refusal {
    /// The key that it came on is none of ours.
    #[error("message arrived on a malformed key")]
    Key,
    /// Larger than its kind may be.
    #[error("message has {found} bytes, at most {limit} are possible")]
    Oversize {
        /// As sent.
        found: usize,
        /// The limit of its kind.
        limit: usize,
    },
    /// No header, a header of another length, or not one of ours.
    #[error(
        "message has no valid header ({found} bytes, expected {HEADER_BYTES} starting with the magic number)"
    )]
    Header {
        /// Length of what came in its place.
        found: usize,
    },
    /// A sender of another release.
    #[error(
        "sender speaks protocol {found}, this program speaks {PROTOCOL_VERSION}: run the same release on both sides"
    )]
    Protocol {
        /// The sender's version.
        found: u32,
    },
    /// A message of another kind than its key carries, or of no known kind.
    #[error("message has schema {found}, expected {expected}")]
    Schema {
        /// As sent.
        found: u16,
        /// What the key carries.
        expected: u16,
    },
    /// The payload is not the one that the header was made for.
    #[error("checksum does not match the payload")]
    Checksum,
    /// The payload is no such message, or has bytes left over.
    #[error("payload cannot be decoded")]
    Malformed(#[source] CodecError),
    /// The receiver's queue is full: the sender did not keep to its window, or the receiver is stalled.
    #[error("receiver's queue is full: the sender went beyond its window")]
    Overflow,
    /// The sender was cut off earlier.
    #[error("sender was cut off")]
    CutOff,
}

impl Refusal {
    /// Returns the cause under which this is counted.
    pub fn cause(&self) -> RefusalCause {
        match self {
            Self::Key => RefusalCause::Key,
            Self::Oversize { .. } => RefusalCause::Oversize,
            Self::Header { .. } => RefusalCause::Header,
            Self::Protocol { .. } => RefusalCause::Protocol,
            Self::Schema { .. } => RefusalCause::Schema,
            Self::Checksum => RefusalCause::Checksum,
            Self::Malformed(_) => RefusalCause::Malformed,
            Self::Overflow => RefusalCause::Overflow,
            Self::CutOff => RefusalCause::CutOff,
        }
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
    /// Wrong lengths.
    Shape = "shape",
    /// A NaN or an infinity.
    NonFinite = "non_finite",
    /// An action that could not have been sampled.
    Action = "action",
    /// Episode ends out of range or out of order.
    EpisodeEnd = "episode_end",
    /// No snapshot, or one over the limit.
    Snapshot = "snapshot",
    /// A number that no environment and no policy comes to. Last, because checkpoints hold causes by their order.
    Magnitude = "magnitude",
}

impl fmt::Display for RefusalCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl From<&InvalidRollout> for RefusalCause {
    fn from(invalid: &InvalidRollout) -> Self {
        match invalid {
            InvalidRollout::Steps { .. } | InvalidRollout::Length { .. } => Self::Shape,
            InvalidRollout::NonFinite { .. } => Self::NonFinite,
            InvalidRollout::Magnitude { .. } => Self::Magnitude,
            InvalidRollout::Action { .. } => Self::Action,
            InvalidRollout::End { .. } => Self::EpisodeEnd,
            InvalidRollout::Snapshot { .. } => Self::Snapshot,
        }
    }
}

/// Checks what can be checked without touching the payload: size, header, protocol, schema.
///
/// # Errors
///
/// [`Refusal`] naming the first check that failed.
pub fn inspect(
    attachment: Option<&[u8]>,
    payload_len: usize,
    expected: Expected,
) -> Result<Header, Refusal> {
    if payload_len > expected.max_bytes {
        return Err(Refusal::Oversize { found: payload_len, limit: expected.max_bytes });
    }
    let attachment = attachment.ok_or(Refusal::Header { found: 0 })?;
    let wanted = expected.schema as u16;
    let header = Header::from_bytes(attachment).map_err(|error| match error {
        HeaderError::Length { found } => Refusal::Header { found },
        HeaderError::Magic => Refusal::Header { found: HEADER_BYTES },
        HeaderError::Protocol { found } => Refusal::Protocol { found },
        HeaderError::Schema { found } => Refusal::Schema { found, expected: wanted },
    })?;
    if header.schema != expected.schema {
        return Err(Refusal::Schema { found: header.schema as u16, expected: wanted });
    }
    Ok(header)
}

/// Checks an inspected message's payload against its header's checksum.
///
/// # Errors
///
/// [`Refusal::Checksum`] if they do not belong together.
pub fn verify(header: &Header, payload: &[u8]) -> Result<(), Refusal> {
    if header.matches(payload) { Ok(()) } else { Err(Refusal::Checksum) }
}

/// Decodes an inspected message: checksum, decode with a limit, everything consumed.
///
/// # Errors
///
/// [`Refusal::Checksum`] or [`Refusal::Malformed`].
pub fn open<T: DeserializeOwned>(
    header: &Header,
    payload: &[u8],
    expected: Expected,
) -> Result<T, Refusal> {
    verify(header, payload)?;
    codec::decode(payload, expected.max_bytes).map_err(Refusal::Malformed)
}

/// Does all of it: [`inspect`], then [`open`].
///
/// # Errors
///
/// [`Refusal`] naming the first check that failed.
///
/// # Example
///
/// ```
/// use leadtime_proto::message::ControlAck;
/// use leadtime_proto::receive::{self, RefusalCause};
/// use leadtime_proto::{Epoch, Header, Incarnation, codec};
///
/// let payload = codec::encode(&ControlAck { epoch: Epoch(3) })?;
/// let schema = receive::CONTROL_ACK.schema;
/// let header = Header::plain(schema, Incarnation(1), &payload).to_bytes();
///
/// let (_, ack): (_, ControlAck) = receive::receive(Some(&header), &payload, receive::CONTROL_ACK).unwrap();
/// assert_eq!(ack.epoch, Epoch(3));
///
/// let refusal = receive::receive::<ControlAck>(None, &payload, receive::CONTROL_ACK).unwrap_err();
/// assert_eq!(refusal.cause(), RefusalCause::Header);
/// # Ok::<(), leadtime_proto::codec::CodecError>(())
/// ```
pub fn receive<T: DeserializeOwned>(
    attachment: Option<&[u8]>,
    payload: &[u8],
    expected: Expected,
) -> Result<(Header, T), Refusal> {
    let header = inspect(attachment, payload.len(), expected)?;
    let message = open(&header, payload, expected)?;
    Ok((header, message))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::message::ControlAck;
    use crate::{Epoch, Incarnation};

    fn ack() -> (Vec<u8>, Header) {
        let payload = codec::encode(&ControlAck { epoch: Epoch(700) }).unwrap();
        let header = Header::plain(Schema::ControlAck, Incarnation(1), &payload);
        (payload, header)
    }

    fn cause(attachment: Option<&[u8]>, payload: &[u8], expected: Expected) -> RefusalCause {
        receive::<ControlAck>(attachment, payload, expected).unwrap_err().cause()
    }

    #[test]
    fn each_check_refuses_with_its_own_cause() {
        let (payload, header) = ack();
        let bytes = header.to_bytes();
        let tiny = Expected { max_bytes: 1, ..CONTROL_ACK };
        assert_eq!(cause(Some(&bytes), &payload, tiny), RefusalCause::Oversize);
        assert_eq!(cause(None, &payload, CONTROL_ACK), RefusalCause::Header);
        assert_eq!(cause(Some(&bytes[..47]), &payload, CONTROL_ACK), RefusalCause::Header);
        let mut other = bytes;
        other[12] = 9;
        assert_eq!(cause(Some(&other), &payload, CONTROL_ACK), RefusalCause::Protocol);
        assert_eq!(cause(Some(&bytes), &payload, CREDIT), RefusalCause::Schema);
        let mut damaged = payload.clone();
        damaged[0] ^= 1;
        assert_eq!(cause(Some(&bytes), &damaged, CONTROL_ACK), RefusalCause::Checksum);
        let longer = [payload.as_slice(), &[0]].concat();
        let fitting = Header::plain(Schema::ControlAck, Incarnation(1), &longer).to_bytes();
        assert_eq!(cause(Some(&fitting), &longer, CONTROL_ACK), RefusalCause::Malformed);
    }

    #[test]
    fn names_of_causes_are_distinct() {
        let names: BTreeSet<&str> = RefusalCause::ALL.iter().map(|cause| cause.name()).collect();
        assert_eq!(names.len(), RefusalCause::ALL.len());
    }
}
