//! The notifier's end: who asks for a session, who is there, and a place for each client.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use leadtime_proto::limits::MAX_LIVE_BYTES;
use leadtime_proto::{ClientName, Incarnation, ServiceName};
use zenoh::Wait as _;
use zenoh::bytes::ZBytes;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::query::{Query, Queryable};
use zenoh::sample::SampleKind;
use zenoh::session::Session;

use super::client::LOOK;
use super::keys::{LiveKey, check_name, parse_alive, parse_open, parse_session};
use super::port::LivePort;
use super::robot::RobotKeys;
use crate::answer::{Answers, OwedAnswer, PendingReply, unload};
use crate::ask::is_answered;
use crate::pubsub::{appear, take_questions, watch_tokens};
use crate::queue::{Class, EventQueue};
use crate::{Error, ListenSettings, Result, discovery, session};

/// Threads that answer questions.
const N_ANSWERERS: usize = 1;
/// How long another notifier that shows presence may take to show that it is at work: longer than the presence of one that was killed
/// lasts.
const PROOF_OF_LIFE: Duration = Duration::from_secs(4);
/// How long the answer to one such question may take.
const LIFE_TIMEOUT: Duration = Duration::from_secs(3);
/// Pause between two of them.
const LIFE_PAUSE: Duration = Duration::from_millis(50);
/// The most clients that are looked at.
const MAX_CLIENTS: usize = 65_536;

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

