//! An actor's end: finding a run, saying hello, taking orders, sending rollouts, pulling weights.
//!
//! ```text
//! open ── connected ── hello ──┬─ find the run by its learner's presence
//!                              ├─ declare presence, orders and credit (so that nothing is missed)
//!                              ├─ ask; wait for the welcome
//!                              └─ declare rollouts and announcements of the run's domain
//! LearnerLeft … LearnerJoined ── hello again, on the same link
//! ```

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use leadtime_proto::header::Schema;
use leadtime_proto::limits::MAX_ROLLOUT_BYTES;
use leadtime_proto::message::{Announcement, Control, Credit, Hello, HelloReply, Welcome};
use leadtime_proto::receive::{ANNOUNCEMENT, CONTROL, CREDIT, HELLO_REPLY};
use leadtime_proto::{ActorId, DomainName, Header, Incarnation, PolicyVersion, RunName};
use tracing::{debug, warn};
use zenoh::Wait as _;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::query::{Query, Queryable};
use zenoh::sample::{Sample, SampleKind};
use zenoh::session::Session;

use crate::ask::{Answer, Question, ask};
use crate::intake::lock;
use crate::keys::{self, Key, Keys, Member};
use crate::learner::{INCARNATION, publish_metrics};
use crate::queue::{Class, EventQueue};
use crate::weights::{self, VERSION};
use crate::{ConnectSettings, ControlResponder, Error, Result, discovery, session, wire};

/// Places in the event queue for credit and announcements.
const N_BULK: usize = 1_024;
/// How long a run that was named may be missing while others are there.
const WRONG_RUN_GRACE: Duration = Duration::from_secs(2);
/// How long it is waited for another start of this actor to go.
const TAKEN_GRACE: Duration = Duration::from_secs(2);
/// First and longest pause between attempts to find a run.
const RETRY: (Duration, Duration) = (Duration::from_millis(20), Duration::from_millis(500));
/// How long a pull of weights may take.
const PULL_TIMEOUT: Duration = Duration::from_secs(10);

/// Everything that can wake an actor from the network.
#[derive(Debug)]
pub enum ActorEvent {
    /// The learner gives an order.
    Control {
        /// The order.
        control: Control,
        /// Where to acknowledge it.
        ack: ControlResponder,
    },
    /// The learner acknowledges rollouts and allows more.
    Credit(Credit),
    /// Weights are there to be pulled.
    Announcement(Announcement),
    /// The learner is there (may be told more than once).
    LearnerJoined(Incarnation),
    /// The learner is gone, or the connection to it is lost.
    LearnerLeft(Incarnation),
}

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
struct Entered {
    run: RunName,
    domain: DomainName,
    rollouts: Publisher<'static>,
    _announcements: Subscriber<()>,
}

/// An actor's place on the network.
#[derive(Debug)]
pub struct ActorLink {
    session: Session,
    endpoints: String,
    actor: ActorId,
    incarnation: Incarnation,
    events: EventQueue<ActorEvent>,
    joined: Mutex<Option<Joined>>,
    entered: Mutex<Option<Arc<Entered>>>,
}

impl ActorLink {
    /// Connects to a learner or a router; no run is touched yet.
    ///
    /// # Errors
    ///
    /// [`Error::NobodyThere`] if nobody answers within the settings' time-out.
    pub async fn open(
        settings: &ConnectSettings,
        actor: &ActorId,
        incarnation: Incarnation,
    ) -> Result<(Self, flume::Receiver<ActorEvent>)> {
        let session = session::connect(settings).await?;
        let (events, receiver) = EventQueue::new(N_BULK);
        let link = Self {
            session,
            endpoints: settings.described(),
            actor: actor.clone(),
            incarnation,
            events,
            joined: Mutex::default(),
            entered: Mutex::default(),
        };
        Ok((link, receiver))
    }

