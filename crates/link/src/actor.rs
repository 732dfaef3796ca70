//! An actor's end: finding a run, saying hello, taking orders, sending rollouts, pulling weights.
//!
//! ```text
//! open ── connected ── hello ──┬─ find the run by its learner's presence
//!                              ├─ declare presence, orders and credit (so that nothing is missed)
//!                              ├─ ask; wait for the welcome
//!                              └─ declare rollouts and announcements of the run's domain
//! LearnerLeft … LearnerJoined ── hello again, on the same link
//! alone for long ── another connection, and the same from the hello on
//! ```

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use bytes::Bytes;
use leadtime_proto::header::Schema;
use leadtime_proto::limits::MAX_ROLLOUT_BYTES;
use leadtime_proto::message::{Control, Credit, Hello, HelloReply, Welcome};
use leadtime_proto::receive::{CONTROL, CREDIT, HELLO_REPLY};
use leadtime_proto::{
    ActorId, DomainName, Header, PolicyVersion, Refusal, RefusalCause, RegionName, RunName,
    Sequence,
};
use tracing::{debug, info, warn};
use zenoh::Wait as _;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::query::{Query, Queryable};
use zenoh::sample::{Sample, SampleKind};
use zenoh::session::Session;

use crate::answer::{Answers, PendingReply, unload};
use crate::ask::{self, Inquiry, InquiryEnd, ask_for};
use crate::discovery::{self, MAX_PAUSE, MIN_PAUSE};
use crate::error::RUN_IS_ENDING;
use crate::event::ActorEvent;
use crate::keys::{INCARNATION, Key, Keys, Member};
use crate::latest::{Events, Latest};
use crate::lock::lock;
use crate::proof::{self, Keyring, PeerKey, StartKey};
use crate::pubsub::{self, appear, subscribe, take_questions, watch};
use crate::queue::{Class, EventQueue};
use crate::redial::ClientSession;
use crate::told::ToldRefusals;
use crate::wire::ProvedMessage;
use crate::{ConnectSettings, ControlResponder, Error, Result, weights, wire};

/// Threads that answer orders; there is one learner to answer.
const N_ANSWERING: usize = 1;
/// How long to wait for an earlier start of this actor to disappear.
const TAKEN_GRACE: Duration = Duration::from_secs(2);
/// How long hellos that reach nobody are repeated before an access list is blamed: longer than a dead learner stays visible.
const HELLO_GRACE: Duration = Duration::from_secs(5);
/// A search for the run that takes longer than this, and one look is shorter, missed it at first.
const AWAY: Duration = Duration::from_secs(2);
/// How long to wait for the answer to one hello: a question may be lost while a connection is being set up.
const HELLO_WAIT: Duration = Duration::from_secs(10);
/// How long a relay may take to answer; after that the learner is asked. It has to pull the weights itself, over a line that may be
/// slow: given up before its own pull is over, every actor of the region would pull them over that line.
const RELAY_TIMEOUT: Duration = ask::PULL_TIMEOUT.saturating_add(Duration::from_secs(1));
/// A relay that has no weights after this long is left alone like one that does not answer.
const RELAY_PATIENCE: Duration = Duration::from_secs(5);
/// How long a relay that did not answer is left alone.
const RELAY_PAUSE: Duration = Duration::from_secs(30);

/// What an actor holds in a run before it is welcome.
#[derive(Debug)]
struct Joined {
    run: RunName,
    _orders: Queryable<()>,
    _credit: Subscriber<()>,
    _learner: Subscriber<()>,
    _alive: LivelinessToken,
}

/// What it holds once it is.
#[derive(Debug)]
struct Membership {
    run: RunName,
    domain: DomainName,
    rollouts: Publisher<'static>,
    _announcements: Subscriber<()>,
}

/// The relay that is asked for weights before the learner.
#[derive(Debug)]
struct RelayOfRegion {
    region: RegionName,
    /// When it may be asked again, if it did not answer.
    rests_until: Mutex<Option<Instant>>,
}

