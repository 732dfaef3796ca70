//! The learner's end: one run, its actors' messages as events, and what it tells them.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, Weak};
use std::time::{Duration, Instant};

use leadtime_proto::header::Schema;
use leadtime_proto::message::{Announcement, Control, ControlReply, Credit, Hello};
use leadtime_proto::receive::{CONTROL_REPLY, HELLO};
use leadtime_proto::{
    ActorId, DomainName, Incarnation, PolicyVersion, RefusalCause, RunName, Sequence,
};
use tokio::time::{MissedTickBehavior, interval};
use tracing::{debug, warn};
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
use crate::lock::lock;
use crate::others::OtherLearners;
use crate::proof::{self, StartKey};
use crate::pubsub::{appear, publisher, put, put_metrics, subscribe, take_questions, watch};
use crate::queue::Class;
use crate::redial::{ClientSession, LOOK_EVERY};
use crate::weights::{self, WeightStore};
use crate::{Error, HelloResponder, ListenSettings, Result, discovery, session, wire};

/// How long an order is repeated when nobody is there to take it.
const NOBODY_GRACE: Duration = Duration::from_secs(1);
/// Pause between such repetitions.
const NOBODY_PAUSE: Duration = Duration::from_millis(50);
/// Threads that answer hellos and pulls: this many slow connections do not hold up the others.
const N_ANSWERING: usize = 4;

/// A learner's place on the network.
#[derive(Debug)]
pub struct LearnerLink {
    locators: Vec<String>,
    is_dead: Arc<AtomicBool>,
    n_orders: AtomicU64,
    upkeep: tokio::task::JoinHandle<()>,
    place: Arc<LearnerSite>,
}

/// What a learner takes and answers, and the session on which it does, whose place another one can take.
#[derive(Debug)]
struct LearnerSite {
    run: RunName,
    domain: DomainName,
    incarnation: Incarnation,
    intake: Arc<RolloutIntake>,
    store: Arc<WeightStore>,
    answers: Answers,
    /// For observers; `None` until there is something to tell.
    archive: Mutex<Option<Archive>>,
    others: Arc<Mutex<OtherLearners>>,
    /// `None` until the link is open.
    declared: Mutex<Option<LearnerDeclarations>>,
    /// Last, because fields are dropped in order: everything declared on the session is undeclared before it closes.
    session: ClientSession,
}

/// Everything that a learner has declared on a session.
#[derive(Debug)]
struct LearnerDeclarations {
    announcer: Publisher<'static>,
    _taken: [Subscriber<()>; 3],
    _answered: [Queryable<()>; 2],
    /// For observers; empty until there is something to tell.
    archive: Vec<Queryable<()>>,
    _alive: LivelinessToken,
}

