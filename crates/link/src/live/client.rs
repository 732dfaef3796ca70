//! The client's end: asks for a session, puts observations, takes what is said.

use std::fmt;
use std::time::{Duration, Instant};

use leadtime_proto::{ClientName, Incarnation, ServiceName, text};
use zenoh::Wait as _;
use zenoh::bytes::Encoding;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::SampleKind;
use zenoh::session::Session;

use super::keys::{LiveKey, LiveTopic, check_name, parse_alive};
use super::port::raw;
use crate::pubsub::{appear, publisher, subscribe, watch_tokens};
use crate::{ConnectSettings, Error, Result, discovery, keys, session, wire};

/// How long the answer to one question may take.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(3);
/// Longest wait for one answer to "who is there?".
pub(super) const LOOK: Duration = Duration::from_millis(500);
/// Pause between two looks for a notifier.
const LOOK_PAUSE: Duration = Duration::from_millis(50);
/// The most notifiers that are looked at.
pub(super) const MAX_SERVICES: usize = 256;
/// The most messages that wait for a client; a newer one beyond them is dropped.
pub(super) const MAX_MESSAGES: usize = 1_024;

/// A message to a client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LiveMessage {
    /// An event of what is said.
    Say(Vec<u8>),
    /// What the notifier does.
    Status(Vec<u8>),
    /// This start of the notifier is there.
    ServiceHere(Incarnation),
    /// This start of the notifier is gone.
    ServiceGone(Incarnation),
}

/// The connection of a client with a notifier at work.
#[derive(Debug)]
pub struct LiveClientLink {
    settings: ConnectSettings,
    pub(super) session: Session,
}

impl LiveClientLink {
    /// Connects to a notifier or a router.
    ///
    /// # Errors
    ///
    /// [`Error::Unreachable`] if nobody answers within the settings' time-out.
    pub async fn open(settings: &ConnectSettings) -> Result<Self> {
        let settings = ConnectSettings { whom: "notifier", ..settings.clone() };
        let session = session::connect(&settings).await?;
        Ok(Self { settings, session })
    }

    /// Waits until a notifier of this name is there, for the settings' time-out; returns its start.
    ///
    /// # Errors
    ///
    /// [`Error::NoService`] if there is none.
    pub async fn find(&self, service: &ServiceName) -> Result<Incarnation> {
        find(|| self.session.clone(), &self.settings, service).await
    }

    /// Shows that this client is there, and takes what is said to it.
    ///
    /// # Errors
    ///
    /// [`Error::ReservedName`], or [`Error::Network`] if it cannot be declared.
    pub fn port(
        &self,
        service: &ServiceName,
        client: &ClientName,
        incarnation: Incarnation,
    ) -> Result<ClientPort> {
        check_name(client)?;
        ClientPort::open(&self.session, service, client, incarnation)
    }

    /// Leaves the network, within a limited time.
    ///
    /// # Errors
    ///
    /// [`Error::Close`] if it takes too long.
    pub async fn close(&self) -> Result<()> {
        session::close(&self.session).await
    }
}

/// A client's end of a session: publishes observations, receives what is said.
pub struct ClientPort {
    service: ServiceName,
    client: ClientName,
    incarnation: Incarnation,
    pub(super) observations: Publisher<'static>,
    heard: Publisher<'static>,
    messages: flume::Receiver<LiveMessage>,
    _token: LivelinessToken,
    _subscribers: [Subscriber<()>; 3],
    session: Session,
}

impl fmt::Debug for ClientPort {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ClientPort").field("client", &self.client).finish_non_exhaustive()
    }
}

impl ClientPort {
    fn open(
        session: &Session,
        service: &ServiceName,
        client: &ClientName,
        incarnation: Incarnation,
    ) -> Result<Self> {
        let (sender, messages) = flume::bounded(MAX_MESSAGES);
        let take = |wrap: fn(Vec<u8>) -> LiveMessage| {
            let sender = sender.clone();
            move |sample: zenoh::sample::Sample| {
                drop(sender.try_send(wrap(sample.payload().to_bytes().into_owned())));
            }
        };
        let key = LiveTopic::Say.key(service, client);
        let say = subscribe(session, key, take(LiveMessage::Say))?;
        let key = LiveTopic::Status.key(service, client);
        let status = subscribe(session, key, take(LiveMessage::Status))?;
        let presence = watch_service(session, service, sender)?;
        let token = appear(session, LiveKey::Client(service, client, incarnation))?;
        let key = LiveTopic::Observations.key(service, client);
        let observations = publisher(session, key, wire::SPEECH, Encoding::APPLICATION_JSON)?;
        let key = LiveTopic::Heard.key(service, client);
        let heard = publisher(session, key, wire::SPEECH, Encoding::APPLICATION_JSON)?;
        Ok(Self {
            service: service.clone(),
            client: client.clone(),
            incarnation,
            observations,
            heard,
            messages,
            _token: token,
            _subscribers: [say, status, presence],
            session: session.clone(),
        })
    }