/// An actor's place on the network.
#[derive(Debug)]
pub struct ActorLink {
    settings: ConnectSettings,
    relay: Option<RelayOfRegion>,
    actor: ActorId,
    keys: Arc<Keyring>,
    /// Counts hellos, so that a copy of one is known.
    n_hellos: AtomicU64,
    /// What is shared with the learner that welcomed this actor last.
    learner: Arc<Mutex<Option<Arc<PeerKey>>>>,
    events: EventQueue<ActorEvent>,
    presence: EventQueue<ActorEvent>,
    latest: Arc<Latest<ActorEvent>>,
    answers: Answers,
    told: Arc<ToldRefusals>,
    joined: Mutex<Option<Joined>>,
    entered: Mutex<Option<Arc<Membership>>>,
    /// Last, because fields are dropped in order: everything declared on the session is undeclared before it closes.
    session: ClientSession,
}

impl ActorLink {
    /// Connects to a learner or a router; no run is touched yet.
    ///
    /// # Errors
    ///
    /// [`Error::Unreachable`] if nobody answers within the settings' time-out.
    pub async fn open(
        settings: &ConnectSettings,
        actor: &ActorId,
        start: &StartKey,
    ) -> Result<(Self, Events<ActorEvent>)> {
        let session = ClientSession::open(settings).await?;
        let (events, latest, mut receiver) = Events::new(0);
        let link = Self {
            session,
            settings: settings.clone(),
            relay: settings
                .region
                .clone()
                .map(|region| RelayOfRegion { region, rests_until: Mutex::default() }),
            actor: actor.clone(),
            keys: Arc::new(Keyring::new(start.clone())),
            n_hellos: AtomicU64::new(0),
            learner: Arc::default(),
            events,
            presence: receiver.part_presence(),
            latest,
            answers: Answers::start(N_ANSWERING)?,
            told: Arc::default(),
            joined: Mutex::default(),
            entered: Mutex::default(),
        };
        Ok((link, receiver))
    }

    /// Says hello to a run, named or the only one there, and enters it when welcome.
    ///
    /// To be said again after every [`ActorEvent::LearnerJoined`] that follows a loss. A connection that has had
    /// nobody at its other end for [`STRANDED`](crate::redial::STRANDED) is replaced by another first.
    ///
    /// # Errors
    ///
    /// * [`Error::NoLearner`] if no learner appears in time.
    /// * [`Error::SeveralRuns`] if none was named and several are there.
    /// * [`Error::RunNotFound`] if only others than the named one are there.
    /// * [`Error::Refused`] if the learner does not want this actor, for instance for its protocol version.
    /// * [`Error::Rejected`] if somebody says so who proves nothing, and this actor has been welcome before.
    /// * [`Error::Ending`] if the run has dismissed its actors.
    /// * [`Error::Taken`] if another start of an actor of this name is there.
    /// * [`Error::NoAnswer`] if a learner is there but does not answer in time.
    /// * [`Error::NotAllowed`] or [`Error::Unlisted`] if an access list seems to be in the way.
    pub async fn hello(
        &self,
        run: Option<&RunName>,
        hello: &Hello,
        timeout: Duration,
    ) -> Result<Welcome> {
        let started = Instant::now();
        let mut unheard = None;
        loop {
            self.renew().await;
            let looked = Instant::now();
            let run = self.find(run, started, timeout).await?;
            if looked.elapsed() > AWAY {
                // The learner was gone meanwhile, so it is no access list that was in the way before.
                unheard = None;
            }
            self.join(&run)?;
            let key = Key::Hello(&run).to_string();
            let number = Sequence(self.n_hellos.fetch_add(1, Ordering::Relaxed) + 1);
            let (header, payload) = wire::sign(Schema::Hello, &self.keys.own, number, hello)?;
            let question = Inquiry {
                key: key.clone(),
                parameters: String::new(),
                header,
                payload,
                qos: wire::CONTROL,
                timeout: timeout.saturating_sub(started.elapsed()).min(HELLO_WAIT),
            };
            let before = lock(&self.learner).as_ref().map(|learner| learner.peer);
            // Anybody may answer, and be faster. The learner that this actor works for has the first word.
            let is_best = |(learner, _): &(Arc<PeerKey>, HelloReply)| {
                before.is_none_or(|before| before == learner.peer)
            };
            let read = |sample: &Sample| read_answer(&self.keys, number, sample);
            match ask_for(&self.session(), question, read, is_best).await? {
                // The presence of a killed actor lasts a moment longer than the actor.
                InquiryEnd::Good((_, HelloReply::Taken))
                    if started.elapsed() < timeout.min(TAKEN_GRACE) =>
                {
                    unheard = None;
                    tokio::time::sleep(MAX_PAUSE).await;
                }
                InquiryEnd::Good((learner, reply)) => return self.answered(run, learner, reply),
                // It proves nothing, so it ends nobody who has a learner that may come back.
                InquiryEnd::Rejected(reason) if before.is_some() => {
                    return Err(Error::Rejected { key, reason });
                }
                InquiryEnd::Rejected(reason) => {
                    return Err(Error::Refused { run, actor: self.actor.clone(), reason });
                }
                // A refused question ends at once with nothing, and the learner is there.
                InquiryEnd::Nobody
                    if self.name().is_some()
                        && unheard.get_or_insert_with(Instant::now).elapsed() > HELLO_GRACE =>
                {
                    return Err(Error::NotAllowed { run, actor: self.actor.clone() });
                }
                InquiryEnd::Nobody | InquiryEnd::TimedOut if started.elapsed() < timeout => {
                    debug!(%run, "the learner did not answer the hello, trying again");
                    tokio::time::sleep(MIN_PAUSE).await;
                }
                InquiryEnd::Nobody | InquiryEnd::TimedOut => {
                    return Err(Error::NoAnswer { key, timeout });
                }
            }
        }
    }

