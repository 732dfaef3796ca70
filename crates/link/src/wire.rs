//! Priorities, and how a message meets its header.

use std::borrow::Cow;
use std::sync::Arc;

use leadtime_proto::header::Schema;
#[cfg(any(test, feature = "fakes"))]
use leadtime_proto::message::Hello;
use leadtime_proto::receive::{self, Expected};
use leadtime_proto::{Header, Incarnation, Refusal, RefusalCause, Sequence, codec};
use serde::Serialize;
use serde::de::DeserializeOwned;
use zenoh::bytes::ZBytes;
use zenoh::qos::{CongestionControl, Priority};

use crate::Result;
use crate::proof::{self, Keyring, PeerKey, SIGNED_PROOF_BYTES, StartKey, TAG_PROOF_BYTES};

/// How a message travels: its quality of service.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Qos {
    pub(crate) priority: Priority,
    pub(crate) congestion: CongestionControl,
    pub(crate) express: bool,
}

/// Hello and orders: first of all, never lost.
pub(crate) const CONTROL: Qos =
    Qos { priority: Priority::RealTime, congestion: CongestionControl::Block, express: true };
/// Observations and what is said about them: first of all, and never waited for, because the next one says more.
pub(crate) const SPEECH: Qos =
    Qos { priority: Priority::RealTime, congestion: CongestionControl::Drop, express: true };
/// Announcements. Dropped rather than waited for: they are repeated, and waiting for one slow peer would hold up what the
/// others live on.
pub(crate) const NOTICE: Qos =
    Qos { priority: Priority::InteractiveHigh, congestion: CongestionControl::Drop, express: true };
/// Credit, for the same reasons. There is one for each actor, and an announcement is not to wait behind those of a hundred.
pub(crate) const CREDIT: Qos =
    Qos { priority: Priority::InteractiveLow, congestion: CongestionControl::Drop, express: true };
/// Rollouts and weights. They wait: a rollout that is dropped on the way would come again only after a time-out. That
/// is why they are sent by threads of their own.
pub(crate) const BULK: Qos =
    Qos { priority: Priority::Data, congestion: CongestionControl::Block, express: false };
/// What observers ask for: after everything else, but it arrives whole.
pub(crate) const ARCHIVE: Qos =
    Qos { priority: Priority::Background, congestion: CongestionControl::Block, express: false };
/// Metrics: nobody waits for them.
pub(crate) const METRICS: Qos =
    Qos { priority: Priority::Background, congestion: CongestionControl::Drop, express: false };

/// Encodes a message for one other start, with its header and its proof; `number` counts orders, and is in an answer that of
/// its question.
pub(crate) fn seal<T: Serialize>(
    schema: Schema,
    key: &PeerKey,
    number: Sequence,
    message: &T,
) -> Result<(Header, Vec<u8>)> {
    let mut payload = codec::encode(message)?;
    let header = Header { sequence: number, ..Header::plain(schema, key.us, &payload) };
    let proof = key.prove(&header, &payload);
    payload.extend_from_slice(&proof);
    Ok((header, payload))
}

/// Encodes a message for everybody, with its header and its proof; `number` counts hellos.
pub(crate) fn sign<T: Serialize>(
    schema: Schema,
    key: &StartKey,
    number: Sequence,
    message: &T,
) -> Result<(Header, Vec<u8>)> {
    let mut payload = codec::encode(message)?;
    let plain = Header::plain(schema, key.incarnation(), &payload);
    let header = Header { sequence: number, ..plain };
    let proof = key.sign(&header, &payload);
    payload.extend_from_slice(&proof);
    Ok((header, payload))
}

/// Composes a hello as it crosses the network, for tests that say it by other means.
///
/// # Errors
///
/// [`crate::Error::Codec`] if it cannot be encoded.
#[cfg(any(test, feature = "fakes"))]
pub fn fake_hello(key: &StartKey, number: u64, hello: &Hello) -> Result<(Header, Vec<u8>)> {
    sign(Schema::Hello, key, Sequence(number), hello)
}

