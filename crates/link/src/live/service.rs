//! The notifier's end: who asks for a session, who is there, and a place for each client.

use std::sync::Arc;

use leadtime_proto::limits::MAX_LIVE_BYTES;
use leadtime_proto::{ClientName, Incarnation, ServiceName};
use zenoh::Wait as _;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::query::{Query, Queryable};
use zenoh::sample::SampleKind;
use zenoh::session::Session;

use super::keys::{LiveKey, check_name, parse_alive, parse_open, parse_session};
use super::port::LivePort;
use super::robot::RobotKeys;
use crate::answer::{Answers, OwedAnswer, PendingReply};
use crate::pubsub::{appear, take_questions, watch_tokens};
use crate::queue::{Class, EventQueue};
use crate::{Error, ListenSettings, Result, session};

/// Threads that answer questions.
const N_ANSWERERS: usize = 1;

/// What happens to a notifier at work.
#[derive(Debug)]
pub enum LiveEvent {
    /// A client asks for a session.
    Open {
        /// The name of the client.
        client: ClientName,
        /// What the client asks for, as JSON.
        question: Vec<u8>,
        /// The way to the answer.
        responder: OpenResponder,
    },
    /// A recorder asks what a client's session is.
    Describe(ClientName, OpenResponder),
    /// This start of a client is there (may be told more than once).
    Here(ClientName, Incarnation),
    /// This start of a client is gone.
    Gone(ClientName, Incarnation),
}

/// The way to the answer of one question; dropped, it ends the question without one.
#[derive(Debug)]
pub struct OpenResponder(OwedAnswer);

impl OpenResponder {
    /// Gives the answer, JSON.
    pub fn reply(self, json: Vec<u8>) {
        self.0.give(|query| PendingReply::Json(query, json));
    }

    /// Says no, with a sentence.
    pub fn refuse(self, sentence: String) {
        self.0.give(|query| PendingReply::Refusal(query, sentence));
    }
}

/// A notifier's place on the network.
#[derive(Debug)]
pub struct LiveServiceLink {
    service: ServiceName,
    locators: Vec<String>,
    token: LivelinessToken,
    _questions: [Queryable<()>; 2],
    _clients: Subscriber<()>,
    /// Last, because fields are dropped in order: everything declared on the session is undeclared before it closes.
    session: Session,
}

impl LiveServiceLink {
    /// Listens, or connects to a router, and answers from now on.
    ///
    /// # Errors
    ///
    /// As [`LearnerLink::open`](crate::LearnerLink::open).
    pub async fn open(
        settings: &ListenSettings,
        service: &ServiceName,
        incarnation: Incarnation,
    ) -> Result<(Self, flume::Receiver<LiveEvent>)> {
        let session = session::listen_live(settings).await?;
        let locators = session.info().locators().await;
        let (events, receiver) = EventQueue::new(0);
        let answers = Answers::start(N_ANSWERERS)?;
        let (asked, told) = (events.clone(), events.clone());
        let (key, owed) = (LiveKey::Opens(service), answers.clone());
        let opens = take_questions(&session, key, move |query| on_question(query, &owed, &asked))?;
        let key = LiveKey::Sessions(service);
        let sessions =
            take_questions(&session, key, move |query| on_recorder(query, &answers, &told))?;
        let clients = watch_tokens(&session, LiveKey::Clients(service), move |key, kind| {
            let Some(alive) = parse_alive(key) else { return };
            let Some(client) = alive.client else { return };
            let event = match kind {
                SampleKind::Put => LiveEvent::Here(client, alive.incarnation),
                SampleKind::Delete => LiveEvent::Gone(client, alive.incarnation),
            };
            // Questions leave room for it.
            drop(events.offer(event, Class::Presence));
        })?;
        let token = appear(&session, LiveKey::Service(service, incarnation))?;
        let locators = locators.iter().map(ToString::to_string).collect();
        let service = service.clone();
        let link = Self {
            service,
            locators,
            token,
            _questions: [opens, sessions],
            _clients: clients,
            session,
        };
        Ok((link, receiver))
    }

    /// Returns the addresses at which it can be reached, with the ports that were taken.
    pub fn locators(&self) -> &[String] {
        &self.locators
    }

    /// Lists the other notifiers of this name that are there: two of them would speak at once.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if the network cannot be asked.
    pub async fn others(&self, own: Incarnation) -> Result<Vec<Incarnation>> {
        let present = super::client::present(&self.session).await?;
        let same = present.into_iter().filter(|(service, _)| *service == self.service);
        Ok(same.map(|(_, start)| start).filter(|start| *start != own).collect())
    }

    /// Returns the name of this session on the network.
    pub fn zid(&self) -> String {
        self.session.zid().to_string()
    }

    /// Opens a place for a client, or for a robot with keys of its own; `wake` is called whenever something has arrived, and must not wait.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if it cannot be declared; [`Error::ReservedName`], [`Error::RobotKey`].
    pub fn port(
        &self,
        client: &ClientName,
        say_raw: bool,
        robot: Option<&RobotKeys>,
        wake: Arc<dyn Fn() + Send + Sync>,
    ) -> Result<LivePort> {
        check_name(client)?;
        robot.map_or(Ok(()), RobotKeys::check)?;
        LivePort::open(&self.session, &self.service, client, say_raw, robot, wake)
    }

    /// Checks that clients can still reach this notifier. Call it regularly: no event reports that they cannot.
    ///
    /// # Errors
    ///
    /// [`Error::Dead`] if it cannot.
    pub async fn health(&self) -> Result<()> {
        let listens = !self.locators.is_empty();
        if session::is_dead(&self.session, listens).await { Err(Error::Dead) } else { Ok(()) }
    }

    /// Leaves the network, within a limited time.
    ///
    /// # Errors
    ///
    /// [`Error::Close`] if it takes too long.
    pub async fn close(self) -> Result<()> {
        drop(self.token.undeclare().wait());
        session::close(&self.session).await
    }
}

fn on_question(query: Query, answers: &Answers, events: &EventQueue<LiveEvent>) {
    let client = parse_open(query.key_expr());
    let question = query.payload().map(|payload| payload.to_bytes().into_owned());
    let responder = OpenResponder(OwedAnswer::new(query, answers));
    let Some(client) = client else {
        return responder.refuse("the name of a client is 1 to 48 of a-z, 0-9 and `-`".to_owned());
    };
    let question = question.unwrap_or_default();
    if question.len() > MAX_LIVE_BYTES {
        let n = question.len();
        return responder.refuse(format!("this question has {n} bytes; {MAX_LIVE_BYTES} at most"));
    }
    let event = LiveEvent::Open { client, question, responder };
    if let Some(LiveEvent::Open { responder, .. }) = events.offer(event, Class::Request) {
        responder.refuse("too many questions at once: ask again".to_owned());
    }
}

fn on_recorder(query: Query, answers: &Answers, events: &EventQueue<LiveEvent>) {
    let client = parse_session(query.key_expr());
    let responder = OpenResponder(OwedAnswer::new(query, answers));
    // One that has no place is let go, which ends the question: a recorder asks again.
    if let Some(client) = client {
        drop(events.offer(LiveEvent::Describe(client, responder), Class::Request));
    }
}
