//! The learner's end: one run, its actors' messages as events, and what it tells them.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use leadtime_proto::header::{PROTOCOL_VERSION, Schema};
use leadtime_proto::message::{Control, ControlAck, Credit, Hello};
use leadtime_proto::receive::{CONTROL_ACK, HELLO};
use leadtime_proto::{
    ActorId, DomainName, Header, Incarnation, PolicyVersion, Refusal, RefusalCause, RunName,
};
use zenoh::Wait as _;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Publisher;
use zenoh::query::Query;
use zenoh::sample::{Sample, SampleKind};
use zenoh::session::Session;

use crate::ask::{Answer, Question, ask};
use crate::intake::{Intake, Payload, Place};
use crate::keys::{self, Key, Keys, Member};
use crate::queue::Class;
use crate::weights::{self, Owed, Shelf};
use crate::wire;
use crate::{Error, HelloResponder, ListenSettings, Result, session};

/// The parameter of an order that says for which start of the actor it is meant.
pub(crate) const INCARNATION: &str = "incarnation";
/// How long an order is repeated when nobody is there to take it.
const NOBODY_GRACE: Duration = Duration::from_secs(1);
/// Pause between such repetitions.
const NOBODY_PAUSE: Duration = Duration::from_millis(50);

/// Everything that can wake a learner from the network.
#[derive(Debug)]
pub enum LearnerEvent {
    /// An actor introduces itself; its presence ([`LearnerEvent::Joined`]) is usually told before.
    Hello {
        /// What it says.
        hello: Hello,
        /// Where to answer.
        reply: HelloResponder,
    },
    /// A rollout that passed [`leadtime_proto::receive::inspect`]; duplicate check, then
    /// [`leadtime_proto::receive::open`], are the consumer's.
    Rollout {
        /// The sender, by its key.
        actor: ActorId,
        /// The header.
        header: Header,
        /// The body, still encoded.
        payload: Payload,
    },
    /// An actor is there (may be told more than once).
    Joined {
        /// The actor.
        actor: ActorId,
        /// Its start.
        incarnation: Incarnation,
    },
    /// An actor is gone: it left, died, or the connection to it is lost.
    Left {
        /// The actor.
        actor: ActorId,
        /// Its start.
        incarnation: Incarnation,
    },
    /// A message was refused.
    Refused {
        /// The sender, by its key, if the key names one.
        actor: Option<ActorId>,
        /// The header, if it could be read.
        header: Option<Header>,
        /// Why; [`Refusal::cause`] is what to count.
        refusal: Refusal,
        /// The event's place in the queue, given back when dropped.
        place: Place,
    },
}

/// A learner's place on the network.
#[derive(Debug)]
pub struct LearnerLink {
    session: Session,
    run: RunName,
    incarnation: Incarnation,
    locators: Vec<String>,
    intake: Arc<Intake>,
    shelf: Arc<Shelf>,
    announcer: Arc<Publisher<'static>>,
    repeater: tokio::task::JoinHandle<()>,
    _alive: LivelinessToken,
}

impl LearnerLink {
    /// Opens a run at an address; from now on actors find it.
    ///
    /// # Errors
    ///
    /// [`Error::AddressInUse`], [`Error::Listen`], [`Error::NobodyThere`] (a router that is not there),
    /// [`Error::Name`] (a domain that cannot be part of a key) or [`Error::Network`].
    pub async fn open(
        run: &RunName,
        domain: &str,
        incarnation: Incarnation,
        settings: &ListenSettings,
    ) -> Result<(Self, flume::Receiver<LearnerEvent>)> {
        let domain = DomainName::new(domain)?;
        let session = session::listen(settings).await?;
        let locators = session.info().locators().await;
        let (intake, events) = Intake::new(settings);
        let (intake, shelf) = (Arc::new(intake), Arc::new(Shelf::new(incarnation)));
        let owed = weights::start_answering(&shelf)?;
        let announcer = Arc::new(declare_announcer(&session, Key::Announcement(run, &domain))?);
        declare_intake(&session, run, &domain, &intake)?;
        declare_pulls(&session, Key::Weights(run, &domain), owed.clone())?;
        declare_hello(&session, run, incarnation, (&intake, owed))?;
        // Last of all: whoever sees it may rely on everything else.
        let alive = Key::Alive(run, &Member::Learner, incarnation);
        let token = session.liveliness().declare_token(keys::expr(alive)).wait();
        let repeater = weights::repeat(Arc::clone(&announcer), Arc::clone(&shelf));
        let link = Self {
            _alive: token.map_err(Error::network("declare", &alive.to_string()))?,
            locators: locators.iter().map(ToString::to_string).collect(),
            repeater: tokio::spawn(repeater),
            run: run.clone(),
            session,
            incarnation,
            intake,
            shelf,
            announcer,
        };
        Ok((link, events))
    }

