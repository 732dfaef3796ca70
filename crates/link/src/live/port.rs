//! A notifier's place for one client: its newest observation, what it heard, and where to speak.

use std::borrow::Cow;
use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;

use leadtime_proto::limits::MAX_LIVE_BYTES;
use leadtime_proto::{ClientName, ServiceName};
use zenoh::Wait as _;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::sample::Sample;
use zenoh::session::Session;

use super::keys::LiveTopic;
use super::robot::{RobotKeys, RobotPort};
use crate::lock::lock;
use crate::pubsub::{publisher, subscribe};
use crate::{Error, Result};

/// The most reports of what was heard that wait.
const MAX_HEARD: usize = 64;
/// The schema of raw observations.
const RAW: &str = "leadtime.obs/1";

/// How an observation is written, by what its sample says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ArrivalEncoding {
    /// JSON; also what says nothing.
    Json,
    /// Numbers as bytes: `application/octet-stream;leadtime.obs/1`.
    Binary,
    /// Something else, as it is called.
    Other(String),
    /// Anything of so many bytes, more than [`MAX_LIVE_BYTES`]: they are not kept.
    TooLong(usize),
}

/// An observation as it arrived.
#[derive(Debug)]
pub struct Arrival {
    /// When it arrived.
    pub at: Instant,
    encoding: Encoding,
    payload: ZBytes,
    attachment: Option<ZBytes>,
    /// How many bytes it had, where they were too many to keep.
    excess: Option<usize>,
}

impl Arrival {
    pub(super) fn new(sample: &Sample) -> Self {
        let at = Instant::now();
        let (payload, attachment) = (sample.payload().clone(), sample.attachment().cloned());
        Self { at, encoding: sample.encoding().clone(), payload, attachment, excess: None }
    }

    /// Keeps of a message that is too long only that it came, so that its sender can be told.
    fn within_limit(sample: &Sample) -> Self {
        let n_beside = sample.attachment().map_or(0, ZBytes::len);
        let n_bytes = sample.payload().len() + n_beside;
        if n_bytes <= MAX_LIVE_BYTES {
            return Self::new(sample);
        }
        let (at, encoding) = (Instant::now(), sample.encoding().clone());
        let (payload, attachment) = (ZBytes::new(), None);
        Self { at, encoding, payload, attachment, excess: Some(n_bytes) }
    }

    /// Returns what its sample says of its form.
    pub fn encoding(&self) -> ArrivalEncoding {
        let plain = [
            Encoding::APPLICATION_JSON,
            Encoding::TEXT_JSON,
            Encoding::ZENOH_BYTES,
            Encoding::ZENOH_STRING,
        ];
        if let Some(n_bytes) = self.excess {
            ArrivalEncoding::TooLong(n_bytes)
        } else if plain.contains(&self.encoding) {
            ArrivalEncoding::Json
        } else if self.encoding == raw() {
            ArrivalEncoding::Binary
        } else {
            ArrivalEncoding::Other(self.encoding.to_string())
        }
    }

    /// Returns the bytes that were published.
    pub fn payload(&self) -> Cow<'_, [u8]> {
        self.payload.to_bytes()
    }

    /// Returns the bytes beside them.
    pub fn attachment(&self) -> Option<Cow<'_, [u8]>> {
        self.attachment.as_ref().map(ZBytes::to_bytes)
    }
}

/// The encoding of raw observations.
pub(super) fn raw() -> Encoding {
    Encoding::APPLICATION_OCTET_STREAM.with_schema(RAW)
}

/// What arrived and was not taken yet.
#[derive(Debug, Default)]
struct Inbox {
    newest: Mutex<Option<Arrival>>,
    /// How many were replaced by a newer one and not counted yet.
    n_overwritten: AtomicU64,
}

/// A notifier's place for one client.
pub struct LivePort {
    inbox: Arc<Inbox>,
    heard: flume::Receiver<Vec<u8>>,
    say: Publisher<'static>,
    status: Publisher<'static>,
    taken: Publisher<'static>,
    /// Republishes for recorders what a robot observes on its own key, as if a client had sent it.
    observed: Option<Publisher<'static>>,
    robot: Option<RobotPort>,
    /// Dropped last: what arrives finds the rest of this.
    _subscribers: [Subscriber<()>; 2],
}

impl fmt::Debug for LivePort {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LivePort").finish_non_exhaustive()
    }
}