/// Another notifier of the same name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OtherNotifier {
    /// Nobody shows that it is there.
    Absent,
    /// Somebody shows that it is there, which anybody can, and does not answer.
    Silent,
    /// It answers.
    AtWork,
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
    /// Whether there was no room for an event of presence.
    has_missed: Arc<AtomicBool>,
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
        let has_missed = Arc::new(AtomicBool::new(false));
        let missed = Arc::clone(&has_missed);
        let clients = watch_tokens(&session, LiveKey::Clients(service), move |key, kind| {
            let Some(alive) = parse_alive(key) else { return };
            let Some(client) = alive.client else { return };
            let event = match kind {
                SampleKind::Put => LiveEvent::Here(client, alive.incarnation),
                SampleKind::Delete => LiveEvent::Gone(client, alive.incarnation),
            };
            // Questions leave room for it; a flood of presence may not.
            if events.offer(event, Class::Presence).is_some() {
                missed.store(true, Ordering::Relaxed);
            }
        })?;
        let token = appear(&session, LiveKey::Service(service, incarnation))?;
        let locators = locators.iter().map(ToString::to_string).collect();
        let service = service.clone();
        let link = Self {
            service,
            locators,
            token,
            has_missed,
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

    /// Looks for another notifier of this name: two of them would speak at once. One that shows presence has to answer: anybody can
    /// show it, and that of a notifier that was killed lasts a moment longer than the notifier.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if the network cannot be asked.
    pub async fn other(&self, own: Incarnation) -> Result<OtherNotifier> {
        self.other_within(own, PROOF_OF_LIFE).await
    }

    async fn other_within(&self, own: Incarnation, patience: Duration) -> Result<OtherNotifier> {
        let started = Instant::now();
        loop {
            let keys = LiveKey::Starts(&self.service);
            let present = super::client::present(&self.session, keys).await?;
            if present.iter().all(|(_, start)| *start == own) {
                return Ok(OtherNotifier::Absent);
            }
            if is_answered(&self.session, LiveKey::Life(&self.service), LIFE_TIMEOUT).await? {
                return Ok(OtherNotifier::AtWork);
            }
            if started.elapsed() >= patience {
                return Ok(OtherNotifier::Silent);
            }
            tokio::time::sleep(LIFE_PAUSE).await;
        }
    }

    /// Returns whether events of presence found no room since the last call: who is there then has to be asked
    /// ([`LiveServiceLink::clients`]).
    pub fn take_missed(&self) -> bool {
        self.has_missed.swap(false, Ordering::Relaxed)
    }

    /// Lists the clients that are there now; `None` if not everybody answered, and it is to be asked again.
    pub async fn clients(&self) -> Option<BTreeSet<(ClientName, Incarnation)>> {
        let (keys, action) = (LiveKey::Clients(&self.service), "look for clients on");
        let found = discovery::look_for(&self.session, keys, action, LOOK, MAX_CLIENTS).await;
        let Ok((found, true)) = found else {
            self.has_missed.store(true, Ordering::Relaxed);
            return None;
        };
        let alive = found.iter().filter_map(|key| parse_alive(key));
        Some(alive.filter_map(|alive| Some((alive.client?, alive.incarnation))).collect())
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

fn on_question(mut query: Query, answers: &Answers, events: &EventQueue<LiveEvent>) {
    let client = parse_open(query.key_expr());
    let n_bytes = query.payload().map_or(0, ZBytes::len);
    let question = query.payload().filter(|_| n_bytes <= MAX_LIVE_BYTES);
    let question = question.map(|payload| payload.to_bytes().into_owned()).unwrap_or_default();
    unload(&mut query);
    let responder = OpenResponder(OwedAnswer::new(query, answers));
    let Some(client) = client else {
        return responder.refuse("the name of a client is 1 to 48 of a-z, 0-9 and `-`".to_owned());
    };
    // Here and not behind the queue: so another notifier is told that this one is there, also while it begins or is busy.
    if let Err(error) = check_name(&client) {
        return responder.refuse(error.to_string());
    }
    if n_bytes > MAX_LIVE_BYTES {
        let told = format!("this question has {n_bytes} bytes; {MAX_LIVE_BYTES} at most");
        return responder.refuse(told);
    }
    let event = LiveEvent::Open { client, question, responder };
    if let Some(LiveEvent::Open { responder, .. }) = events.offer(event, Class::Request) {
        responder.refuse("too many questions at once: ask again".to_owned());
    }
}

fn on_recorder(mut query: Query, answers: &Answers, events: &EventQueue<LiveEvent>) {
    let client = parse_session(query.key_expr());
    unload(&mut query);
    let responder = OpenResponder(OwedAnswer::new(query, answers));
    // One that has no place is let go, which ends the question: a recorder asks again.
    if let Some(client) = client {
        drop(events.offer(LiveEvent::Describe(client, responder), Class::Request));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::LiveClientLink;
    use crate::live::client::MAX_SERVICES;
    use crate::test_support::*;

    /// The start of the notifier of these tests.
    const OWN: Incarnation = Incarnation(7);

    fn service() -> ServiceName {
        ServiceName::new("n").unwrap()
    }

    async fn open(hub: &Site, start: Incarnation) -> (LiveServiceLink, flume::Receiver<LiveEvent>) {
        let connect = vec![hub.endpoint.clone()];
        let settings = ListenSettings { connect, ..ListenSettings::new(Vec::new()) };
        LiveServiceLink::open(&settings, &service(), start).await.unwrap()
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn another_notifier_that_answers_is_found_and_bare_presence_is_told_apart() {
        let hub = Site::new();
        let router = hub.raw("router").await;
        let (own, _events) = open(&hub, OWN).await;
        let within = async |patience| own.other_within(OWN, patience).await.unwrap();
        assert_eq!(within(Duration::ZERO).await, OtherNotifier::Absent, "not the own one");

        let key = LiveKey::Service(&service(), Incarnation(8)).to_string();
        let ghost = router.liveliness().declare_token(key).await.unwrap();
        assert_eq!(within(Duration::ZERO).await, OtherNotifier::Silent);
        let (found, ()) = tokio::join!(within(SOON), async { ghost.undeclare().await.unwrap() });
        assert_eq!(found, OtherNotifier::Absent, "it was killed");

        // Nobody takes its events: it answers before it is at work, and while it is busy.
        let (_second, events) = open(&hub, Incarnation(9)).await;
        let answers = async { while within(SOON).await != OtherNotifier::AtWork {} };
        tokio::time::timeout(SOON, answers).await.expect("it shows presence, and answers");
        assert!(events.is_empty(), "a look is no question for a session");
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_notifier_is_found_beside_any_number_of_others() {
        let hub = Site::new();
        let router = hub.raw("router").await;
        let names = (0..MAX_SERVICES + 20).map(|n| ServiceName::new(format!("n{n}")).unwrap());
        let names: Vec<ServiceName> = names.collect();
        let mut tokens = Vec::new();
        for name in &names {
            let key = LiveKey::Service(name, Incarnation(1)).to_string();
            tokens.push(router.liveliness().declare_token(key).await.unwrap());
        }
        let client = LiveClientLink::open(&hub.connect()).await.unwrap();
        for name in &names {
            assert_eq!(client.find(name).await.unwrap(), Incarnation(1));
        }
    }

    /// Asks at a key, again where the notifier's place is not known yet, and returns what is picked of what it is told.
    async fn asked<T>(
        from: &Session,
        events: &flume::Receiver<LiveEvent>,
        key: LiveKey<'_>,
        pick: fn(LiveEvent) -> Option<T>,
    ) -> T {
        let moment = Duration::from_millis(100);
        for _ in 0..200 {
            let ask = from.get(key.to_string()).payload([7; 9]).attachment([8; 9]);
            let answers = ask.timeout(moment).await.unwrap();
            drop(answers.recv_async().await);
            while let Ok(Ok(event)) = tokio::time::timeout(moment, events.recv_async()).await {
                if let Some(picked) = pick(event) {
                    return picked;
                }
            }
        }
        panic!("its place is not known")
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn what_a_question_holds_is_let_go_while_its_answer_waits() {
        let hub = Site::new();
        let router = hub.raw("router").await;
        let (_own, events) = open(&hub, OWN).await;
        let (service, client) = (service(), ClientName::new("c").unwrap());
        let key = LiveKey::Open(&service, &client);
        let opens = asked(&router, &events, key, |event| match event {
            LiveEvent::Open { question, responder, .. } => Some((question, responder.0.n_bytes())),
            _ => None,
        });
        assert_eq!(opens.await, (vec![7; 9], 0));
        let key = LiveKey::Session(&service, &client);
        let describes = asked(&router, &events, key, |event| match event {
            LiveEvent::Describe(_, responder) => Some(responder.0.n_bytes()),
            _ => None,
        });
        assert_eq!(describes.await, 0);
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn who_is_there_can_be_asked_after_a_flood_of_presence() {
        let hub = Site::new();
        let router = hub.raw("router").await;
        let (own, events) = open(&hub, OWN).await;
        assert!(!own.take_missed());
        let client = ClientName::new("c").unwrap();
        let mut tokens = Vec::new();
        let flooded = async {
            // Nobody takes events meanwhile.
            while !own.take_missed() {
                let start = Incarnation(tokens.len() as u64);
                let key = LiveKey::Client(&service(), &client, start).to_string();
                tokens.push(router.liveliness().declare_token(key).await.unwrap());
            }
        };
        tokio::time::timeout(SOON, flooded).await.expect("the queue is full");
        let gone = tokens.pop().unwrap();
        gone.undeclare().await.unwrap();
        let starts = (0..tokens.len()).map(|n| (client.clone(), Incarnation(n as u64)));
        let here: BTreeSet<_> = starts.collect();
        let told = async { while own.clients().await.as_ref() != Some(&here) {} };
        tokio::time::timeout(SOON, told).await.expect("all but the one that is gone");
        assert!(events.is_full(), "what was missed is not told any more");
    }
}