    /// Returns the addresses at which this learner can be reached, with the port that was taken.
    pub fn locators(&self) -> Vec<String> {
        self.locators.clone()
    }

    /// Offers a version of the weights: announced at once and every second, pulled by whoever wants it.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if it cannot be announced.
    pub fn offer_weights(&self, version: PolicyVersion, bytes: &[u8]) -> Result<()> {
        weights::announce(&self.announcer, &self.shelf.put(version, bytes))
    }

    /// Stops offering versions older than `oldest_kept`.
    pub fn retire_weights(&self, oldest_kept: PolicyVersion) {
        self.shelf.retire(oldest_kept);
    }

    /// Tells an actor its credit. May be lost; repeat it.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if it cannot be sent.
    pub fn send_credit(&self, actor: &ActorId, credit: Credit) -> Result<()> {
        let key = Key::Credit(&self.run, actor);
        let (header, payload) = wire::seal(Schema::Credit, self.incarnation, &credit)?;
        put(&self.session, key, wire::NOTICE, (&header, payload))
    }

    /// Gives one start of an actor an order and waits until it is taken.
    ///
    /// # Errors
    ///
    /// [`Error::NoAnswer`] if it is not taken in time (the actor may be gone), [`Error::Rejected`] if only another
    /// start of the actor is there.
    pub async fn control(
        &self,
        actor: &ActorId,
        incarnation: Incarnation,
        control: &Control,
        timeout: Duration,
    ) -> Result<ControlAck> {
        let key = Key::Control(&self.run, actor).to_string();
        let started = Instant::now();
        loop {
            let (header, payload) = wire::seal(Schema::Control, self.incarnation, control)?;
            let timeout_left = timeout.saturating_sub(started.elapsed());
            let question = Question {
                selector: format!("{key}?{INCARNATION}={}", incarnation.0),
                header,
                payload,
                lane: wire::CONTROL,
                timeout: timeout_left,
            };
            match ask(&self.session, question).await? {
                Answer::Reply(sample) => {
                    return wire::unseal(sample.attachment(), Some(sample.payload()), CONTROL_ACK)
                        .map(|(_, ack)| ack)
                        .map_err(|source| Error::BadAnswer { key, source });
                }
                Answer::Rejected(reason) => return Err(Error::Rejected { key, reason }),
                Answer::Nobody if started.elapsed() < timeout.min(NOBODY_GRACE) => {
                    tokio::time::sleep(NOBODY_PAUSE).await;
                }
                Answer::Nobody | Answer::TimedOut => return Err(Error::NoAnswer { key, timeout }),
            }
        }
    }

    /// Takes no more rollouts from this start of an actor; they are only counted.
    pub fn cut_off(&self, actor: &ActorId, incarnation: Incarnation) {
        self.intake.cut_off(actor, incarnation);
    }

    /// Publishes the learner's metrics, as JSON, for observers. May be lost.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if they cannot be sent.
    pub fn publish_metrics(&self, json: &[u8]) -> Result<()> {
        publish_metrics(&self.session, (&self.run, &Member::Learner), self.incarnation, json)
    }

    /// Returns how many messages this link refused, by cause.
    pub fn refusals(&self) -> BTreeMap<RefusalCause, u64> {
        self.intake.refusals()
    }

    /// Returns how many events did not fit into the queue.
    pub fn n_lost_events(&self) -> u64 {
        self.intake.n_lost()
    }

    /// Leaves the network, within a limited time.
    ///
    /// # Errors
    ///
    /// [`Error::Close`] if it takes too long.
    pub async fn close(&self) -> Result<()> {
        self.repeater.abort();
        session::close(&self.session).await
    }
}

impl Drop for LearnerLink {
    fn drop(&mut self) {
        self.repeater.abort();
    }
}

pub(crate) fn put(
    session: &Session,
    key: Key<'_>,
    lane: wire::Lane,
    (header, payload): (&Header, Vec<u8>),
) -> Result<()> {
    session
        .put(keys::expr(key), payload)
        .attachment(header.to_bytes())
        .priority(lane.priority)
        .congestion_control(lane.congestion)
        .express(lane.express)
        .wait()
        .map_err(Error::network("publish on", &key.to_string()))
}

