//! The learner's end: one run, its actors' messages as events, and what it tells them.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use leadtime_proto::header::Schema;
use leadtime_proto::message::{Announcement, Control, ControlReply, Credit, Hello};
use leadtime_proto::receive::{CONTROL_REPLY, HELLO};
use leadtime_proto::{ActorId, DomainName, Incarnation, PolicyVersion, RefusalCause, RunName};
use tokio::time::interval;
use tracing::debug;
use zenoh::Wait as _;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Publisher;
use zenoh::query::Query;
use zenoh::sample::{Sample, SampleKind};
use zenoh::session::Session;

use crate::answer::{Answers, PendingReply, unload};
use crate::ask::{Inquiry, InquiryEnd, ask};
use crate::event::LearnerEvent;
use crate::intake::{RefusalCounts, RolloutIntake, malformed_key};
use crate::keys::{self, INCARNATION, Key, Keys, Member};
use crate::publish::{self, put};
use crate::queue::Class;
use crate::weights::{self, WeightStore};
use crate::{Error, HelloResponder, ListenSettings, Result, session, wire};

/// How long an order is repeated when nobody is there to take it.
const NOBODY_GRACE: Duration = Duration::from_secs(1);
/// Pause between such repetitions.
const NOBODY_PAUSE: Duration = Duration::from_millis(50);
/// Threads that answer hellos and pulls: this many slow connections do not hold up the others.
const N_ANSWERING: usize = 4;

/// A learner's place on the network.
#[derive(Debug)]
pub struct LearnerLink {
    session: Session,
    run: RunName,
    incarnation: Incarnation,
    locators: Vec<String>,
    intake: Arc<RolloutIntake>,
    store: Arc<WeightStore>,
    announcer: Arc<Publisher<'static>>,
    is_dead: Arc<AtomicBool>,
    upkeep: tokio::task::JoinHandle<()>,
    _alive: LivelinessToken,
}

impl LearnerLink {
    /// Opens a run at an address; from now on actors find it.
    ///
    /// # Errors
    ///
    /// [`Error::AddressInUse`], [`Error::NotASocket`], [`Error::Listen`], [`Error::Unreachable`] (a router that is not
    /// there), [`Error::Name`] (a domain that cannot be part of a key) or [`Error::Network`].
    pub async fn open(
        run: &RunName,
        domain: &str,
        incarnation: Incarnation,
        settings: &ListenSettings,
    ) -> Result<(Self, flume::Receiver<LearnerEvent>)> {
        let domain = DomainName::new(domain)?;
        let session = session::listen(settings).await?;
        let locators = session.info().locators().await;
        let (intake, events) = RolloutIntake::new(settings);
        let (intake, store) = (Arc::new(intake), Arc::new(WeightStore::new(incarnation)));
        let answers = Answers::start(N_ANSWERING)?;
        let announcer = Arc::new(declare_announcer(&session, Key::Announcement(run, &domain))?);
        declare_intake(&session, run, &domain, &intake)?;
        declare_pulls(&session, Key::Weights(run, &domain), answers.clone(), &store)?;
        declare_hello(&session, run, incarnation, &intake, answers)?;
        // Declared last: a peer that sees the token may rely on everything else.
        let alive = Key::Alive(run, &Member::Learner, incarnation);
        let token = session.liveliness().declare_token(keys::expr(alive)).wait();
        let is_dead = Arc::new(AtomicBool::new(false));
        let upkeep = Upkeep {
            session: session.clone(),
            listens: !locators.is_empty(),
            is_dead: Arc::clone(&is_dead),
            announcer: Arc::clone(&announcer),
            store: Arc::clone(&store),
        };
        let link = Self {
            _alive: token.map_err(Error::network("declare", &alive.to_string()))?,
            locators: locators.iter().map(ToString::to_string).collect(),
            upkeep: tokio::spawn(upkeep.run()),
            run: run.clone(),
            session,
            incarnation,
            intake,
            store,
            announcer,
            is_dead,
        };
        Ok((link, events))
    }

    /// Returns the addresses at which this learner can be reached, with the port that was taken.
    pub fn locators(&self) -> Vec<String> {
        self.locators.clone()
    }

    /// Checks that this learner can still be reached; to be asked now and then, because no event tells it.
    ///
    /// # Errors
    ///
    /// [`Error::Dead`] if the connection, or what listens for actors, has ended.
    pub fn health(&self) -> Result<()> {
        if self.is_dead.load(Ordering::Relaxed) { Err(Error::Dead) } else { Ok(()) }
    }

    /// Offers a version of the weights: announced at once and every second, pulled by the actors that need it.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if it cannot be announced.
    pub fn offer_weights(&self, version: PolicyVersion, weights: Arc<[u8]>) -> Result<()> {
        self.store.put(version, weights);
        weights::announce(&self.announcer, &self.store)
    }

    /// Stops offering versions older than `oldest_kept`; the last few stay for actors that were told of one a moment ago.
    pub fn retire_weights(&self, oldest_kept: PolicyVersion) {
        self.store.retire(oldest_kept);
    }

    /// Lists the versions on offer from `oldest` on.
    pub fn weights_since(&self, oldest: PolicyVersion) -> Vec<(PolicyVersion, Arc<[u8]>)> {
        self.store.since(oldest)
    }

    /// Returns what a welcome tells of the weights.
    pub fn announcement(&self) -> Announcement {
        self.store.announcement()
    }

    /// Tells an actor its credit. May be lost; repeat it.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if it cannot be sent.
    pub fn send_credit(&self, actor: &ActorId, credit: Credit) -> Result<()> {
        let key = Key::Credit(&self.run, actor);
        let (header, payload) = wire::seal(Schema::Credit, self.incarnation, &credit)?;
        put(&self.session, key, wire::NOTICE, &header, payload)
    }

