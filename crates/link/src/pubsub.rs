//! What is put on keys, and what is declared at them for as long as somebody holds it.

use std::fmt;

use leadtime_proto::header::Schema;
use leadtime_proto::{Header, Incarnation, RunName};
use zenoh::Wait as _;
use zenoh::bytes::Encoding;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::query::{Query, Queryable};
use zenoh::sample::{Sample, SampleKind};
use zenoh::session::Session;

use crate::keys::{self, Alive, Key, Keys, Member};
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
pub(crate) fn put_metrics(
    session: &Session,
    run: &RunName,
    member: &Member,
    incarnation: Incarnation,
    json: &[u8],
) -> Result<()> {
    let header = Header::plain(Schema::Metrics, incarnation, json);
    put(session, Key::Metrics(run, member), wire::METRICS, &header, json.to_vec())
}

/// Declares that messages of one form will be published on a key.
pub(crate) fn publisher(
    session: &Session,
    key: impl fmt::Display,
    qos: Qos,
    form: Encoding,
) -> Result<Publisher<'static>> {
    session
        .declare_publisher(keys::expr(&key))
        .encoding(form)
        .priority(qos.priority)
        .congestion_control(qos.congestion)
        .express(qos.express)
        .wait()
        .map_err(Error::network("declare", &key.to_string()))
}

/// Takes what is published on keys.
pub(crate) fn subscribe(
    session: &Session,
    keys: impl fmt::Display,
    take: impl Fn(Sample) + Send + Sync + 'static,
) -> Result<Subscriber<()>> {
    let declared = session.declare_subscriber(keys::expr(&keys)).callback(take).wait();
    declared.map_err(Error::network("subscribe to", &keys.to_string()))
}

/// Calls `take` for every member that is present, joins or leaves; with `None` for a malformed key.
pub(crate) fn watch(
    session: &Session,
    members: Keys<'_>,
    take: impl Fn(Option<Alive>, SampleKind) + Send + Sync + 'static,
) -> Result<Subscriber<()>> {
    watch_tokens(session, members, move |key, kind| take(keys::parse_alive(key), kind))
}

/// Calls `take` with the key of every token that is present, appears or disappears.
pub(crate) fn watch_tokens(
    session: &Session,
    keys: impl fmt::Display,
    take: impl Fn(&str, SampleKind) + Send + Sync + 'static,
) -> Result<Subscriber<()>> {
    session
        .liveliness()
        .declare_subscriber(keys::expr(&keys))
        .history(true)
        .callback(move |sample| take(sample.key_expr(), sample.kind()))
        .wait()
        .map_err(Error::network("subscribe to", &keys.to_string()))
}

/// Takes the questions at a key, or at every key of a set.
pub(crate) fn take_questions(
    session: &Session,
    keys: impl fmt::Display,
    take: impl Fn(Query) + Send + Sync + 'static,
) -> Result<Queryable<()>> {
    let expr = keys::expr(&keys);
    let declared = session.declare_queryable(expr).complete(true).callback(take).wait();
    declared.map_err(Error::network("declare", &keys.to_string()))
}

/// Declares a presence token, which lasts until it is dropped.
pub(crate) fn appear(session: &Session, alive: impl fmt::Display) -> Result<LivelinessToken> {
    let declared = session.liveliness().declare_token(keys::expr(&alive)).wait();
    declared.map_err(Error::network("declare", &alive.to_string()))
}
