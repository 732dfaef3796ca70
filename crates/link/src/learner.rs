//! The learner's end: one run, its actors' messages as events, and what it tells them.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use leadtime_proto::header::Schema;
use leadtime_proto::message::{Announcement, Control, ControlReply, Credit, Hello};
use leadtime_proto::receive::{CONTROL_REPLY, HELLO};
use leadtime_proto::{
    ActorId, DomainName, Incarnation, PolicyVersion, RefusalCause, RunName, Sequence,
};
use tokio::time::interval;
use tracing::debug;
use zenoh::bytes::Encoding;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::query::{Query, Queryable};
use zenoh::sample::{Sample, SampleKind};
use zenoh::session::Session;

use crate::answer::{Answers, PendingReply, Responder, unload};
use crate::archive::{self, Archive};
use crate::ask::{Inquiry, InquiryEnd, ask_for};
use crate::event::LearnerEvent;
use crate::intake::{RefusalCounts, RolloutIntake, malformed_key};
use crate::keys::{Alive, INCARNATION, Key, Keys, Member};
use crate::proof::{self, StartKey};
use crate::pubsub::{appear, publisher, put, put_metrics, subscribe, take_questions, watch};
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
    run: RunName,
    incarnation: Incarnation,
    locators: Vec<String>,
    intake: Arc<RolloutIntake>,
    store: Arc<WeightStore>,
    announcer: Arc<Publisher<'static>>,
    is_dead: Arc<AtomicBool>,
    n_orders: AtomicU64,
    upkeep: tokio::task::JoinHandle<()>,
    _taken: [Subscriber<()>; 2],
    _answered: [Queryable<()>; 2],
    answers: Answers,
    /// For observers; empty until there is something to tell.
    archive: Vec<Queryable<()>>,
    _alive: LivelinessToken,
    /// Last, because fields are dropped in order: everything declared on the session is undeclared before it closes.
    session: Session,
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
        start: &StartKey,
        settings: &ListenSettings,
    ) -> Result<(Self, flume::Receiver<LearnerEvent>)> {
        let (domain, incarnation) = (DomainName::new(domain)?, start.incarnation());
        let session = session::listen(settings).await?;
        let locators = session.info().locators().await;
        let (intake, events) = RolloutIntake::new(settings, start.clone());
        let (intake, store) = (Arc::new(intake), Arc::new(WeightStore::new(start.clone())));
        let answers = Answers::start(N_ANSWERING)?;
        let announcer = publisher(
            &session,
            Key::Announcement(run, &domain),
            wire::NOTICE,
            Encoding::default(),
        )?;
        let announcer = Arc::new(announcer);
        let taker = Arc::clone(&intake);
        let rollouts = subscribe(&session, Keys::RolloutsOf(run, &domain), move |sample| {
            taker.rollout(&sample);
        })?;
        let taker = Arc::clone(&intake);
        let actors = watch(&session, Keys::ActorsOf(run), move |alive, kind| {
            on_presence(&taker, alive, kind);
        })?;
        let (answerer, offered) = (answers.clone(), Arc::clone(&store));
        let pulls = take_questions(&session, Key::Weights(run, &domain), move |mut query| {
            unload(&mut query);
            answerer.give(PendingReply::Weights(query, Arc::clone(&offered)));
        })?;
        let taker = Arc::clone(&intake);
        let answerer = answers.clone();
        let hellos = take_questions(&session, Key::Hello(run), move |query| {
            on_hello(&taker, &answerer, query);
        })?;
        // Declared last: a peer that sees the token may rely on everything else.
        let alive = appear(&session, Key::Alive(run, &Member::Learner, incarnation))?;
        let is_dead = Arc::new(AtomicBool::new(false));
        let upkeep = upkeep(
            session.clone(),
            !locators.is_empty(),
            Arc::clone(&is_dead),
            Arc::clone(&announcer),
            Arc::clone(&store),
        );
        let link = Self {
            session,
            run: run.clone(),
            incarnation,
            locators: locators.iter().map(ToString::to_string).collect(),
            intake,
            store,
            announcer,
            is_dead,
            n_orders: AtomicU64::new(0),
            upkeep: tokio::spawn(upkeep),
            _taken: [rollouts, actors],
            _answered: [pulls, hellos],
            answers,
            archive: Vec::new(),
            _alive: alive,
        };
        Ok((link, events))
    }

    /// Returns the addresses at which this learner can be reached, with the port that was taken.
    pub fn locators(&self) -> Vec<String> {
        self.locators.clone()
    }

    /// Checks that actors can still reach this learner. Call it regularly: no event reports that they cannot.
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

    /// Stops offering versions older than `oldest_kept`; the last few stay for actors that have just received their announcement.
    pub fn retire_weights(&self, oldest_kept: PolicyVersion) {
        self.store.retire(oldest_kept);
    }

    /// Lists the versions on offer from `oldest` on.
    pub fn weights_since(&self, oldest: PolicyVersion) -> Vec<(PolicyVersion, Arc<[u8]>)> {
        self.store.since(oldest)
    }

    /// Returns the announcement of the weights that a welcome carries.
    pub fn announcement(&self) -> Announcement {
        self.store.announcement()
    }

    /// Tells an actor its credit. May be lost; repeat it. A start of it that was not made welcome, or is gone, is told none.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if it cannot be sent.
    pub fn send_credit(&self, actor: &ActorId, credit: Credit) -> Result<()> {
        let admitted = &self.intake.admitted;
        let Some(peer) = admitted.member_key(actor, credit.incarnation) else { return Ok(()) };
        let key = Key::Credit(&self.run, actor);
        let (header, payload) = wire::seal(Schema::Credit, &peer, Sequence(0), &credit)?;
        put(&self.session, key, wire::CREDIT, &header, payload)
    }

    /// Gives one start of an actor an order and waits for its answer.
    ///
    /// # Errors
    ///
    /// [`Error::NoAnswer`] if it is not taken in time (the actor may be gone, or was not made welcome),
    /// [`Error::Rejected`] if only another start of the actor is there.
    pub async fn control(
        &self,
        actor: &ActorId,
        incarnation: Incarnation,
        control: &Control,
        timeout: Duration,
    ) -> Result<ControlReply> {
        let key = Key::Control(&self.run, actor).to_string();
        let Some(peer) = self.intake.admitted.member_key(actor, incarnation) else {
            return Err(Error::NoAnswer { key, timeout });
        };
        let started = Instant::now();
        loop {
            // An answer to an earlier order, which somebody kept, is none to this one.
            let number = Sequence(self.n_orders.fetch_add(1, Ordering::Relaxed) + 1);
            let (header, payload) = wire::seal(Schema::Control, &peer, number, control)?;
            let question = Inquiry {
                key: key.clone(),
                parameters: format!("{INCARNATION}={incarnation}"),
                header,
                payload,
                qos: wire::CONTROL,
                timeout: timeout.saturating_sub(started.elapsed()),
            };
            let read = |sample: &Sample| {
                let (attachment, payload) = (sample.attachment(), Some(sample.payload()));
                wire::unseal_answer(attachment, payload, CONTROL_REPLY, &peer, number)
            };
            match ask_for(&self.session, question, read, |_| true).await? {
                InquiryEnd::Good(reply) => return Ok(reply),
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

    /// Answers observers who ask what the run is and how it went so far.
    ///
    /// # Errors
    ///
    /// [`Error::Thread`], or [`Error::Network`] if the questions' places cannot be declared.
    pub fn answer_observers(&mut self, archive: Archive) -> Result<()> {
        let (run, incarnation) = (&self.run, self.incarnation);
        let served = archive::serve(&self.session, run, incarnation, &self.answers, archive)?;
        self.archive = served.into();
        Ok(())
    }

    /// Publishes the learner's metrics, as JSON, for observers. May be lost.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if they cannot be sent.
    pub fn publish_metrics(&self, json: &[u8]) -> Result<()> {
        put_metrics(&self.session, &self.run, &Member::Learner, self.incarnation, json)
    }

    /// Returns the refused messages since the last call that were no [`LearnerEvent::Refused`]: those for which there
    /// was no room, those of senders that were cut off, and events of presence that did not fit.
    ///
    /// They are no evidence against a sender: an honest one overflows when the learner is slow to read. The caller
    /// counts them in its books.
    pub fn take_uncounted(&self) -> RefusalCounts {
        self.intake.take_uncounted()
    }

    /// Returns the bytes of rollouts that wait in the event queue, by the name in their keys.
    pub fn queued_bytes(&self) -> BTreeMap<ActorId, usize> {
        self.intake.queued_bytes()
    }

    /// Returns how many bytes of messages were received and not looked at yet.
    pub fn n_queued_bytes(&self) -> usize {
        self.intake.n_queued_bytes()
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

/// Checks the session and repeats the announcement, once a second, for as long as the link lives.
async fn upkeep(
    session: Session,
    listens: bool,
    is_dead: Arc<AtomicBool>,
    announcer: Arc<Publisher<'static>>,
    store: Arc<WeightStore>,
) {
    let mut ticks = interval(weights::REPEAT);
    loop {
        ticks.tick().await;
        if session::is_dead(&session, listens).await {
            is_dead.store(true, Ordering::Relaxed);
        }
        if !store.announcement().versions.is_empty()
            && let Err(error) = weights::announce(&announcer, &store)
        {
            debug!(%error, "announcement could not be repeated");
        }
    }
}

fn on_presence(intake: &RolloutIntake, alive: Option<Alive>, kind: SampleKind) {
    let Some(Alive { member, incarnation, .. }) = alive else {
        return intake.refuse(None, malformed_key());
    };
    let Member::Actor(actor) = member else { return };
    let event = match kind {
        SampleKind::Put => LearnerEvent::Joined(actor, incarnation),
        SampleKind::Delete => {
            intake.admitted.remove(&actor, incarnation);
            LearnerEvent::Left(actor, incarnation)
        }
    };
    if intake.events.offer(event, Class::Presence).is_some() {
        intake.count(None, RefusalCause::Overflow);
    }
}

fn on_hello(intake: &RolloutIntake, answers: &Answers, mut query: Query) {
    let (header, message) = (query.attachment(), query.payload());
    let hello = wire::unseal_hello::<Hello>(header, message, HELLO, &intake.keys);
    unload(&mut query);
    let checked = hello.and_then(|hello| {
        hello.message.check()?;
        let is_own = hello.message.incarnation == hello.key.peer;
        if is_own { Ok(hello) } else { Err(proof::refused()) }
    });
    match checked {
        Err(refusal) => {
            answers.give(PendingReply::Refusal(query, refusal.to_string()));
            intake.refuse(None, refusal);
        }
        Ok(proved) => {
            let reply = Responder::new(query, answers, Schema::HelloReply, &proved);
            let hello = proved.message;
            let reply = Box::new(HelloResponder::new(reply, &intake.admitted, &hello));
            if intake.events.offer(LearnerEvent::Hello { hello, reply }, Class::Request).is_some() {
                intake.count(None, RefusalCause::Overflow);
            }
        }
    }
}
