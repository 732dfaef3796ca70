//! Message validation: size, header, protocol, schema, checksum, decode. The doorman: no byte is believed before its
//! check.
//!
//! ```text
//! inspect   size limit -> header (48 bytes, magic) -> protocol -> schema          cheap, in a callback
//! (the receiver's own: duplicate? known sender? within its credit?)
//! open      checksum -> decode with a limit -> everything consumed                costs the payload's length
//! (the receiver's own: shapes, ranges, finiteness; `Rollout::check`)
//! ```
//!
//! What fails is a [`Refusal`].

use serde::de::DeserializeOwned;

use crate::codec;
use crate::header::{Header, Schema};
use crate::limits;
use crate::refusal::{Refusal, RefusalCause};

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
pub const CONTROL_REPLY: Expected = Expected::new(Schema::ControlReply, limits::MAX_CONTROL_BYTES);
/// What arrives where a learner takes rollouts.
pub const ROLLOUT: Expected = Expected::new(Schema::Rollout, limits::MAX_ROLLOUT_BYTES);
/// What arrives where an actor gets its credit.
pub const CREDIT: Expected = Expected::new(Schema::Credit, limits::MAX_NOTICE_BYTES);
/// What arrives where weights are announced.
pub const ANNOUNCEMENT: Expected = Expected::new(Schema::Announcement, limits::MAX_NOTICE_BYTES);
/// What arrives for a pull of weights.
pub const WEIGHTS: Expected = Expected::new(Schema::Weights, limits::MAX_WEIGHTS_BYTES);
/// What arrives where metrics are reported.
pub const METRICS: Expected = Expected::new(Schema::Metrics, limits::MAX_METRICS_BYTES);
/// What arrives for the question what a run is.
pub const ABOUT: Expected = Expected::new(Schema::About, limits::MAX_METRICS_BYTES);
/// What arrives for the question how a run went so far.
pub const HISTORY: Expected = Expected::new(Schema::History, limits::MAX_METRICS_BYTES);

/// Checks what can be checked without touching the payload: size, header, protocol, schema.
///
/// # Errors
///
/// [`RefusalCause::Oversize`] if the payload is longer than `expected` allows; what [`Header::from_bytes`] refuses;
/// [`RefusalCause::Schema`] if the message is of another kind than `expected`. The refusal names the sender where the
/// header could be read.
pub fn inspect(
    attachment: Option<&[u8]>,
    payload_len: usize,
    expected: Expected,
) -> Result<Header, Refusal> {
    // The header first, although the size is checked before it: an oversized message with a readable header has a
    // sender that can be blamed.
    let header = Header::from_bytes(attachment.unwrap_or_default());
    if payload_len > expected.max_bytes {
        let limit = expected.max_bytes;
        let text = format!("message has {payload_len} bytes, at most {limit} are possible");
        let sender = header.ok().map(|header| header.incarnation);
        return Err(Refusal { sender, ..Refusal::new(RefusalCause::Oversize, text) });
    }
    let header = header?;
    // The codec would decode the bytes of another kind as this one wherever they happen to fit.
    if header.schema != expected.schema {
        let (found, wanted) = (header.schema as u32, expected.schema as u32);
        let text = format!("message has schema {found}, expected {wanted}");
        return Err(Refusal::new(RefusalCause::Schema, text).of(header.incarnation));
    }
    Ok(header)
}

/// Checks an inspected message's payload against its header's checksum.
///
/// # Errors
///
/// [`RefusalCause::Checksum`] if the payload's CRC-32C is not the header's.
pub fn verify(header: &Header, payload: &[u8]) -> Result<(), Refusal> {
    // It finds damage and mix-ups. Against a sender who means harm it does nothing: certificates and access lists do.
    if crc32c::crc32c(payload) == header.checksum {
        return Ok(());
    }
    let refusal = Refusal::new(RefusalCause::Checksum, "checksum does not match the payload");
    Err(refusal.of(header.incarnation))
}

/// Decodes an inspected message: checksum, decode with a limit, everything consumed.
///
/// # Errors
///
/// [`RefusalCause::Checksum`] if the payload is not the header's; [`RefusalCause::Malformed`] if it cannot be decoded
/// within the limit, or bytes are left over.
pub fn open<T: DeserializeOwned>(
    header: &Header,
    payload: &[u8],
    expected: Expected,
) -> Result<T, Refusal> {
    verify(header, payload)?;
    codec::decode(payload, expected.max_bytes).map_err(|_not_one| {
        let refusal = Refusal::new(RefusalCause::Malformed, "payload cannot be decoded");
        refusal.of(header.incarnation)
    })
}

/// Does all of it: [`inspect`], then [`open`].
///
/// # Errors
///
/// [`Refusal`] of the first check that fails: [`inspect`] has size, header, protocol and schema, [`open`] checksum and
/// decoding.
///
/// # Example
///
/// ```
/// use leadtime_proto::message::ControlReply;
/// use leadtime_proto::receive::{self, CONTROL_REPLY};
/// use leadtime_proto::{Epoch, Header, Incarnation, RefusalCause, codec};
///
/// let payload = codec::encode(&ControlReply::Followed { epoch: Epoch(3) })?;
/// let header = Header::plain(CONTROL_REPLY.schema, Incarnation(1), &payload).to_bytes();
///
/// let (_, reply) = receive::receive::<ControlReply>(Some(&header), &payload, CONTROL_REPLY).unwrap();
/// assert_eq!(reply, ControlReply::Followed { epoch: Epoch(3) });
///
/// let refusal = receive::receive::<ControlReply>(None, &payload, CONTROL_REPLY).unwrap_err();
/// assert_eq!(refusal.cause, RefusalCause::Header);
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
    use super::*;
    use crate::message::ControlReply;
    use crate::{Epoch, Incarnation};

    #[test]
    fn each_check_refuses_with_its_own_cause_and_names_the_sender_if_there_is_a_header() {
        use RefusalCause as Cause;
        let payload = codec::encode(&ControlReply::Followed { epoch: Epoch(700) }).unwrap();
        let sealed = |payload: &[u8]| {
            Header::plain(Schema::ControlReply, Incarnation(1), payload).to_bytes()
        };
        let bytes = sealed(&payload);
        let tiny = Expected { max_bytes: 1, ..CONTROL_REPLY };
        let mut other_protocol = bytes;
        other_protocol[12] = 9;
        let mut damaged = payload.clone();
        damaged[0] ^= 1;
        let longer = [payload.as_slice(), &[0]].concat();
        let fitting = sealed(&longer);
        let known = Some(Incarnation(1));
        for (attachment, payload, expected, cause, sender) in [
            (Some(bytes.as_slice()), &payload, tiny, Cause::Oversize, known),
            (None, &payload, tiny, Cause::Oversize, None),
            (None, &payload, CONTROL_REPLY, Cause::Header, None),
            (Some(&bytes[..47]), &payload, CONTROL_REPLY, Cause::Header, None),
            (Some(&other_protocol), &payload, CONTROL_REPLY, Cause::Protocol, None),
            (Some(&bytes), &payload, CREDIT, Cause::Schema, known),
            (Some(&bytes), &damaged, CONTROL_REPLY, Cause::Checksum, known),
            (Some(&fitting), &longer, CONTROL_REPLY, Cause::Malformed, known),
        ] {
            let refusal = receive::<ControlReply>(attachment, payload, expected).unwrap_err();
            assert_eq!((refusal.cause, refusal.sender), (cause, sender));
        }
    }
}