    /// Pulls a version of the weights, from the region's relay or from the learner: the bytes that have the digest which the
    /// learner announced.
    ///
    /// # Errors
    ///
    /// [`Error::NotKept`] if the version is not kept (any more), [`Error::NoAnswer`] if the learner is gone,
    /// [`Error::ForeignWeights`] or [`Error::BadAnswer`] if nothing that arrives is what was announced.
    pub async fn pull_weights(&self, version: PolicyVersion, sha256: [u8; 32]) -> Result<Vec<u8>> {
        let entered = self.entered()?;
        let (run, domain) = (&entered.run, &entered.domain);
        if let Some(relay) = &self.relay
            && let Some(weights) = self.pull_relayed(relay, &entered, version, sha256).await
        {
            return Ok(weights);
        }
        let key = Key::Weights(run, domain);
        ask::pull(&self.session(), key, version, sha256, ask::PULL_TIMEOUT).await
    }

    /// Pulls from a relay; `None` if the learner has to be asked.
    async fn pull_relayed(
        &self,
        relay: &RelayOfRegion,
        entered: &Membership,
        version: PolicyVersion,
        sha256: [u8; 32],
    ) -> Option<Vec<u8>> {
        let RelayOfRegion { region, rests_until } = relay;
        if lock(rests_until).is_some_and(|until| Instant::now() < until) {
            return None;
        }
        let key = Key::RelayedWeights(&entered.run, region, &entered.domain);
        let (session, asked) = (self.session(), Instant::now());
        let pull = ask::pull(&session, key, version, sha256, RELAY_TIMEOUT);
        let error = match pull.await {
            Ok(weights) => {
                if lock(rests_until).take().is_some() {
                    info!(%region, "weights come from the region's relay again");
                }
                return Some(weights);
            }
            Err(error) => error,
        };
        // A relay that cannot reach the learner says so, late: its own pull has its time as well.
        if matches!(error, Error::NoAnswer { .. }) || asked.elapsed() >= RELAY_PATIENCE {
            if lock(rests_until).replace(Instant::now() + RELAY_PAUSE).is_none() {
                warn!(
                    "no relay of region `{region}` answers in time, so weights come from the learner itself; \
                     `leadtime router --region {region}` is one"
                );
            }
        } else {
            debug!(%error, "the relay has no weights; asking the learner");
        }
        None
    }

