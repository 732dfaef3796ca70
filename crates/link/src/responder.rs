//! Answers that are still owed: to a hello and to an order.
//!
//! Dropping a responder ends the question without an answer; the asker tries again or gives up.

use leadtime_proto::header::Schema;
use leadtime_proto::message::{ControlAck, HelloReply, Welcome};
use leadtime_proto::{Header, Incarnation};
use zenoh::Wait as _;
use zenoh::bytes::Encoding;
use zenoh::query::Query;

use crate::{Error, Result, wire};

/// The learner's answer to a hello.
#[derive(Debug)]
pub struct HelloResponder {
    query: Query,
    incarnation: Incarnation,
}

impl HelloResponder {
    pub(crate) fn new(query: Query, incarnation: Incarnation) -> Self {
        Self { query, incarnation }
    }

    pub(crate) fn into_query(self) -> Query {
        self.query
    }

    /// Lets the actor in.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if the answer cannot be sent.
    pub fn welcome(self, welcome: Welcome) -> Result<()> {
        self.reply(&HelloReply::Welcome(Box::new(welcome)))
    }

    /// Turns the actor away with one sentence: what is wrong and what to do.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if the answer cannot be sent.
    pub fn refuse(self, reason: &str) -> Result<()> {
        self.reply(&HelloReply::Refused { reason: reason.to_owned() })
    }

    /// Turns the actor away because its name is taken.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if the answer cannot be sent.
    pub fn taken(self) -> Result<()> {
        self.reply(&HelloReply::Taken)
    }

    fn reply(self, reply: &HelloReply) -> Result<()> {
        let (header, payload) = wire::seal(Schema::HelloReply, self.incarnation, reply)?;
        send(&self.query, &header, payload)
    }
}

/// An actor's acknowledgement of an order.
#[derive(Debug)]
pub struct ControlResponder {
    query: Query,
    incarnation: Incarnation,
}

impl ControlResponder {
    pub(crate) fn new(query: Query, incarnation: Incarnation) -> Self {
        Self { query, incarnation }
    }

    /// Says that the order was taken.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if the answer cannot be sent.
    pub fn acknowledge(self, ack: ControlAck) -> Result<()> {
        let (header, payload) = wire::seal(Schema::ControlAck, self.incarnation, &ack)?;
        send(&self.query, &header, payload)
    }
}

fn send(query: &Query, header: &Header, payload: Vec<u8>) -> Result<()> {
    query
        .reply(query.key_expr().clone(), payload)
        .attachment(header.to_bytes())
        .encoding(Encoding::APPLICATION_OCTET_STREAM)
        .wait()
        .map_err(Error::network("answer on", query.key_expr()))
}
