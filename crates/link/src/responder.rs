//! Answers that the consumer of an event owes: to a hello and to an order.
//!
//! Giving one never waits. Dropping a responder ends the question without an answer; the asker tries again or gives up.

use leadtime_proto::Incarnation;
use leadtime_proto::header::Schema;
use leadtime_proto::message::{ControlReply, HelloReply, Welcome};
use serde::Serialize;
use zenoh::query::Query;

use crate::answer::{Answers, PendingReply};
use crate::{Result, wire};

/// A question and the way to its answer.
#[derive(Debug)]
struct Responder {
    query: Option<Query>,
    answers: Answers,
    incarnation: Incarnation,
}

impl Responder {
    fn reply<T: Serialize>(mut self, schema: Schema, message: &T) -> Result<()> {
        let (header, payload) = wire::seal(schema, self.incarnation, message)?;
        if let Some(query) = self.query.take() {
            self.answers.give(PendingReply::Message(query, header, payload.into()));
        }
        Ok(())
    }
}

impl Drop for Responder {
    fn drop(&mut self) {
        if let Some(query) = self.query.take() {
            self.answers.give(PendingReply::Nothing(query));
        }
    }
}

/// The learner's answer to a hello.
#[derive(Debug)]
pub struct HelloResponder(Responder);

impl HelloResponder {
    pub(crate) fn new(query: Query, answers: Answers, incarnation: Incarnation) -> Self {
        Self(Responder { query: Some(query), answers, incarnation })
    }

    /// Lets the actor in.
    ///
    /// # Errors
    ///
    /// [`crate::Error::Codec`] if the answer cannot be encoded.
    pub fn welcome(self, welcome: Welcome) -> Result<()> {
        self.0.reply(Schema::HelloReply, &HelloReply::Welcome(Box::new(welcome)))
    }

    /// Turns the actor away with one sentence: what is wrong and what to do.
    ///
    /// # Errors
    ///
    /// [`crate::Error::Codec`] if the answer cannot be encoded.
    pub fn refuse(self, reason: &str) -> Result<()> {
        self.0.reply(Schema::HelloReply, &HelloReply::Refused { reason: reason.to_owned() })
    }

    /// Turns the actor away because its name is taken.
    ///
    /// # Errors
    ///
    /// [`crate::Error::Codec`] if the answer cannot be encoded.
    pub fn taken(self) -> Result<()> {
        self.0.reply(Schema::HelloReply, &HelloReply::Taken)
    }
}

/// An actor's answer to an order.
#[derive(Debug)]
pub struct ControlResponder(Responder);

impl ControlResponder {
    pub(crate) fn new(query: Query, answers: Answers, incarnation: Incarnation) -> Self {
        Self(Responder { query: Some(query), answers, incarnation })
    }

    /// Says what became of the order.
    ///
    /// # Errors
    ///
    /// [`crate::Error::Codec`] if the answer cannot be encoded.
    pub fn reply(self, reply: &ControlReply) -> Result<()> {
        self.0.reply(Schema::ControlReply, reply)
    }
}