    /// Says hello to a run, named or the only one there, and enters it when welcome.
    ///
    /// To be said again after every [`ActorEvent::LearnerJoined`] that follows a loss.
    ///
    /// # Errors
    ///
    /// * [`Error::NoLearner`] if no learner appears in time.
    /// * [`Error::SeveralRuns`] if none was named and several are there.
    /// * [`Error::RunNotFound`] if only others than the named one are there.
    /// * [`Error::Refused`] if the learner does not want this actor, for instance for its protocol version.
    /// * [`Error::Taken`] if another start of an actor of this name is there.
    /// * [`Error::NoAnswer`] if a learner is there but does not answer in time.
    pub async fn hello(
        &self,
        run: Option<&RunName>,
        hello: &Hello,
        timeout: Duration,
    ) -> Result<Welcome> {
        let started = Instant::now();
        loop {
            let run = self.find(run, started, timeout).await?;
            self.join(&run)?;
            let key = Key::Hello(&run).to_string();
            let (header, payload) = wire::seal(Schema::Hello, self.incarnation, hello)?;
            let timeout_left = timeout.saturating_sub(started.elapsed());
            let lane = wire::CONTROL;
            let selector = key.clone();
            let question = Question { selector, header, payload, lane, timeout: timeout_left };
            match ask(&self.session, question).await? {
                Answer::Reply(sample) => match self.answered(run, &sample) {
                    // One that was killed is there for a moment longer.
                    Err(Error::Taken { .. }) if started.elapsed() < timeout.min(TAKEN_GRACE) => {
                        tokio::time::sleep(RETRY.1).await;
                    }
                    answered => return answered,
                },
                Answer::Rejected(reason) => {
                    return Err(Error::Refused { run, actor: self.actor.clone(), reason });
                }
                Answer::Nobody if started.elapsed() < timeout => {
                    debug!(%run, "the learner did not answer the hello, trying again");
                    tokio::time::sleep(RETRY.0).await;
                }
                Answer::Nobody | Answer::TimedOut => return Err(Error::NoAnswer { key, timeout }),
            }
        }
    }

    /// Pulls the newest weights, or one version of them, and checks their digest.
    ///
    /// # Errors
    ///
    /// [`Error::Rejected`] if the version is not kept (any more), [`Error::NoAnswer`] if the learner is gone,
    /// [`Error::WeightsDamaged`] or [`Error::BadAnswer`] if what arrives is not what was sent.
    pub async fn pull_weights(
        &self,
        version: Option<PolicyVersion>,
    ) -> Result<(PolicyVersion, Vec<u8>)> {
        let entered = self.entered()?;
        let place = (&entered.run, &entered.domain);
        pull(&self.session, place, self.incarnation, version).await
    }

    /// Publishes a rollout: waits for the network, so call it from a thread of its own, never from a task.
    ///
    /// Header and payload travel as they are; judging them is the learner's.
    ///
    /// # Errors
    ///
    /// [`Error::TooLarge`] if it is so large that the network would drop it unsaid; [`Error::NotInARun`];
    /// [`Error::Network`].
    pub fn publish_rollout(&self, header: &Header, payload: Vec<u8>) -> Result<()> {
        let entered = self.entered()?;
        let key = entered.rollouts.key_expr().as_str();
        if payload.len() > 2 * MAX_ROLLOUT_BYTES {
            let (found, limit) = (payload.len(), MAX_ROLLOUT_BYTES);
            return Err(Error::TooLarge { key: key.to_owned(), found, limit });
        }
        let put = entered.rollouts.put(payload).attachment(header.to_bytes());
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
        publish_metrics(&self.session, (&entered.run, &member), self.incarnation, json)
    }

    /// Returns how many events did not fit into the queue.
    pub fn n_lost_events(&self) -> u64 {
        self.events.n_lost()
    }

    /// Leaves the network, within a limited time. Rollouts that are not acknowledged may be lost.
    ///
    /// # Errors
    ///
    /// [`Error::Close`] if it takes too long.
    pub async fn close(&self) -> Result<()> {
        session::close(&self.session).await
    }

    fn entered(&self) -> Result<Arc<Entered>> {
        let entered = lock(&self.entered).clone();
        entered.ok_or_else(|| Error::NotInARun { actor: self.actor.clone() })
    }