impl LivePort {
    /// Listens to a client; `wake` is called whenever something has arrived, on a thread that must not wait.
    pub(super) fn open(
        session: &Session,
        service: &ServiceName,
        client: &ClientName,
        say_raw: bool,
        robot: Option<&RobotKeys>,
        wake: Arc<dyn Fn() + Send + Sync>,
    ) -> Result<Self> {
        let inbox = Arc::new(Inbox::default());
        let (arrivals, woken) = (Arc::clone(&inbox), Arc::clone(&wake));
        let own = LiveTopic::Observations.key(service, client).to_string();
        let observations =
            subscribe(session, robot.map_or(&own, |robot| &robot.observations), move |sample| {
                let arrival = Arrival::within_limit(&sample);
                if lock(&arrivals.newest).replace(arrival).is_some() {
                    arrivals.n_overwritten.fetch_add(1, Ordering::Relaxed);
                }
                woken();
            })?;
        let (sender, heard) = flume::bounded(MAX_HEARD);
        let key = LiveTopic::Heard.key(service, client);
        let hearing = subscribe(session, key, move |sample| {
            let bytes = sample.payload().to_bytes();
            // A report without room in the queue counts as lost: then the clock of words decides.
            if bytes.len() <= MAX_LIVE_BYTES && sender.try_send(bytes.into_owned()).is_ok() {
                wake();
            }
        })?;
        let qos = crate::wire::SPEECH;
        let form =
            if say_raw { Encoding::APPLICATION_OCTET_STREAM } else { Encoding::APPLICATION_JSON };
        let say = publisher(session, LiveTopic::Say.key(service, client), qos, form)?;
        let key = LiveTopic::Status.key(service, client);
        let status = publisher(session, key, crate::wire::NOTICE, Encoding::APPLICATION_JSON)?;
        // With the same priority as what is said, so that it arrives after what it reports.
        let key = LiveTopic::Taken.key(service, client);
        let taken = publisher(session, key, qos, Encoding::APPLICATION_JSON)?;
        let declare = || publisher(session, own, qos, Encoding::APPLICATION_JSON);
        let observed = robot.map(|_| declare()).transpose()?;
        let robot = robot.map(|keys| RobotPort::open(session, keys)).transpose()?;
        let subscribers = [observations, hearing];
        Ok(Self { inbox, heard, say, status, taken, observed, robot, _subscribers: subscribers })
    }

    /// Takes the newest observation, if one has arrived since the last time.
    pub fn take(&self) -> Option<Arrival> {
        lock(&self.inbox.newest).take()
    }

    /// Takes the next report of what was heard.
    pub fn take_heard(&self) -> Option<Vec<u8>> {
        self.heard.try_recv().ok()
    }

    /// Returns how many observations were replaced by a newer one since the last time, and so never taken.
    pub fn take_overwritten(&self) -> u64 {
        self.inbox.n_overwritten.swap(0, Ordering::Relaxed)
    }

    /// Publishes an event of what is said.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if the network has ended.
    pub fn say(&self, bytes: &[u8]) -> Result<()> {
        self.say.put(bytes).wait().map_err(Error::network("publish on", self.say.key_expr()))
    }

    /// Puts a status.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if the network has ended.
    pub fn status(&self, bytes: &[u8]) -> Result<()> {
        self.status.put(bytes).wait().map_err(Error::network("publish on", self.status.key_expr()))
    }

    /// Publishes what was taken in, for recorders.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if the network has ended.
    pub fn taken(&self, bytes: &[u8]) -> Result<()> {
        self.taken.put(bytes).wait().map_err(Error::network("publish on", self.taken.key_expr()))
    }

    /// Republishes an observation from a robot's own key on the key of a client's observations, for recorders.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if the network has ended.
    pub fn observed(&self, bytes: &[u8]) -> Result<()> {
        let Some(observed) = &self.observed else { return Ok(()) };
        observed.put(bytes).wait().map_err(Error::network("publish on", observed.key_expr()))
    }

    /// Puts an event ([`LiveTopic::Say`]) or a status on the robot's own key for it, if it has one, with bytes beside it.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if the network has ended.
    pub fn put_to_robot(
        &self,
        topic: LiveTopic,
        bytes: &[u8],
        beside: Option<&[u8]>,
    ) -> Result<()> {
        self.robot.as_ref().map_or(Ok(()), |robot| robot.put(topic, bytes, beside))
    }
}