    /// Gives one start of an actor an order and waits for its answer.
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
    ) -> Result<ControlReply> {
        let key = Key::Control(&self.run, actor).to_string();
        let started = Instant::now();
        loop {
            let (header, payload) = wire::seal(Schema::Control, self.incarnation, control)?;
            let timeout_left = timeout.saturating_sub(started.elapsed());
            let question = Inquiry {
                selector: format!("{key}?{INCARNATION}={}", incarnation.0),
                header,
                payload,
                qos: wire::CONTROL,
                timeout: timeout_left,
            };
            let read = |sample: &Sample| {
                wire::unseal(sample.attachment(), Some(sample.payload()), CONTROL_REPLY)
                    .map(|(_, reply)| reply)
                    .map_err(|source| Error::BadAnswer { key: key.clone(), source })
            };
            match ask(&self.session, question, read).await? {
                InquiryEnd::Good(reply) => return Ok(reply),
                InquiryEnd::Unusable(error) => return Err(error),
                InquiryEnd::Rejected(reason) => return Err(Error::Rejected { key, reason }),
                InquiryEnd::Nobody if started.elapsed() < timeout.min(NOBODY_GRACE) => {
                    tokio::time::sleep(NOBODY_PAUSE).await;
                }
                InquiryEnd::Nobody | InquiryEnd::TimedOut => {
                    return Err(Error::NoAnswer { key, timeout });
                }
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
        publish::metrics(&self.session, &self.run, &Member::Learner, self.incarnation, json)
    }

    /// Returns the refused messages since the last call that were no [`LearnerEvent::Refused`]: those for which there
    /// was no room, those of senders that were cut off, and events of presence that did not fit.
    ///
    /// They are no evidence against a sender: an honest one overflows when the learner is slow to read. The caller
    /// counts them in its books.
    pub fn take_uncounted(&self) -> RefusalCounts {
        self.intake.take_uncounted()
    }

    /// Leaves the network, within a limited time.
    ///
    /// # Errors
    ///
    /// [`Error::Close`] if it takes too long.
    pub async fn close(&self) -> Result<()> {
        self.upkeep.abort();
        session::close(&self.session).await
    }
}

impl Drop for LearnerLink {
    fn drop(&mut self) {
        self.upkeep.abort();
    }
}

/// What has to be done once a second for as long as a learner is there.
struct Upkeep {
    session: Session,
    listens: bool,
    is_dead: Arc<AtomicBool>,
    announcer: Arc<Publisher<'static>>,
    store: Arc<WeightStore>,
}

impl Upkeep {
    async fn run(self) {
        let mut ticks = interval(weights::REPEAT);
        loop {
            ticks.tick().await;
            // The library tells nobody that its listener ended; it only stops listing its address.
            let is_deaf = self.listens && self.session.info().locators().await.is_empty();
            if is_deaf || self.session.is_closed() {
                self.is_dead.store(true, Ordering::Relaxed);
            }
            if self.store.announcement().versions.is_empty() {
                continue;
            }
            if let Err(error) = weights::announce(&self.announcer, &self.store) {
                debug!(%error, "announcement could not be repeated");
            }
        }
    }
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
    intake: &Arc<RolloutIntake>,
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

fn on_presence(intake: &RolloutIntake, sample: &Sample) {
    let Some(alive) = keys::parse_alive(sample.key_expr()) else {
        return intake.refuse(None, malformed_key());
    };
    let Member::Actor(actor) = alive.member else { return };
    let incarnation = alive.incarnation;
    let event = match sample.kind() {
        SampleKind::Put => LearnerEvent::Joined { actor, incarnation },
        SampleKind::Delete => LearnerEvent::Left { actor, incarnation },
    };
    if intake.offer(event, Class::Presence).is_some() {
        intake.count(None, RefusalCause::Overflow);
    }
}

fn declare_pulls(
    session: &Session,
    key: Key<'_>,
    answers: Answers,
    store: &Arc<WeightStore>,
) -> Result<()> {
    let store = Arc::clone(store);
    session
        .declare_queryable(keys::expr(key))
        .complete(true)
        .callback(move |mut query: Query| {
            unload(&mut query);
            answers.give(PendingReply::Weights(query, Arc::clone(&store)));
        })
        .background()
        .wait()
        .map_err(Error::network("declare", &key.to_string()))
}

fn declare_hello(
    session: &Session,
    run: &RunName,
    incarnation: Incarnation,
    intake: &Arc<RolloutIntake>,
    answers: Answers,
) -> Result<()> {
    let key = Key::Hello(run);
    let intake = Arc::clone(intake);
    session
        .declare_queryable(keys::expr(key))
        .complete(true)
        .callback(move |query| on_hello(&intake, &answers, incarnation, query))
        .background()
        .wait()
        .map_err(Error::network("declare", &key.to_string()))
}

fn on_hello(intake: &RolloutIntake, answers: &Answers, incarnation: Incarnation, mut query: Query) {
    let hello = wire::unseal::<Hello>(query.attachment(), query.payload(), HELLO);
    unload(&mut query);
    match hello.and_then(|(_, hello)| hello.check().map(|()| hello)) {
        Err(refusal) => {
            answers.give(PendingReply::Refusal(query, refusal.to_string()));
            intake.refuse(None, refusal);
        }
        Ok(hello) => {
            let reply = HelloResponder::new(query, answers.clone(), incarnation);
            if intake.offer(LearnerEvent::Hello { hello, reply }, Class::Request).is_some() {
                intake.count(None, RefusalCause::Overflow);
            }
        }
    }
}