    /// Publishes a rollout. It blocks while the network is busy: call it from a thread of its own, never from a task.
    ///
    /// Header and payload travel as they are, with a proof for the learner; checking them is the learner's.
    ///
    /// # Errors
    ///
    /// [`Error::TooLarge`] if the network would drop it silently for its size; [`Error::NotInARun`] before a welcome;
    /// [`Error::Network`].
    pub fn publish_rollout(&self, header: &Header, payload: Bytes) -> Result<()> {
        let entered = self.entered()?;
        let learner = lock(&self.learner).clone();
        let learner = learner.ok_or_else(|| Error::NotInARun(self.actor.clone()))?;
        let key = entered.rollouts.key_expr().as_str();
        if payload.len() > 2 * MAX_ROLLOUT_BYTES {
            let (found, limit) = (payload.len(), MAX_ROLLOUT_BYTES);
            return Err(Error::TooLarge { key: key.to_owned(), found, limit });
        }
        let proof = learner.prove(header, &payload);
        // Two pieces: the rollout is not copied to stand in front of its proof.
        let mut whole = ZBytes::writer();
        whole.append(ZBytes::from(payload));
        whole.append(ZBytes::from(proof.as_slice()));
        let put = entered.rollouts.put(whole.finish()).attachment(header.to_bytes());
        put.wait().map_err(Error::network("publish on", key))
    }

    /// Publishes the actor's metrics, as JSON, for observers. May be lost.
    ///
    /// # Errors
    ///
    /// [`Error::NotInARun`] or [`Error::Network`].
    pub fn publish_metrics(&self, json: &[u8]) -> Result<()> {
        let entered = self.entered()?;
        let member = Member::Actor(self.actor.clone());
        let start = self.keys.own.incarnation();
        pubsub::put_metrics(&self.session(), &entered.run, &member, start, json)
    }

    /// Checks that the connection is open. Call it regularly: no event reports that it has closed.
    ///
    /// # Errors
    ///
    /// [`Error::Dead`] if it has.
    pub fn health(&self) -> Result<()> {
        if self.session().is_closed() { Err(Error::Dead) } else { Ok(()) }
    }

    /// Leaves the network, within a limited time. Rollouts that are not acknowledged may be lost.
    ///
    /// # Errors
    ///
    /// [`Error::Close`] if it takes too long.
    pub async fn close(&self) -> Result<()> {
        self.session.close().await
    }

    fn session(&self) -> Session {
        self.session.now()
    }

    /// Returns the name in our certificate, if we have one.
    fn name(&self) -> Option<&String> {
        self.settings.identity.as_ref()?.shown.name.as_ref()
    }

    /// Replaces a connection that leads nowhere.
    async fn renew(&self) {
        let take_over = |session: &Session| {
            // What was declared on the old session ends with it.
            *lock(&self.joined) = None;
            *lock(&self.entered) = None;
            Ok(self.session.replace(session.clone()))
        };
        self.session.renew(take_over).await;
    }

    fn entered(&self) -> Result<Arc<Membership>> {
        lock(&self.entered).clone().ok_or_else(|| Error::NotInARun(self.actor.clone()))
    }

    /// Finds the run to say hello to.
    async fn find(
        &self,
        wanted: Option<&RunName>,
        started: Instant,
        timeout: Duration,
    ) -> Result<RunName> {
        let settings = ConnectSettings { timeout, ..self.settings.clone() };
        let found = discovery::find(|| self.session(), &settings, wanted, started).await;
        found.map_err(|error| match (error, self.name().cloned()) {
            (Error::NoLearner { endpoints, timeout }, Some(name)) => {
                Error::Unlisted { endpoints, name, timeout }
            }
            (error, _) => error,
        })
    }