    /// Returns this start of the client.
    pub fn incarnation(&self) -> Incarnation {
        self.incarnation
    }

    /// Asks for a session; the question and the answer are JSON.
    ///
    /// # Errors
    ///
    /// [`Error::Rejected`] with the notifier's sentence, or [`Error::NoAnswer`].
    pub async fn ask(&self, question: Vec<u8>) -> Result<Vec<u8>> {
        ask(&self.session, LiveKey::Open(&self.service, &self.client), question).await
    }

    /// Publishes an observation as JSON.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if the network has ended.
    pub fn observe(&self, json: &[u8]) -> Result<()> {
        let put = self.observations.put(json).wait();
        put.map_err(Error::network("publish on", self.observations.key_expr()))
    }

    /// Publishes a raw observation with its attachment.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if the network has ended.
    pub fn observe_raw(&self, numbers: &[u8], beside: &[u8]) -> Result<()> {
        let put = self.observations.put(numbers).attachment(beside).encoding(raw()).wait();
        put.map_err(Error::network("publish on", self.observations.key_expr()))
    }

    /// Publishes a report of what was heard, as JSON.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if the network has ended.
    pub fn report(&self, json: &[u8]) -> Result<()> {
        let put = self.heard.put(json).wait();
        put.map_err(Error::network("publish on", self.heard.key_expr()))
    }

    /// Waits for the next message; `None` once `timeout` is over.
    pub fn next(&self, timeout: Duration) -> Option<LiveMessage> {
        self.messages.recv_timeout(timeout).ok()
    }
}

/// Takes the starts of a notifier that are there, come and go.
pub(super) fn watch_service(
    session: &Session,
    service: &ServiceName,
    sender: flume::Sender<LiveMessage>,
) -> Result<Subscriber<()>> {
    watch_tokens(session, LiveKey::Starts(service), move |key, kind| {
        let Some(alive) = parse_alive(key) else { return };
        let message = match kind {
            SampleKind::Put => LiveMessage::ServiceHere(alive.incarnation),
            SampleKind::Delete => LiveMessage::ServiceGone(alive.incarnation),
        };
        drop(sender.try_send(message));
    })
}

/// Asks a notifier at a key; the question and the answer are JSON.
pub(super) async fn ask(session: &Session, key: LiveKey<'_>, question: Vec<u8>) -> Result<Vec<u8>> {
    let key = key.to_string();
    let (sender, answers) = flume::bounded(1);
    session
        .get(keys::expr(&key))
        .payload(question)
        .encoding(Encoding::APPLICATION_JSON)
        .priority(wire::CONTROL.priority)
        .target(QueryTarget::BestMatching)
        .consolidation(ConsolidationMode::None)
        .timeout(ANSWER_TIMEOUT)
        .callback(move |reply| drop(sender.try_send(reply)))
        .wait()
        .map_err(Error::network("ask", &key))?;
    let timeout = ANSWER_TIMEOUT;
    match tokio::time::timeout(timeout, answers.recv_async()).await {
        Ok(Ok(reply)) => match reply.into_result() {
            Ok(sample) => Ok(sample.payload().to_bytes().into_owned()),
            Err(error) => {
                let reason = error.payload().to_bytes();
                let reason = text::sentence(&String::from_utf8_lossy(&reason));
                Err(Error::Rejected { key, reason })
            }
        },
        _ => Err(Error::NoAnswer { key, timeout }),
    }
}

/// Waits until a notifier of this name is there, for the settings' time-out; returns its start. Every look is on the session that is
/// `current` then.
pub(super) async fn find(
    current: impl Fn() -> Session,
    settings: &ConnectSettings,
    service: &ServiceName,
) -> Result<Incarnation> {
    let (started, timeout) = (Instant::now(), settings.timeout);
    loop {
        let session = current();
        if let Some((_, start)) = present(&session, LiveKey::Starts(service)).await?.first() {
            return Ok(*start);
        }
        if started.elapsed() >= timeout {
            let present = present(&session, LiveKey::Services).await?;
            return Err(Error::NoService {
                service: service.clone(),
                endpoints: session::describe(&settings.endpoints),
                present: present.into_iter().map(|(name, _)| name).collect(),
            });
        }
        tokio::time::sleep(LOOK_PAUSE).await;
    }
}

/// Lists the notifiers that are there now: all, or those of one name, which any number of others does not hide.
pub(super) async fn present(
    session: &Session,
    keys: LiveKey<'_>,
) -> Result<Vec<(ServiceName, Incarnation)>> {
    let found =
        discovery::tokens(session, keys, "look for notifiers on", LOOK, MAX_SERVICES).await?;
    let alive = found.iter().filter_map(|key| parse_alive(key));
    Ok(alive.map(|alive| (alive.service, alive.incarnation)).collect())
}
