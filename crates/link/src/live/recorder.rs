//! The recorder's end: takes everything that is published about clients, and touches nothing.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

use leadtime_proto::{ClientName, ServiceName};
use zenoh::bytes::ZBytes;
use zenoh::pubsub::Subscriber;
use zenoh::session::Session;

use super::client::{LiveMessage, MAX_MESSAGES, ask, find, watch_service};
use super::keys::{LiveKey, LiveTopic, parse_topic};
use super::port::Arrival;
use crate::pubsub::subscribe;
use crate::redial::LastingSession;
use crate::{ConnectSettings, Error, Result, session};

/// The most messages that wait to be recorded; newer ones beyond them are dropped and counted.
const MAX_SAMPLES: usize = 65_536;
/// The most bytes of them that wait: some seconds of every client that a notifier can have, whatever they send.
const MAX_SAMPLE_BYTES: usize = 64 << 20;

/// A message about a client, as it was published.
#[derive(Debug)]
pub struct LiveSample {
    /// The client that the message is about.
    pub client: ClientName,
    /// What of the client it tells.
    pub topic: LiveTopic,
    /// Its form, its bytes, and when it arrived here.
    pub arrival: Arrival,
    _room: SampleRoom,
}

/// Room in the queue for a message, given back once the message is dropped.
#[derive(Debug)]
struct SampleRoom {
    queued: Arc<AtomicUsize>,
    n_bytes: usize,
}

impl SampleRoom {
    /// Takes room for so many bytes; `None` if there is not enough.
    fn take(queued: &Arc<AtomicUsize>, n_bytes: usize) -> Option<Self> {
        let before = queued.fetch_add(n_bytes, Ordering::Relaxed);
        let room = Self { queued: Arc::clone(queued), n_bytes };
        (before.saturating_add(n_bytes) <= MAX_SAMPLE_BYTES).then_some(room)
    }
}

impl Drop for SampleRoom {
    fn drop(&mut self) {
        self.queued.fetch_sub(self.n_bytes, Ordering::Relaxed);
    }
}

/// A recorder's place on the network.
#[derive(Debug)]
pub struct LiveRecorderLink {
    service: ServiceName,
    n_dropped: Arc<AtomicU64>,
    presence: flume::Receiver<LiveMessage>,
    session: Arc<LastingSession>,
}

impl LiveRecorderLink {
    /// Connects to a notifier or a router, waits until the notifier is there, and takes everything that is published from
    /// then on about one of its clients, or about all of them. A connection that has had nobody at its other end for ten seconds is
    /// replaced by another.
    ///
    /// # Errors
    ///
    /// [`Error::Unreachable`] if nobody answers within the settings' time-out; [`Error::NoService`].
    pub async fn open(
        settings: &ConnectSettings,
        service: &ServiceName,
        client: Option<&ClientName>,
    ) -> Result<(Self, flume::Receiver<LiveSample>)> {
        let settings = ConnectSettings { whom: "notifier", ..settings.clone() };
        let session = LastingSession::open(&settings).await?;
        find(|| session.now(), &settings, service).await?;
        let (sender, samples) = flume::bounded(MAX_SAMPLES);
        let (told, presence) = flume::bounded(MAX_MESSAGES);
        let n_dropped = Arc::new(AtomicU64::new(0));
        let (of, only, dropped) = (service.clone(), client.cloned(), Arc::clone(&n_dropped));
        session.subscribe(move |session| {
            let topics = take_topics(session, &of, only.as_ref(), &sender, &dropped);
            let mut subscribers = topics?;
            subscribers.push(watch_service(session, &of, told.clone())?);
            Ok(subscribers)
        })?;
        Ok((Self { service: service.clone(), n_dropped, presence, session }, samples))
    }

    /// Returns the channel that reports which starts of the notifier are present, appear and disappear.
    pub fn presence(&self) -> &flume::Receiver<LiveMessage> {
        &self.presence
    }

    /// Returns what asks for sessions: it can be used while messages are taken.
    pub fn asker(&self) -> SessionAsker {
        SessionAsker { service: self.service.clone(), session: Arc::clone(&self.session) }
    }

    /// Returns how many messages nobody had room for.
    pub fn n_dropped(&self) -> u64 {
        self.n_dropped.load(Ordering::Relaxed)
    }

