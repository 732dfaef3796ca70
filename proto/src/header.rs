//! The 48 bytes in front of every message: what it is, whose, which, and whether it arrived whole.
//!
//! ```text
//! offset 0      4       8        12        16           24        32     40       48
//!        magic  schema  crc32c   protocol  incarnation  sequence  epoch  version
//!        u32    u32     u32      u32       u64          u64       u64    u64
//! ```
//!
//! All little-endian, readable without the codec. It travels next to the payload, so a receiver can refuse a
//! message before it decodes a byte of it.

use crate::refusal::{Refusal, RefusalCause};
use crate::{Epoch, Incarnation, PolicyVersion, Sequence};

/// The version of everything in this crate that crosses a process boundary. It rises with every change of a field, its
/// type or its place: the codec writes neither names nor tags, so messages of another release would decode into wrong
/// values.
pub const PROTOCOL_VERSION: u32 = 6;
const MAGIC: [u8; 4] = *b"LDTM";
/// Length of an encoded header.
pub const HEADER_BYTES: usize = 48;

/// What a payload holds; a receiver decodes only what it expects at that key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::CheckedBitPattern)]
#[repr(u32)]
pub enum Schema {
    /// [`crate::message::Hello`], from an actor to the learner.
    Hello = 1,
    /// [`crate::message::HelloReply`], the learner's answer to a hello.
    HelloReply = 2,
    /// [`crate::message::Control`], from the learner to one actor.
    Control = 3,
    /// [`crate::message::ControlReply`], the actor's answer to a control message.
    ControlReply = 4,
    /// [`crate::Rollout`], from an actor to the learner.
    Rollout = 5,
    /// [`crate::message::Credit`], from the learner to one actor.
    Credit = 6,
    /// [`crate::message::Announcement`], from the learner to all actors and observers.
    Announcement = 7,
    /// Policy parameters as safetensors, not in the codec's encoding.
    Weights = 8,
    /// Metrics as JSON, not in the codec's encoding.
    Metrics = 9,
    /// What a run is, as JSON.
    About = 10,
    /// The metrics of all updates so far, thinned: JSON, compressed with gzip.
    History = 11,
}

/// The fixed-size front of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// [`PROTOCOL_VERSION`] of the sender; what is read is always our own.
    pub protocol: u32,
    /// What the payload holds.
    pub schema: Schema,
    /// CRC-32C of the payload.
    pub checksum: u32,
    /// Start of the sending process.
    pub incarnation: Incarnation,
    /// The sender's count of rollouts, of hellos or of orders; in an answer that of its question; 0 in other messages.
    pub sequence: Sequence,
    /// The assignment under which a rollout was made; 0 in other messages.
    pub epoch: Epoch,
    /// The policy version that the message is about; 0 where none is.
    pub version: PolicyVersion,
}

impl Header {
    /// Describes a payload that belongs to no rollout sequence.
    pub fn plain(schema: Schema, incarnation: Incarnation, payload: &[u8]) -> Self {
        Self {
            protocol: PROTOCOL_VERSION,
            schema,
            checksum: crc32c::crc32c(payload),
            incarnation,
            sequence: Sequence(0),
            epoch: Epoch(0),
            version: PolicyVersion(0),
        }
    }

    /// Writes the header as it crosses the wire.
    pub fn to_bytes(self) -> [u8; HEADER_BYTES] {
        // Written by hand and not by the codec. The magic number and the protocol version never change their offsets:
        // they are how two releases find out that they differ.
        let mut bytes = [0; HEADER_BYTES];
        let words = [u32::from_le_bytes(MAGIC), self.schema as u32, self.checksum, self.protocol];
        let longs = [self.incarnation.0, self.sequence.0, self.epoch.0, self.version.0];
        bytes[..16].copy_from_slice(words.map(u32::to_le_bytes).as_flattened());
        bytes[16..].copy_from_slice(longs.map(u64::to_le_bytes).as_flattened());
        bytes
    }

    /// Reads a header.
    ///
    /// # Errors
    ///
    /// [`Refusal`] without a sender: [`RefusalCause::Header`] if the length or the magic number is wrong,
    /// [`RefusalCause::Protocol`] if it has another protocol version, [`RefusalCause::Schema`] if its schema is
    /// unknown. They are checked in this order.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Refusal> {
        let found = bytes.len();
        let Some(bytes) =
            <&[u8; HEADER_BYTES]>::try_from(bytes).ok().filter(|bytes| bytes.starts_with(&MAGIC))
        else {
            let text = format!(
                "message has no valid header ({found} bytes, expected {HEADER_BYTES} starting with the magic number)"
            );
            return Err(Refusal::new(RefusalCause::Header, text));
        };
        let word = |at: usize| u32::from_le_bytes(std::array::from_fn(|i| bytes[at + i]));
        let long = |at: usize| u64::from_le_bytes(std::array::from_fn(|i| bytes[at + i]));
        // Of another version nothing else is read: what stands where may have changed, the sender's start included.
        if word(12) != PROTOCOL_VERSION {
            let text = format!(
                "the message has protocol {}, its receiver speaks {PROTOCOL_VERSION}: run the same release on both sides",
                word(12)
            );
            return Err(Refusal::new(RefusalCause::Protocol, text));
        }
        let Ok(schema) = bytemuck::checked::try_cast(word(4)) else {
            let text = format!("unknown message schema {}", word(4));
            return Err(Refusal::new(RefusalCause::Schema, text));
        };
        Ok(Self {
            protocol: word(12),
            schema,
            checksum: word(8),
            incarnation: Incarnation(long(16)),
            sequence: Sequence(long(24)),
            epoch: Epoch(long(32)),
            version: PolicyVersion(long(40)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header() -> Header {
        Header {
            sequence: Sequence(7),
            epoch: Epoch(8),
            version: PolicyVersion(9),
            ..Header::plain(Schema::Rollout, Incarnation(6), b"payload")
        }
    }

    #[test]
    fn a_header_survives_the_wire() {
        assert_eq!(Header::from_bytes(&header().to_bytes()), Ok(header()));
    }

    #[test]
    fn short_foreign_unknown_and_newer_headers_are_refused() {
        let good = header().to_bytes();
        let changed = |at: usize, value: u8| {
            let mut bytes = good;
            bytes[at] = value;
            bytes
        };
        for (bytes, cause) in [
            (&good[..47], RefusalCause::Header),
            (&changed(0, b'X'), RefusalCause::Header),
            (&changed(4, 99), RefusalCause::Schema),
            (&changed(7, 1), RefusalCause::Schema),
            (&changed(12, 200), RefusalCause::Protocol),
        ] {
            let refusal = Header::from_bytes(bytes).unwrap_err();
            assert_eq!((refusal.cause, refusal.sender), (cause, None));
        }
        let told = Header::from_bytes(&changed(12, 200)).unwrap_err().to_string();
        assert!(told.contains("protocol 200, its receiver speaks 6"), "{told}");
    }
}