/// A message that proves which start it comes from.
#[derive(Debug)]
pub(crate) struct ProvedMessage<T, K = Arc<PeerKey>> {
    /// What we share with that start.
    pub(crate) key: K,
    /// With its number, as [`seal`] or [`sign`] gave it.
    pub(crate) header: Header,
    pub(crate) message: T,
}

/// Reads a message for us, whoever sent it.
pub(crate) fn unseal<T: DeserializeOwned>(
    attachment: Option<&ZBytes>,
    payload: Option<&ZBytes>,
    expected: Expected,
    keys: &Keyring,
) -> Result<ProvedMessage<T>, Refusal> {
    read(attachment, payload, expected, TAG_PROOF_BYTES, |head, it| keys.check(head, it))
}

/// Reads the answer of one start to the question with this number.
pub(crate) fn unseal_answer<T: DeserializeOwned>(
    attachment: Option<&ZBytes>,
    payload: Option<&ZBytes>,
    expected: Expected,
    peer: &PeerKey,
    number: Sequence,
) -> Result<T, Refusal> {
    let proved = read(attachment, payload, expected, TAG_PROOF_BYTES, |header, it| {
        let body = peer.check(header, it)?;
        answers(number, header.sequence).map(|()| ((), body))
    });
    Ok(proved?.message)
}

/// Checks that an answer is not one that somebody kept from an earlier question.
pub(crate) fn answers(question: Sequence, answer: Sequence) -> Result<(), Refusal> {
    if answer == question {
        return Ok(());
    }
    Err(Refusal::new(RefusalCause::Proof, "the answer is not to this question"))
}

/// Reads a hello, as [`unseal`] reads other messages.
pub(crate) fn unseal_hello<T: DeserializeOwned>(
    attachment: Option<&ZBytes>,
    payload: Option<&ZBytes>,
    expected: Expected,
    keys: &Keyring,
) -> Result<ProvedMessage<T>, Refusal> {
    read(attachment, payload, expected, SIGNED_PROOF_BYTES, |head, it| keys.check_hello(head, it))
}

/// Reads a message for everybody, and returns the start that proves it.
pub(crate) fn unseal_signed<T: DeserializeOwned>(
    attachment: Option<&ZBytes>,
    payload: Option<&ZBytes>,
    expected: Expected,
) -> Result<(Incarnation, T), Refusal> {
    let proved = read(attachment, payload, expected, SIGNED_PROOF_BYTES, proof::check_signed)?;
    Ok((proved.header.incarnation, proved.message))
}

/// Reads a message behind which stands a proof of so many bytes; `check` splits it off, before anything is decoded.
fn read<T: DeserializeOwned, K>(
    attachment: Option<&ZBytes>,
    payload: Option<&ZBytes>,
    expected: Expected,
    n_proof_bytes: usize,
    check: impl for<'a> FnOnce(&Header, &'a [u8]) -> Result<(K, &'a [u8]), Refusal>,
) -> Result<ProvedMessage<T, K>, Refusal> {
    let header = inspect(attachment, payload, with_proof(expected, n_proof_bytes))?;
    let bytes = payload.map_or(Cow::Borrowed(&[][..]), ZBytes::to_bytes);
    let (key, body) = check(&header, &bytes)?;
    Ok(ProvedMessage { key, header, message: receive::open(&header, body, expected)? })
}

/// Returns what may arrive if a proof of so many bytes stands behind it.
pub(crate) fn with_proof(expected: Expected, n_bytes: usize) -> Expected {
    Expected { max_bytes: expected.max_bytes + n_bytes, ..expected }
}

/// Checks size, header, protocol and schema; touches no payload byte.
pub(crate) fn inspect(
    attachment: Option<&ZBytes>,
    payload: Option<&ZBytes>,
    expected: Expected,
) -> Result<Header, Refusal> {
    let attachment = attachment.map(ZBytes::to_bytes);
    receive::inspect(attachment.as_deref(), payload.map_or(0, ZBytes::len), expected)
}