    /// Checks that the connection is open. Call it regularly: no event reports that it has closed.
    ///
    /// # Errors
    ///
    /// [`Error::Dead`] if it is not.
    pub async fn health(&self) -> Result<()> {
        if session::is_dead(&self.session.now(), false).await { Err(Error::Dead) } else { Ok(()) }
    }

    /// Leaves the network, within a limited time.
    ///
    /// # Errors
    ///
    /// [`Error::Close`] if it takes too long.
    pub async fn close(&self) -> Result<()> {
        self.session.close().await
    }
}

/// Takes everything that is published about one client, or about all of them.
fn take_topics(
    session: &Session,
    service: &ServiceName,
    client: Option<&ClientName>,
    sender: &flume::Sender<LiveSample>,
    n_dropped: &Arc<AtomicU64>,
) -> Result<Vec<Subscriber<()>>> {
    let queued = Arc::new(AtomicUsize::new(0));
    let subscribed = LiveTopic::ALL.into_iter().map(|topic| {
        let (sender, n_dropped) = (sender.clone(), Arc::clone(n_dropped));
        let queued = Arc::clone(&queued);
        let key = match client {
            Some(client) => topic.key(service, client),
            None => LiveKey::Any(service, topic),
        };
        subscribe(session, key, move |sample| {
            let Some((client, topic)) = parse_topic(sample.key_expr()) else { return };
            let n_beside = sample.attachment().map_or(0, ZBytes::len);
            let room = SampleRoom::take(&queued, sample.payload().len() + n_beside);
            let is_queued = room.is_some_and(|room| {
                let arrival = Arrival::new(&sample);
                sender.try_send(LiveSample { client, topic, arrival, _room: room }).is_ok()
            });
            if !is_queued {
                n_dropped.fetch_add(1, Ordering::Relaxed);
            }
        })
    });
    subscribed.collect()
}

/// Asks a notifier what its sessions are.
#[derive(Clone, Debug)]
pub struct SessionAsker {
    service: ServiceName,
    session: Arc<LastingSession>,
}

impl SessionAsker {
    /// Asks what a client's session is; the answer is JSON.
    ///
    /// # Errors
    ///
    /// [`Error::NoAnswer`] if there is none.
    pub async fn ask(&self, client: &ClientName) -> Result<Vec<u8>> {
        ask(&self.session.now(), LiveKey::Session(&self.service, client), Vec::new()).await
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::LiveServiceLink;
    use crate::test_support::*;

    #[test]
    fn messages_that_wait_are_bounded_in_bytes() {
        let queued = Arc::new(AtomicUsize::new(0));
        let half = SampleRoom::take(&queued, MAX_SAMPLE_BYTES / 2).unwrap();
        let rest = SampleRoom::take(&queued, MAX_SAMPLE_BYTES / 2).unwrap();
        assert!(SampleRoom::take(&queued, 1).is_none());
        assert_eq!(queued.load(Ordering::Relaxed), MAX_SAMPLE_BYTES, "a refusal takes no room");
        drop(half);
        assert!(SampleRoom::take(&queued, 1).is_some());
        drop(rest);
        assert_eq!(queued.load(Ordering::Relaxed), 0);
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_recorder_whose_connection_leads_nowhere_goes_on_with_another() {
        let (site, elsewhere) = (Site::new(), Site::new());
        let service = ServiceName::new("n").unwrap();
        let opened = LiveServiceLink::open(&site.listen(), &service, LEARNER).await;
        let (_notifier, _events) = opened.unwrap();
        let opened = LiveRecorderLink::open(&site.connect(), &service, None).await;
        let (recorder, samples) = opened.unwrap();
        let here =
            |message: LiveMessage| (message == LiveMessage::ServiceHere(LEARNER)).then_some(());
        until(recorder.presence(), here).await;

        recorder.session.strand(elsewhere.raw("peer").await).await;
        recorder.session.look_long_after().await;
        until(recorder.presence(), here).await;
        recorder.health().await.unwrap();
        let (topic, client) = (LiveTopic::Say, ClientName::new("c").unwrap());
        let speaker = site.raw("client").await;
        speaker.put(topic.key(&service, &client).to_string(), "hello").await.unwrap();
        let said = until(&samples, |sample| (sample.topic == topic).then_some(sample.client));
        assert_eq!(said.await, client);
        recorder.close().await.unwrap();
        assert!(matches!(recorder.health().await.unwrap_err(), Error::Dead));
    }
}
