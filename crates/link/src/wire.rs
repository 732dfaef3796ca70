//! Priorities, and how a message meets its header.

use std::borrow::Cow;

use leadtime_proto::header::Schema;
use leadtime_proto::receive::{self, Expected};
use leadtime_proto::{Header, Incarnation, Refusal, codec};
use serde::Serialize;
use serde::de::DeserializeOwned;
use zenoh::bytes::ZBytes;
use zenoh::qos::{CongestionControl, Priority};

use crate::Result;

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
/// Credit and announcements. Dropped rather than waited for: they are repeated, and waiting for one slow peer would hold
/// up what the others live on.
pub(crate) const NOTICE: Qos =
    Qos { priority: Priority::InteractiveHigh, congestion: CongestionControl::Drop, express: true };
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

/// Encodes a message and makes its header.
pub(crate) fn seal<T: Serialize>(
    schema: Schema,
    incarnation: Incarnation,
    message: &T,
) -> Result<(Header, Vec<u8>)> {
    let payload = codec::encode(message)?;
    Ok((Header::plain(schema, incarnation, &payload), payload))
}

/// Reads a message that came with its header as an attachment.
pub(crate) fn unseal<T: DeserializeOwned>(
    attachment: Option<&ZBytes>,
    payload: Option<&ZBytes>,
    expected: Expected,
) -> Result<T, Refusal> {
    let header = inspect(attachment, payload, expected)?;
    let bytes = payload.map_or(Cow::Borrowed(&[][..]), ZBytes::to_bytes);
    receive::open(&header, &bytes, expected)
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