    /// Finds the run to say hello to.
    async fn find(
        &self,
        wanted: Option<&RunName>,
        started: Instant,
        timeout: Duration,
    ) -> Result<RunName> {
        let mut pause = RETRY.0;
        loop {
            let mut runs = discovery::runs(&self.session).await?;
            match wanted {
                Some(run) if runs.contains(run) => return Ok(run.clone()),
                None if runs.len() > 1 => {
                    let runs = runs.into_iter().collect();
                    return Err(Error::SeveralRuns { endpoints: self.endpoints.clone(), runs });
                }
                None if let Some(run) = runs.pop_first() => return Ok(run),
                _ => {}
            }
            let waited = started.elapsed();
            let patience = if runs.is_empty() { timeout } else { timeout.min(WRONG_RUN_GRACE) };
            if waited >= patience {
                let endpoints = self.endpoints.clone();
                return Err(match wanted {
                    Some(run) if !runs.is_empty() => {
                        let present = runs.into_iter().collect();
                        Error::RunNotFound { run: run.clone(), endpoints, present }
                    }
                    _ => Error::NoLearner { endpoints, timeout },
                });
            }
            tokio::time::sleep(pause.min(patience.saturating_sub(waited))).await;
            pause = (pause * 2).min(RETRY.1);
        }
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
        let member = Member::Actor(self.actor.clone());
        let alive = Key::Alive(run, &member, self.incarnation);
        let orders = self.declare_orders(run)?;
        let credit = self.declare_credit(run)?;
        let learner = self.declare_learner(run)?;
        let token = self.session.liveliness().declare_token(keys::expr(alive)).wait();
        *joined = Some(Joined {
            run: run.clone(),
            _orders: orders,
            _credit: credit,
            _learner: learner,
            _alive: token.map_err(Error::network("declare", &alive.to_string()))?,
        });
        Ok(())
    }

    fn declare_orders(&self, run: &RunName) -> Result<Queryable<()>> {
        let key = Key::Control(run, &self.actor);
        let (events, incarnation) = (self.events.clone(), self.incarnation);
        self.session
            .declare_queryable(keys::expr(key))
            .complete(true)
            .callback(move |query| on_order(&events, incarnation, query))
            .wait()
            .map_err(Error::network("declare", &key.to_string()))
    }

    fn declare_credit(&self, run: &RunName) -> Result<Subscriber<()>> {
        let key = Key::Credit(run, &self.actor);
        let (events, incarnation) = (self.events.clone(), self.incarnation);
        self.session
            .declare_subscriber(keys::expr(key))
            .callback(move |sample: Sample| {
                let read = wire::unseal(sample.attachment(), Some(sample.payload()), CREDIT);
                match read {
                    Ok((_, credit)) => offer_credit(&events, incarnation, credit),
                    Err(refusal) => warn!(%refusal, "credit refused"),
                }
            })
            .wait()
            .map_err(Error::network("subscribe to", &key.to_string()))
    }

    fn declare_learner(&self, run: &RunName) -> Result<Subscriber<()>> {
        let keys = Keys::LearnerOf(run);
        let events = self.events.clone();
        self.session
            .liveliness()
            .declare_subscriber(keys::expr(keys))
            .history(true)
            .callback(move |sample| {
                if let Some(alive) = keys::parse_alive(sample.key_expr()) {
                    let event = match sample.kind() {
                        SampleKind::Put => ActorEvent::LearnerJoined(alive.incarnation),
                        SampleKind::Delete => ActorEvent::LearnerLeft(alive.incarnation),
                    };
                    events.offer_or_drop(event, Class::Presence);
                }
            })
            .wait()
            .map_err(Error::network("subscribe to", &keys.to_string()))
    }

