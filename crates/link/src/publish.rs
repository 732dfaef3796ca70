//! Publishing what nobody waits for.

use leadtime_proto::header::Schema;
use leadtime_proto::{Header, Incarnation, RunName};
use zenoh::Wait as _;
use zenoh::session::Session;

use crate::keys::{self, Key, Member};
use crate::wire::{self, Qos};
use crate::{Error, Result};

/// Publishes a message on a key.
pub(crate) fn put(
    session: &Session,
    key: Key<'_>,
    qos: Qos,
    header: &Header,
    payload: Vec<u8>,
) -> Result<()> {
    session
        .put(keys::expr(key), payload)
        .attachment(header.to_bytes())
        .priority(qos.priority)
        .congestion_control(qos.congestion)
        .express(qos.express)
        .wait()
        .map_err(Error::network("publish on", &key.to_string()))
}

/// Publishes a member's metrics.
pub(crate) fn metrics(
    session: &Session,
    run: &RunName,
    member: &Member,
    incarnation: Incarnation,
    json: &[u8],
) -> Result<()> {
    let header = Header::plain(Schema::Metrics, incarnation, json);
    put(session, Key::Metrics(run, member), wire::METRICS, &header, json.to_vec())
}
