//! Answering questions on threads of their own.
//!
//! An answer waits for a slow connection (the network's replies have their question's congestion control, and hellos,
//! orders and pulls wait), and neither a callback nor a loop that serves everybody may. So what owes an answer hands
//! it over here; even an answer that is never given, because ending a question sends a message, too.

use std::marker::PhantomData;
use std::sync::Arc;
use std::thread;

use leadtime_proto::header::Schema;
use leadtime_proto::message::{ControlReply, Hello, HelloReply};
use leadtime_proto::{ActorId, Header, Sequence};
use serde::Serialize;
use tracing::debug;
use zenoh::Wait as _;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::query::Query;

use crate::admitted::Admitted;
use crate::keys::VERSION;
use crate::proof::PeerKey;
use crate::weights::WeightStore;
use crate::wire::ProvedMessage;
use crate::{Error, Result, wire};

/// The most answers that wait to be sent; an asker beyond that tries again.
const MAX_PENDING: usize = 2_048;

/// An answer that somebody owes.
#[derive(Debug)]
pub(crate) enum PendingReply {
    /// A message of ours.
    Message(Query, Header, ZBytes),
    /// Whatever of these weights the question asks for.
    Weights(Query, Arc<WeightStore>),
    /// Text without a header of ours.
    Json(Query, Vec<u8>),
    /// A sentence that says no.
    Refusal(Query, String),
    /// Nothing but the end of the question.
    Nothing(Query),
}

/// Drops the payload and attachment of a question that has been read, so that they use no memory while its answer waits.
pub(crate) fn unload(query: &mut Query) {
    drop(query.payload_mut().map(std::mem::take));
    drop(query.attachment_mut().map(std::mem::take));
}

/// Where owed answers are handed over, without waiting.
#[derive(Clone, Debug)]
pub(crate) struct Answers(flume::Sender<PendingReply>);

impl Answers {
    /// Starts the threads that answer; they end when the last clone of this is dropped.
    ///
    /// As many askers as there are threads can be slow before the others have to wait.
    pub(crate) fn start(n_threads: usize) -> Result<Self> {
        let (sender, receiver) = flume::bounded(MAX_PENDING);
        for i in 0..n_threads {
            let receiver: flume::Receiver<PendingReply> = receiver.clone();
            let work = move || receiver.iter().for_each(answer);
            let name = format!("link-answer-{i}");
            // Detached: it ends by itself when the questions' places are undeclared.
            drop(thread::Builder::new().name(name).spawn(work).map_err(Error::Thread)?);
        }
        Ok(Self(sender))
    }

    /// Hands an answer over. Beyond the limit the question ends without one, and the asker tries again.
    pub(crate) fn give(&self, reply: PendingReply) {
        drop(self.0.try_send(reply));
    }
}

fn answer(reply: PendingReply) {
    let sent = match reply {
        PendingReply::Message(query, header, payload) => send(&query, &header, payload),
        PendingReply::Weights(query, store) => match store.find(query.parameters().get(VERSION)) {
            Ok((header, payload)) => send(&query, &header, payload),
            Err(reason) => refuse(&query, reason),
        },
        PendingReply::Json(query, text) => send_json(&query, text),
        PendingReply::Refusal(query, reason) => refuse(&query, reason),
        PendingReply::Nothing(query) => return drop(query),
    };
    if let Err(error) = sent {
        debug!(%error, "an answer could not be sent");
    }
}

fn send(query: &Query, header: &Header, payload: ZBytes) -> zenoh::Result<()> {
    query
        .reply(query.key_expr().clone(), payload)
        .attachment(header.to_bytes())
        .encoding(Encoding::APPLICATION_OCTET_STREAM)
        .wait()
}

fn send_json(query: &Query, text: Vec<u8>) -> zenoh::Result<()> {
    query.reply(query.key_expr().clone(), text).encoding(Encoding::APPLICATION_JSON).wait()
}

fn refuse(query: &Query, reason: String) -> zenoh::Result<()> {
    query.reply_err(reason).encoding(Encoding::TEXT_PLAIN).wait()
}

/// A question whose answer is owed; dropped, it ends without one.
#[derive(Debug)]
pub(crate) struct OwedAnswer {
    query: Option<Query>,
    answers: Answers,
}

impl OwedAnswer {
    pub(crate) fn new(query: Query, answers: &Answers) -> Self {
        Self { query: Some(query), answers: answers.clone() }
    }

    /// Returns how many bytes of the question are still kept.
    #[cfg(test)]
    pub(crate) fn n_bytes(&self) -> usize {
        let parts = self.query.iter().flat_map(|query| [query.payload(), query.attachment()]);
        parts.flatten().map(ZBytes::len).sum()
    }

    /// Hands the answer over.
    pub(crate) fn give(mut self, reply: impl FnOnce(Query) -> PendingReply) {
        if let Some(query) = self.query.take() {
            self.answers.give(reply(query));
        }
    }
}

impl Drop for OwedAnswer {
    fn drop(&mut self) {
        if let Some(query) = self.query.take() {
            self.answers.give(PendingReply::Nothing(query));
        }
    }
}

/// A question and the way to its answer. Giving one never waits; dropping this ends the question without an answer, and
/// the asker tries again or gives up.
#[derive(Debug)]
pub struct Responder<T> {
    owed: OwedAnswer,
    schema: Schema,
    /// Shared with who asks.
    key: Arc<PeerKey>,
    /// The number of the question, which the answer repeats.
    number: Sequence,
    answer: PhantomData<fn(T)>,
}

/// The learner's answer to a hello.
#[derive(Debug)]
pub struct HelloResponder {
    reply: Responder<HelloReply>,
    admitted: Arc<Admitted>,
    actor: ActorId,
}

impl HelloResponder {
    pub(crate) fn new(
        reply: Responder<HelloReply>,
        admitted: &Arc<Admitted>,
        hello: &Hello,
    ) -> Self {
        Self { reply, admitted: Arc::clone(admitted), actor: hello.actor.clone() }
    }

    /// Gives the answer; the rollouts of whoever is welcome are taken from then on.
    ///
    /// # Errors
    ///
    /// [`crate::Error::Codec`] if it cannot be encoded.
    pub fn reply(self, answer: &HelloReply) -> Result<()> {
        if matches!(answer, HelloReply::Welcome(_)) {
            self.admitted.insert(self.actor, Arc::clone(&self.reply.key));
        }
        self.reply.reply(answer)
    }
}

/// An actor's answer to an order.
pub type ControlResponder = Responder<ControlReply>;

impl<T: Serialize> Responder<T> {
    pub(crate) fn new<Q>(
        query: Query,
        answers: &Answers,
        schema: Schema,
        question: &ProvedMessage<Q>,
    ) -> Self {
        let owed = OwedAnswer::new(query, answers);
        let (key, number) = (Arc::clone(&question.key), question.header.sequence);
        Self { owed, schema, key, number, answer: PhantomData }
    }

    /// Gives the answer.
    ///
    /// # Errors
    ///
    /// [`crate::Error::Codec`] if it cannot be encoded.
    pub fn reply(self, answer: &T) -> Result<()> {
        let (header, payload) = wire::seal(self.schema, &self.key, self.number, answer)?;
        self.owed.give(|query| PendingReply::Message(query, header, payload.into()));
        Ok(())
    }
}