    /// Declares presence, orders and credit, before the hello: what follows it cannot be missed.
    fn join(&self, run: &RunName) -> Result<()> {
        let mut joined = lock(&self.joined);
        if joined.as_ref().is_some_and(|joined| joined.run == *run) {
            return Ok(());
        }
        // Leave another run before, so that its learner does not count on this actor.
        *joined = None;
        *lock(&self.entered) = None;
        let (session, incarnation) = (&self.session(), self.keys.own.incarnation());
        let (events, answers) = (self.events.clone(), self.answers.clone());
        let (keys, told) = (Arc::clone(&self.keys), Arc::clone(&self.told));
        let orders = take_questions(session, Key::Control(run, &self.actor), move |query| {
            on_order(&events, &answers, &keys, &told, query);
        })?;
        let (latest, keys) = (Arc::clone(&self.latest), Arc::clone(&self.keys));
        let (ours, told) = (Arc::clone(&self.learner), Arc::clone(&self.told));
        let credit = subscribe(session, Key::Credit(run, &self.actor), move |sample| {
            if is_of_another(&ours, &sample) {
                return;
            }
            let (attachment, payload) = (sample.attachment(), Some(sample.payload()));
            match wire::unseal::<Credit>(attachment, payload, CREDIT, &keys) {
                Ok(ProvedMessage { key: learner, message: credit, .. })
                    if credit.incarnation == incarnation && credit.learner == learner.peer =>
                {
                    latest.put(&format!("credit/{}", credit.learner), ActorEvent::Credit(credit));
                }
                Ok(_) => debug!("credit of another learner, or for another start of this actor"),
                // What is for an earlier start of this actor cannot be checked by this one.
                Err(refusal) if refusal.cause == RefusalCause::Proof => {
                    debug!(%refusal, "credit refused");
                }
                Err(refusal) => told.tell("credit", &refusal),
            }
        })?;
        let presence = self.presence.clone();
        let learner = watch(session, Keys::LearnerOf(run), move |alive, kind| {
            let Some(alive) = alive else { return };
            let event = match kind {
                SampleKind::Put => ActorEvent::LearnerJoined(alive.incarnation),
                SampleKind::Delete => ActorEvent::LearnerLeft(alive.incarnation),
            };
            drop(presence.offer(event, Class::Presence));
        })?;
        let member = Member::Actor(self.actor.clone());
        *joined = Some(Joined {
            run: run.clone(),
            _orders: orders,
            _credit: credit,
            _learner: learner,
            _alive: appear(session, Key::Alive(run, &member, incarnation))?,
        });
        Ok(())
    }

    fn answered(&self, run: RunName, learner: Arc<PeerKey>, reply: HelloReply) -> Result<Welcome> {
        match reply {
            HelloReply::Refused { reason } if reason == RUN_IS_ENDING => Err(Error::Ending { run }),
            HelloReply::Refused { reason } => {
                let reason = leadtime_proto::text::sentence(&reason);
                Err(Error::Refused { run, actor: self.actor.clone(), reason })
            }
            HelloReply::Taken => Err(Error::Taken(self.actor.clone())),
            HelloReply::Welcome(welcome) => {
                if welcome.weights.learner != learner.peer {
                    let (key, source) = (Key::Hello(&run).to_string(), proof::refused());
                    return Err(Error::BadAnswer { key, source });
                }
                let domain = DomainName::new(welcome.spec.task.domain.clone())?;
                *lock(&self.learner) = Some(learner);
                self.enter(run, domain)?;
                Ok(*welcome)
            }
        }
    }

    /// Declares what depends on the run's domain.
    fn enter(&self, run: RunName, domain: DomainName) -> Result<()> {
        let mut entered = lock(&self.entered);
        if entered.as_ref().is_some_and(|there| there.run == run && there.domain == domain) {
            return Ok(());
        }
        let key = Key::Rollouts(&run, &domain, &self.actor);
        let session = &self.session();
        let rollouts = pubsub::publisher(session, key, wire::BULK, Encoding::default())?;
        let (key, latest) = (Key::Announcement(&run, &domain), Arc::clone(&self.latest));
        let (ours, told) = (Arc::clone(&self.learner), Arc::clone(&self.told));
        let announcements = subscribe(session, key, move |sample| {
            if is_of_another(&ours, &sample) {
                return;
            }
            match weights::read_announcement(&sample) {
                Ok(news) => {
                    let key = format!("weights/{}", news.learner);
                    latest.put(&key, ActorEvent::Announcement(news));
                }
                Err(refusal) => told.tell("announcement", &refusal),
            }
        })?;
        *entered =
            Some(Arc::new(Membership { run, domain, rollouts, _announcements: announcements }));
        Ok(())
    }
}