impl LearnerLink {
    /// Opens a run at an address; from now on actors find it. If it only connects to a router, a connection that has had nobody at
    /// its other end for [`STRANDED`](crate::redial::STRANDED) is replaced by another from now on.
    ///
    /// # Errors
    ///
    /// [`Error::AddressInUse`], [`Error::NotOurAddress`], [`Error::NotASocket`], [`Error::Listen`],
    /// [`Error::Unreachable`] (a router that is not there), [`Error::AnotherLearner`] (with a certificate, behind a router: another
    /// learner of the run answers there), [`Error::Name`] (a domain that cannot be part of a key) or [`Error::Network`].
    pub async fn open(
        run: &RunName,
        domain: &str,
        start: &StartKey,
        settings: &ListenSettings,
    ) -> Result<(Self, flume::Receiver<LearnerEvent>)> {
        let (domain, incarnation) = (DomainName::new(domain)?, start.incarnation());
        let own = Keys::RolloutsOf(run, &domain);
        let session = ClientSession::of_learner(settings, own).await?;
        if let Err(error) = check_alone(&session.now(), run, settings).await {
            drop(session.close().await);
            return Err(error);
        }
        let locators = session.now().info().locators().await;
        let (intake, events) = RolloutIntake::new(settings, start.clone());
        let place = LearnerSite {
            run: run.clone(),
            domain,
            incarnation,
            intake: Arc::new(intake),
            store: Arc::new(WeightStore::new(start.clone())),
            answers: Answers::start(N_ANSWERING)?,
            archive: Mutex::default(),
            others: Arc::default(),
            declared: Mutex::default(),
            session,
        };
        let declared = place.declare(&place.session.now())?;
        *lock(&place.declared) = Some(declared);
        let (place, is_dead) = (Arc::new(place), Arc::new(AtomicBool::new(false)));
        let upkeep = upkeep(Arc::downgrade(&place), !locators.is_empty(), Arc::clone(&is_dead));
        let link = Self {
            locators: locators.iter().map(ToString::to_string).collect(),
            is_dead,
            n_orders: AtomicU64::new(0),
            upkeep: tokio::spawn(upkeep),
            place,
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
        self.place.store.put(version, weights);
        self.place.announce()
    }

    /// Stops offering versions older than `oldest_kept`; the last few stay for actors that have just received their announcement.
    pub fn retire_weights(&self, oldest_kept: PolicyVersion) {
        self.place.store.retire(oldest_kept);
    }

    /// Lists the versions on offer from `oldest` on.
    pub fn weights_since(&self, oldest: PolicyVersion) -> Vec<(PolicyVersion, Arc<[u8]>)> {
        self.place.store.since(oldest)
    }

    /// Returns the announcement of the weights that a welcome carries.
    pub fn announcement(&self) -> Announcement {
        self.place.store.announcement()
    }

    /// Tells an actor its credit. May be lost; repeat it. A start of it that was not made welcome, or is gone, is told none.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if it cannot be sent.
    pub fn send_credit(&self, actor: &ActorId, credit: Credit) -> Result<()> {
        let place = &self.place;
        let admitted = &place.intake.admitted;
        let Some(peer) = admitted.member_key(actor, credit.incarnation) else { return Ok(()) };
        let key = Key::Credit(&place.run, actor);
        let (header, payload) = wire::seal(Schema::Credit, &peer, Sequence(0), &credit)?;
        put(&place.session.now(), key, wire::CREDIT, &header, payload)
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
        let place = &self.place;
        let key = Key::Control(&place.run, actor).to_string();
        let Some(peer) = place.intake.admitted.member_key(actor, incarnation) else {
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
            match ask_for(&place.session.now(), question, read, |_| true).await? {
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
        self.place.intake.cut_off(actor, incarnation);
    }

    /// Answers observers who ask what the run is and how it went so far.
    ///
    /// # Errors
    ///
    /// [`Error::Thread`], or [`Error::Network`] if the questions' places cannot be declared.
    pub fn answer_observers(&mut self, archive: Archive) -> Result<()> {
        let place = &self.place;
        // Locked, so that no other session takes this one's place meanwhile.
        let mut declared = lock(&place.declared);
        let served = place.serve(&place.session.now(), archive.clone())?;
        *lock(&place.archive) = Some(archive);
        if let Some(declared) = declared.as_mut() {
            declared.archive = served.into();
        }
        Ok(())
    }

    /// Publishes the learner's metrics, as JSON, for observers. May be lost.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if they cannot be sent.
    pub fn publish_metrics(&self, json: &[u8]) -> Result<()> {
        let LearnerSite { run, incarnation, session, .. } = &*self.place;
        put_metrics(&session.now(), run, &Member::Learner, *incarnation, json)
    }

    /// Returns the refused messages since the last call that were no [`LearnerEvent::Refused`]: those for which there
    /// was no room, those of senders that were cut off, and events of presence that did not fit.
    ///
    /// They are no evidence against a sender: an honest one overflows when the learner is slow to read. The caller
    /// counts them in its books.
    pub fn take_uncounted(&self) -> RefusalCounts {
        self.place.intake.take_uncounted()
    }

    /// Returns the bytes of rollouts that wait in the event queue, by the name in their keys.
    pub fn queued_bytes(&self) -> BTreeMap<ActorId, usize> {
        self.place.intake.queued_bytes()
    }

    /// Returns how many bytes of messages were received and not looked at yet.
    pub fn n_queued_bytes(&self) -> usize {
        self.place.intake.n_queued_bytes()
    }

    /// Leaves the network, within a limited time.
    ///
    /// # Errors
    ///
    /// [`Error::Close`] if it takes too long.
    pub async fn close(&self) -> Result<()> {
        self.upkeep.abort();
        self.place.session.close().await
    }
}

impl Drop for LearnerLink {
    fn drop(&mut self) {
        self.upkeep.abort();
    }
}

impl LearnerSite {
    /// Declares on a session everything that a learner needs.
    fn declare(&self, session: &Session) -> Result<LearnerDeclarations> {
        let (run, domain) = (&self.run, &self.domain);
        let news = Key::Announcement(run, domain);
        let announcer = publisher(session, news, wire::NOTICE, Encoding::default())?;
        let taker = Arc::clone(&self.intake);
        let rollouts = subscribe(session, Keys::RolloutsOf(run, domain), move |sample| {
            taker.rollout(&sample);
        })?;
        let taker = Arc::clone(&self.intake);
        let actors = watch(session, Keys::ActorsOf(run), move |alive, kind| {
            on_presence(&taker, alive, kind);
        })?;
        lock(&self.others).forget();
        let (others, own) = (Arc::clone(&self.others), self.incarnation);
        let learners = watch(session, Keys::LearnerOf(run), move |alive, kind| {
            let Some(start) = alive.map(|alive| alive.incarnation) else { return };
            if start != own {
                let is_there = matches!(kind, SampleKind::Put);
                lock(&others).heard(start, is_there, Instant::now());
            }
        })?;
        let (answerer, offered) = (self.answers.clone(), Arc::clone(&self.store));
        let pulls = take_questions(session, Key::Weights(run, domain), move |mut query| {
            unload(&mut query);
            answerer.give(PendingReply::Weights(query, Arc::clone(&offered)));
        })?;
        let (taker, answerer) = (Arc::clone(&self.intake), self.answers.clone());
        let hellos = take_questions(session, Key::Hello(run), move |query| {
            on_hello(&taker, &answerer, query);
        })?;
        let archive = lock(&self.archive).clone();
        let archive = archive.map(|archive| self.serve(session, archive)).transpose()?;
        Ok(LearnerDeclarations {
            announcer,
            _taken: [rollouts, actors, learners],
            _answered: [pulls, hellos],
            archive: archive.into_iter().flatten().collect(),
            // Declared last: a peer that sees the token may rely on everything else.
            _alive: appear(session, Key::Alive(run, &Member::Learner, self.incarnation))?,
        })
    }

    /// Answers observers on a session.
    fn serve(&self, session: &Session, archive: Archive) -> Result<[Queryable<()>; 2]> {
        archive::serve(session, &self.run, self.incarnation, &self.answers, archive)
    }

    /// Tells everyone which weights there are.
    fn announce(&self) -> Result<()> {
        // Locked, so that no other session takes this one's place meanwhile: on a closed one it fails, which ends a run.
        let declared = lock(&self.declared);
        declared.as_ref().map_or(Ok(()), |it| weights::announce(&it.announcer, &self.store))
    }

    /// Replaces a connection to a router that leads nowhere, if one attempt opens another.
    async fn renew(&self) {
        self.session.renew(|session| self.take_over(session)).await;
    }

    /// Moves everything to another session; returns the one before it.
    fn take_over(&self, session: &Session) -> Result<Session> {
        let mut declared = lock(&self.declared);
        *declared = Some(self.declare(session)?);
        Ok(self.session.replace(session.clone()))
    }
}

/// Checks, where it can be known, that no other learner of this run is alive: its actors and ours would be turned away, or change
/// sides.
async fn check_alone(session: &Session, run: &RunName, settings: &ListenSettings) -> Result<()> {
    // Without certificates anybody can play a learner, and would keep ours from starting.
    if settings.identity.is_none() || settings.connect.is_empty() {
        return Ok(());
    }
    if discovery::is_led(session, run).await? {
        let endpoints = session::describe(&settings.connect);
        return Err(Error::AnotherLearner { run: run.clone(), endpoints });
    }
    Ok(())
}

/// Once a second, for as long as the link lives: checks the session, repeats the announcement, and reports other learners. Every few
/// seconds it replaces a connection that leads nowhere, here and not beside, where the old one would be found dead.
async fn upkeep(place: Weak<LearnerSite>, listens: bool, is_dead: Arc<AtomicBool>) {
    let mut ticks = interval(weights::REPEAT);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut looked_at = Instant::now();
    loop {
        ticks.tick().await;
        let Some(place) = place.upgrade() else { return };
        if looked_at.elapsed() >= LOOK_EVERY {
            looked_at = Instant::now();
            place.renew().await;
        }
        if session::is_dead(&place.session.now(), listens).await {
            is_dead.store(true, Ordering::Relaxed);
        }
        if !place.store.announcement().versions.is_empty()
            && let Err(error) = place.announce()
        {
            debug!(%error, "announcement could not be repeated");
        }
        if lock(&place.others).is_news(Instant::now()) {
            warn!(
                run = %place.run,
                "another learner of this run name is on the same network: actors may be turned away, or go to the other \
                 one; give one of the two another name (--name), or a router of its own"
            );
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

#[cfg(test)]
mod tests {
    use leadtime_proto::Epoch;

    use super::*;
    use crate::test_support::*;
    use crate::{ActorEvent, ObserverLink};

    #[tokio::test(flavor = "multi_thread")]
    async fn a_learner_whose_connection_leads_nowhere_goes_on_with_another_and_is_asked_as_before()
    {
        let (site, elsewhere) = (Site::new(), Site::new());
        let _router = site.raw("router").await;
        let settings = ListenSettings {
            connect: vec![site.endpoint.clone()],
            ..ListenSettings::new(Vec::new())
        };
        let start = learner_start();
        let opened = LearnerLink::open(&run("one"), DOMAIN, &start, &settings).await;
        let (mut learner, events) = opened.unwrap();
        let history =
            |_: u64, _: usize| -> Result<Vec<u8>, String> { Err("there is none".to_owned()) };
        let archive = Archive { about: b"{}".to_vec(), history: Arc::new(history) };
        learner.answer_observers(archive).unwrap();
        learner.offer_weights(PolicyVersion(1), b"kept".as_slice().into()).unwrap();
        let (actor, actor_events) = site.welcomed("a", &events).await;
        let is_told_of = async |comes: bool| {
            let told = until(&actor_events, |event| match event {
                ActorEvent::LearnerJoined(LEARNER) if comes => Some(()),
                ActorEvent::LearnerLeft(LEARNER) if !comes => Some(()),
                _ => None,
            });
            told.await;
        };
        is_told_of(true).await;

        let nowhere = elsewhere.raw("peer").await;
        learner.place.session.replace(nowhere).close().await.unwrap();
        is_told_of(false).await;
        learner.place.renew().await;
        assert!(!session::has_peer(&learner.place.session.now()).await, "not yet");
        learner.place.session.wait_long();
        learner.place.renew().await;
        is_told_of(true).await;

        say_hello(&actor, "a", &events).await;
        assert_eq!(pull(&actor, &learner, 1).await.unwrap(), b"kept");
        let (header, payload) = rollout("a", 1);
        actor.publish_rollout(&header, payload).unwrap();
        assert_eq!(next_rollout(&events).await.1, header);
        let (order, answer) = (Control::Wait, ControlReply::Followed { epoch: Epoch(0) });
        let (id, of) = (actor_id("a"), self::start("a").incarnation());
        let (answered, heard) =
            tokio::join!(learner.control(&id, of, &order, SOON), obey_next(&actor_events, &answer));
        assert_eq!((answered.unwrap(), heard), (answer, order));
        let (observer, _seen) = ObserverLink::open(&site.connect()).await.unwrap();
        assert_eq!(observer.ask_about(&run("one")).await.unwrap(), (LEARNER, b"{}".to_vec()));
        learner.health().unwrap();

        learner.close().await.unwrap();
        learner.place.session.wait_long();
        learner.place.renew().await;
        assert!(
            learner.place.session.now().is_closed(),
            "nothing takes the place of what was closed"
        );
    }
}