pub(crate) fn publish_metrics(
    session: &Session,
    (run, member): (&RunName, &Member),
    incarnation: Incarnation,
    json: &[u8],
) -> Result<()> {
    let header = Header::plain(Schema::Metrics, incarnation, json);
    put(session, Key::Metrics(run, member), wire::METRICS, (&header, json.to_vec()))
}

fn declare_announcer(session: &Session, key: Key<'_>) -> Result<Publisher<'static>> {
    session
        .declare_publisher(keys::expr(key))
        .priority(wire::NOTICE.priority)
        .congestion_control(wire::NOTICE.congestion)
        .express(wire::NOTICE.express)
        .wait()
        .map_err(Error::network("declare", &key.to_string()))
}

fn declare_intake(
    session: &Session,
    run: &RunName,
    domain: &DomainName,
    intake: &Arc<Intake>,
) -> Result<()> {
    let (rollouts, actors) = (Keys::RolloutsOf(run, domain), Keys::ActorsOf(run));
    let taker = Arc::clone(intake);
    session
        .declare_subscriber(keys::expr(rollouts))
        .callback(move |sample| taker.rollout(&sample))
        .background()
        .wait()
        .map_err(Error::network("subscribe to", &rollouts.to_string()))?;
    let taker = Arc::clone(intake);
    session
        .liveliness()
        .declare_subscriber(keys::expr(actors))
        .history(true)
        .callback(move |sample| on_presence(&taker, &sample))
        .background()
        .wait()
        .map_err(Error::network("subscribe to", &actors.to_string()))
}

fn on_presence(intake: &Intake, sample: &Sample) {
    let Some(alive) = keys::parse_alive(sample.key_expr()) else {
        return intake.refuse(None, None, Refusal::Key);
    };
    let Member::Actor(actor) = alive.member else { return };
    let incarnation = alive.incarnation;
    let event = match sample.kind() {
        SampleKind::Put => LearnerEvent::Joined { actor, incarnation },
        SampleKind::Delete => LearnerEvent::Left { actor, incarnation },
    };
    if intake.offer(event, Class::Presence).is_some() {
        intake.count(RefusalCause::Overflow);
    }
}

fn declare_pulls(session: &Session, key: Key<'_>, owed: flume::Sender<Owed>) -> Result<()> {
    session
        .declare_queryable(keys::expr(key))
        .complete(true)
        .callback(move |query| {
            // A pull beyond what can be owed ends without an answer; the asker tries again.
            drop(owed.try_send(Owed::Weights(query)));
        })
        .background()
        .wait()
        .map_err(Error::network("declare", &key.to_string()))
}

fn declare_hello(
    session: &Session,
    run: &RunName,
    incarnation: Incarnation,
    (intake, owed): (&Arc<Intake>, flume::Sender<Owed>),
) -> Result<()> {
    let key = Key::Hello(run);
    let intake = Arc::clone(intake);
    session
        .declare_queryable(keys::expr(key))
        .complete(true)
        .callback(move |query| on_hello(&intake, &owed, incarnation, query))
        .background()
        .wait()
        .map_err(Error::network("declare", &key.to_string()))
}

fn on_hello(intake: &Intake, owed: &flume::Sender<Owed>, incarnation: Incarnation, query: Query) {
    let answer = match wire::unseal::<Hello>(query.attachment(), query.payload(), HELLO) {
        Err(refusal) => {
            let reason = match refusal {
                Refusal::Protocol { found } => format!(
                    "the actor speaks protocol {found}, the learner speaks {PROTOCOL_VERSION}: \
                     run the same release on both sides"
                ),
                ref other => other.to_string(),
            };
            intake.refuse(None, None, refusal);
            Owed::Refusal(query, reason)
        }
        Ok((_, hello)) => {
            let reply = HelloResponder::new(query, incarnation);
            match intake.offer(LearnerEvent::Hello { hello, reply }, Class::Request) {
                Some(LearnerEvent::Hello { reply, .. }) => {
                    intake.count(RefusalCause::Overflow);
                    Owed::Nothing(reply.into_query())
                }
                _ => return,
            }
        }
    };
    // Beyond what can be owed, the question ends without an answer; the asker tries again.
    drop(owed.try_send(answer));
}