/// Tells whether a message says to come from another learner than ours: it is of no use, and a proof costs more to check than to
/// invent.
fn is_of_another(ours: &Mutex<Option<Arc<PeerKey>>>, sample: &Sample) -> bool {
    let ours = lock(ours).as_ref().map(|learner| learner.peer);
    let header = sample.attachment().and_then(|bytes| Header::from_bytes(&bytes.to_bytes()).ok());
    ours.zip(header).is_some_and(|(ours, header)| header.incarnation != ours)
}

/// Reads the answer to the hello with this number, and whose it is.
fn read_answer(
    keys: &Keyring,
    number: Sequence,
    sample: &Sample,
) -> Result<(Arc<PeerKey>, HelloReply), Refusal> {
    let (attachment, payload) = (sample.attachment(), Some(sample.payload()));
    let answer = wire::unseal::<HelloReply>(attachment, payload, HELLO_REPLY, keys)?;
    wire::answers(number, answer.header.sequence)?;
    Ok((answer.key, answer.message))
}

fn on_order(
    events: &EventQueue<ActorEvent>,
    answers: &Answers,
    keys: &Keyring,
    told: &ToldRefusals,
    mut query: Query,
) {
    let say_no = |query, reason| answers.give(PendingReply::Refusal(query, reason));
    let meant_for = query.parameters().get(INCARNATION).and_then(|text| text.parse().ok());
    if meant_for != Some(keys.own.incarnation().0) {
        return say_no(query, "another start of this actor is meant".to_owned());
    }
    let order = wire::unseal::<Control>(query.attachment(), query.payload(), CONTROL, keys);
    unload(&mut query);
    match order.and_then(|order| order.message.check().map(|()| order)) {
        Ok(order) => {
            let reply = ControlResponder::new(query, answers, Schema::ControlReply, &order);
            let (learner, control) = (order.key.peer, order.message);
            // An order that does not fit ends without an answer; the learner gives it again.
            drop(events.offer(ActorEvent::Control { learner, control, reply }, Class::Request));
        }
        Err(refusal) => {
            told.tell("order", &refusal);
            say_no(query, refusal.to_string());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::*;

    #[test]
    fn a_relay_is_waited_for_as_long_as_it_may_wait_for_the_learner() {
        assert!(RELAY_TIMEOUT > ask::PULL_TIMEOUT);
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_connection_that_leads_nowhere_is_replaced_by_the_next_hello_and_a_closed_one_is_not()
    {
        let (site, elsewhere) = (Site::new(), Site::new());
        let (learner, events) = site.learner().await;
        let (actor, actor_events) = site.welcomed("a", &events).await;

        let nowhere = elsewhere.raw("peer").await;
        actor.session.replace(nowhere).close().await.unwrap();
        until(&events, |event| matches!(event, crate::LearnerEvent::Left(..)).then_some(())).await;
        actor.renew().await;
        assert!(!crate::session::has_peer(&actor.session()).await, "not yet");

        actor.session.wait_long();
        say_hello(&actor, "a", &events).await;
        until(&actor_events, |event| {
            matches!(event, ActorEvent::LearnerJoined(LEARNER)).then_some(())
        })
        .await;
        actor.health().unwrap();
        learner.offer_weights(PolicyVersion(1), b"newer".as_slice().into()).unwrap();
        assert_eq!(pull(&actor, &learner, 1).await.unwrap(), b"newer");
        let (header, payload) = rollout("a", 1);
        actor.publish_rollout(&header, payload).unwrap();
        assert_eq!(next_rollout(&events).await.1, header);

        actor.close().await.unwrap();
        assert!(matches!(actor.health().unwrap_err(), Error::Dead));
        actor.session.wait_long();
        actor.renew().await;
        assert!(matches!(actor.health().unwrap_err(), Error::Dead));
    }
}