    fn answered(&self, run: RunName, sample: &Sample) -> Result<Welcome> {
        let read = wire::unseal(sample.attachment(), Some(sample.payload()), HELLO_REPLY);
        let (_, reply) = read.map_err(|source| {
            let key = Key::Hello(&run).to_string();
            Error::BadAnswer { key, source }
        })?;
        match reply {
            HelloReply::Refused { reason } => {
                Err(Error::Refused { run, actor: self.actor.clone(), reason })
            }
            HelloReply::Taken => Err(Error::Taken { actor: self.actor.clone() }),
            HelloReply::Welcome(welcome) => {
                self.enter(run, DomainName::new(welcome.task.domain.clone())?)?;
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
        let rollouts = Key::Rollouts(&run, &domain, &self.actor);
        let publisher = self
            .session
            .declare_publisher(keys::expr(rollouts))
            .priority(wire::BULK.priority)
            .congestion_control(wire::BULK.congestion)
            .express(wire::BULK.express)
            .wait()
            .map_err(Error::network("declare", &rollouts.to_string()))?;
        let announcements = self.declare_announcements(Key::Announcement(&run, &domain))?;
        *entered = Some(Arc::new(Entered {
            run,
            domain,
            rollouts: publisher,
            _announcements: announcements,
        }));
        Ok(())
    }

    fn declare_announcements(&self, key: Key<'_>) -> Result<Subscriber<()>> {
        let events = self.events.clone();
        self.session
            .declare_subscriber(keys::expr(key))
            .callback(move |sample: Sample| {
                let (attachment, payload) = (sample.attachment(), Some(sample.payload()));
                match wire::unseal(attachment, payload, ANNOUNCEMENT) {
                    Ok((_, news)) => {
                        events.offer_or_drop(ActorEvent::Announcement(news), Class::Bulk);
                    }
                    Err(refusal) => warn!(%refusal, "announcement refused"),
                }
            })
            .wait()
            .map_err(Error::network("subscribe to", &key.to_string()))
    }
}

fn offer_credit(events: &EventQueue<ActorEvent>, incarnation: Incarnation, credit: Credit) {
    // An earlier start of this actor may still be credited; that is not for us.
    if credit.incarnation == incarnation {
        events.offer_or_drop(ActorEvent::Credit(credit), Class::Bulk);
    }
}

fn on_order(events: &EventQueue<ActorEvent>, incarnation: Incarnation, query: Query) {
    let meant_for = query.parameters().get(INCARNATION).and_then(|text| text.parse().ok());
    if meant_for != Some(incarnation.0) {
        return say_no(&query, "another start of this actor is meant");
    }
    match wire::unseal(query.attachment(), query.payload(), CONTROL) {
        Ok((_, control)) => {
            let ack = ControlResponder::new(query, incarnation);
            // An order that does not fit ends without an answer; the learner gives it again.
            events.offer_or_drop(ActorEvent::Control { control, ack }, Class::Request);
        }
        Err(refusal) => {
            warn!(%refusal, "order refused");
            say_no(&query, &refusal.to_string());
        }
    }
}

fn say_no(query: &Query, reason: &str) {
    if let Err(error) = query.reply_err(reason).wait() {
        debug!(%error, "an answer could not be sent");
    }
}

/// Pulls weights and checks them.
pub(crate) async fn pull(
    session: &Session,
    (run, domain): (&RunName, &DomainName),
    incarnation: Incarnation,
    version: Option<PolicyVersion>,
) -> Result<(PolicyVersion, Vec<u8>)> {
    let key = Key::Weights(run, domain).to_string();
    let selector = match version {
        None => key.clone(),
        Some(version) => format!("{key}?{VERSION}={version}"),
    };
    let header = Header::plain(Schema::Weights, incarnation, &[]);
    let (payload, lane) = (Vec::new(), wire::BULK);
    let question = Question { selector, header, payload, lane, timeout: PULL_TIMEOUT };
    let sample = match ask(session, question).await? {
        Answer::Reply(sample) => sample,
        Answer::Rejected(reason) => return Err(Error::Rejected { key, reason }),
        Answer::Nobody | Answer::TimedOut => {
            return Err(Error::NoAnswer { key, timeout: PULL_TIMEOUT });
        }
    };
    let read = weights::read(&sample).map_err(|source| Error::BadAnswer { key, source })?;
    let (found, bytes) = read.checked()?;
    match version {
        Some(wanted) if wanted != found => Err(Error::WrongVersion { wanted, found }),
        _ => Ok((found, bytes)),
    }
}
