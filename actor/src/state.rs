//! An actor's decisions, without network, clock or threads: what to do about each thing that happens.
//!
//! ```text
//! order, credit, announcement, welcome, rollouts, weights, time  ->  Actor  ->  ActorOutput (say, restore, collect, send)
//! ```
//!
//! Whatever goes wrong with the learner, the remedy is the same: say hello again, hear from where to send again, go on.
//! That is done when the learner is gone or new, does not acknowledge, or grants no credit (it has forgotten this
//! actor, for a learner credits its members all the time), and when weights that are needed are offered no more.
//!
//! # Invariants
//!
//! * At most one job is with the collecting thread, one assignment with the restoring one, [`MAX_PULLS`] pulls and one hello under
//!   way; everything else waits here. What was begun under an earlier learner is let go when it is done.
//! * An order is answered once its outcome is known, and every repetition gets the same answer.
//!
//! # Driving it
//!
//! [`Actor::handle`] takes one thing that happened and returns what is to be done, in order. Every output but
//! [`ActorOutput::Reply`] and [`ActorOutput::End`] is answered by the input that its documentation names. While
//! [`Actor::is_greeting`], what comes from the network waits with the driver, all but presence: an order of a new learner
//! must not be followed before its welcome. After [`Actor::wakes_at`] a [`ActorInput::Tick`] is due, and one now and then anyway.

use std::collections::{BTreeMap, VecDeque};
use std::iter;
use std::time::{Duration, Instant};

use leadtime_link::RUN_IS_ENDING;
use leadtime_numerics::{Pcg64, Purpose, stream};
use leadtime_proto::limits::{MAX_HEARD_EPOCH, MAX_WINDOW};
use leadtime_proto::message::{
    Announcement, Assignment, Control, ControlReply, Credit, Hello, Welcome,
};
use leadtime_proto::phrase::duration;
use leadtime_proto::{EnvId, Epoch, Incarnation, Iteration, PolicyVersion, Sequence};
use tracing::{debug, info, warn};

use crate::outbox::{EncodedRollout, Outbox};
use crate::phases::CollectWait;
use crate::weight_cache::WeightCache;
use crate::{ActorEnd, ActorProgress, ActorSettings, Error};

/// Rollouts that may be with the publishing thread: what is done together is handed over together, which wakes it once.
pub const PUBLISHING: usize = 64;
/// How long rollouts may stay unacknowledged before the actor says hello again.
const ACK_TIMEOUT: Duration = Duration::from_secs(3);
/// How long an actor without environments waits before it says hello again.
const IDLE_TIMEOUT: Duration = Duration::from_secs(10);
/// How long an actor without credit waits before it says hello again, the first time: a learner credits its members twice a
/// second, so an actor without credit is not a member. One that is at work does not ask.
const CREDIT_TIMEOUT: Duration = Duration::from_secs(5);
/// How long it waits at most: each time twice as long.
const MAX_CREDIT_TIMEOUT: Duration = Duration::from_mins(1);
/// The most versions of the weights that are pulled at once. Over a line with a round trip of 100 ms that is 160 a second.
pub(crate) const MAX_PULLS: usize = 16;
/// The most assignments that wait while one is being restored, and the most repetitions of one. A learner gives a few.
const MAX_ORDERS: usize = 64;
/// The pause between two lines in the log about a learner that does not answer.
const LOG_PAUSE: Duration = Duration::from_mins(1);
/// How long the first hello to a learner that was lost may take, search and answer included.
const HELLO_TIMEOUT: Duration = Duration::from_secs(2);
/// How long later ones may take: where many actors come back at once, an answer is late, and one that is not waited for costs one
/// more hello.
const MAX_HELLO_TIMEOUT: Duration = Duration::from_secs(10);
/// The first pause after a hello that failed, and the pause after a pull that failed.
const BACK_OFF: Duration = Duration::from_millis(100);
/// The longest pause between hellos that failed.
const MAX_BACK_OFF: Duration = Duration::from_secs(2);

/// Something that happened. `W`, `R` and `E` are what an [`Actor`] passes on without looking into it.
#[derive(Debug)]
pub enum ActorInput<W, R, E> {
    /// A learner gives an order.
    Order {
        /// The start of the learner: anybody in the network may be one, and only our own is followed.
        learner: Incarnation,
        /// What it orders.
        control: Control,
        /// Where to answer it.
        reply: R,
    },
    /// The learner acknowledges rollouts and allows more.
    Credit(Credit),
    /// Weights are there to be pulled.
    Announcement(Announcement),
    /// A learner is there.
    LearnerJoined(Incarnation),
    /// A learner is gone.
    LearnerLeft(Incarnation),
    /// The hello was answered with a welcome.
    Welcomed(Box<Welcome>),
    /// The hello was answered otherwise, or not at all.
    NotWelcomed(Box<leadtime_link::Error>),
    /// The environments of an assignment are ready.
    Restored {
        /// Those that can be stepped.
        envs: E,
        /// Those whose snapshots cannot be restored here.
        failed: Vec<EnvId>,
    },
    /// The collecting thread is done with its job.
    Collected {
        /// What it made, in order.
        rollouts: Vec<EncodedRollout>,
        /// The iteration to be collected next; `None` without environments.
        next: Option<Iteration>,
    },
    /// Rollouts are with the network, or failed to get there: a missing acknowledgement brings them back.
    Published,
    /// A pull has succeeded.
    Pulled {
        /// The version that was asked for.
        version: PolicyVersion,
        /// The weights, already checked against the announced digest.
        weights: W,
    },
    /// A pull has failed.
    PullFailed {
        /// The version that was asked for.
        version: PolicyVersion,
        /// The learner does not keep them (any more).
        not_kept: bool,
    },
    /// The regular clock tick: time-outs and retries are looked at.
    Tick,
}

/// Something to be done.
#[derive(Debug)]
pub enum ActorOutput<W, R, E> {
    /// Say hello; [`ActorInput::Welcomed`] or [`ActorInput::NotWelcomed`] follows.
    Hello {
        /// What the actor says of itself.
        hello: Hello,
        /// How long to look for the learner and to wait for its answer.
        timeout: Duration,
    },
    /// Answer an order.
    Reply(R, ControlReply),
    /// Make the environments of an assignment ready, from their snapshots; [`ActorInput::Restored`] follows.
    Restore(Assignment),
    /// Have the collecting thread step these from now on; [`ActorInput::Collected`] follows.
    Adopt {
        /// The assignment that rollouts carry from now on.
        epoch: Epoch,
        /// Environments that stay; the others are dropped.
        keep: Vec<EnvId>,
        /// Environments that join the ones that stay, ready to be stepped.
        envs: E,
    },
    /// Have the collecting thread collect the lowest iteration; [`ActorInput::Collected`] follows.
    Collect {
        /// The version of the policy that acts.
        version: PolicyVersion,
        /// The weights of the behaviour version.
        weights: W,
    },
    /// Send these rollouts, in this order; [`ActorInput::Published`] follows, once for all of them.
    Publish(Vec<EncodedRollout>),
    /// Pull weights; [`ActorInput::Pulled`] or [`ActorInput::PullFailed`] follows.
    Pull {
        /// The version that is needed next.
        version: PolicyVersion,
        /// The digest that its bytes must have.
        sha256: [u8; 32],
    },
    /// Leave; nothing follows.
    End(Result<ActorEnd, Error>),
}

/// A hello that is not answered yet.
#[derive(Debug)]
struct Greeting {
    since: Instant,
    /// When it was last logged that nobody answers.
    logged: Instant,
    pause: Duration,
    /// How long the next hello may take.
    timeout: Duration,
    /// The newest presence event of a learner since the hello: which start, and whether it is present. What came
    /// before the hello is out of date.
    presence: Option<(Incarnation, bool)>,
    /// The highest sequence that the last hello names: a new learner takes what comes after it for its own.
    published: Sequence,
    /// When to say it again; `None` while one is under way.
    retry_at: Option<Instant>,
}

/// An assignment whose environments are being restored.
#[derive(Debug)]
struct Restoration<R> {
    generation: u64,
    epoch: Epoch,
    keep: Vec<EnvId>,
    replies: Vec<R>,
}

/// An assignment whose environments are ready.
#[derive(Debug)]
struct Adoption<E> {
    epoch: Epoch,
    keep: Vec<EnvId>,
    envs: E,
}

/// The state behind an actor's decisions.
///
/// It passes on without looking into them: a policy's weights `W` (a copy is a count), where an order is answered `R`
/// (dropping it leaves the order without an answer), environments that are ready to be stepped `E` (none by default).
#[derive(Debug)]
pub struct Actor<W, R, E> {
    settings: ActorSettings,
    pub(crate) welcome: Welcome,
    pub(crate) outbox: Outbox,
    weights: WeightCache<W>,
    /// Counts learners: what was begun under an earlier one is of no use.
    generation: u64,
    greeting: Option<Greeting>,
    /// Actors that lost their learner together do not come back in step.
    jitter: Pcg64,
    orders: VecDeque<(Assignment, R)>,
    restoring: Option<Restoration<R>>,
    adoptions: VecDeque<Adoption<E>>,
    /// The generation of the job that is under way.
    job: Option<u64>,
    /// The generation of every pull that is under way, by its version.
    pulls: BTreeMap<PolicyVersion, u64>,
    may_pull_from: Instant,
    is_publishing: bool,
    /// The assignment that is followed, and what of it cannot be.
    epoch: Epoch,
    unrestored: Vec<EnvId>,
    /// The iteration to be collected next.
    pub(crate) next: Option<Iteration>,
    last_progress: Instant,
    last_credit: Instant,
    credit_timeout: Duration,
    /// How often hello was said again.
    pub(crate) n_reconnects: u64,
    is_leaving: bool,
    has_ended: bool,
    outputs: Vec<ActorOutput<W, R, E>>,
}

impl<W: Clone, R, E: Default> Actor<W, R, E> {
    /// Starts with the first welcome.
    ///
    /// # Errors
    ///
    /// [`Error::Spec`] if the run that the learner describes cannot be.
    pub fn new(settings: ActorSettings, welcome: Welcome, now: Instant) -> Result<Self, Error> {
        welcome.spec.check()?;
        let weights = WeightCache::new(welcome.spec.schedule, &welcome.weights);
        let jitter = stream(welcome.spec.seed, Purpose::Greet, 0, settings.start.incarnation().0);
        let mut actor = Self {
            settings,
            outbox: Outbox::default(),
            weights,
            jitter,
            welcome,
            generation: 0,
            greeting: None,
            orders: VecDeque::new(),
            restoring: None,
            adoptions: VecDeque::new(),
            job: None,
            pulls: BTreeMap::new(),
            may_pull_from: now,
            is_publishing: false,
            epoch: Epoch(0),
            unrestored: Vec::new(),
            next: None,
            last_progress: now,
            last_credit: now,
            credit_timeout: CREDIT_TIMEOUT,
            n_reconnects: 0,
            is_leaving: false,
            has_ended: false,
            outputs: Vec::new(),
        };
        actor.outbox.resume(actor.welcome.resend_from, actor.window());
        Ok(actor)
    }

    /// Composes the first hello of an actor, before there is a learner to answer it.
    pub fn first_hello(settings: &ActorSettings) -> Hello {
        compose_hello(settings, &Outbox::default())
    }

    /// Takes in something that happened and returns what is to be done about it, in order.
    pub fn handle(
        &mut self,
        now: Instant,
        input: ActorInput<W, R, E>,
    ) -> Vec<ActorOutput<W, R, E>> {
        match input {
            // Another's ends without an answer, as if nobody were here.
            ActorInput::Order { learner, control, reply } => {
                if learner == self.learner() {
                    self.order(control, reply);
                }
            }
            ActorInput::Credit(credit) => self.credit(now, credit),
            ActorInput::Announcement(news) => {
                if news.learner == self.learner() {
                    self.weights.announce(&news);
                }
            }
            ActorInput::LearnerJoined(learner) => self.presence(now, learner, true),
            ActorInput::LearnerLeft(learner) => self.presence(now, learner, false),
            ActorInput::Welcomed(welcome) => self.welcomed(now, *welcome),
            ActorInput::NotWelcomed(error) => self.not_welcomed(now, *error),
            ActorInput::Restored { envs, failed } => self.restored(envs, failed),
            ActorInput::Collected { rollouts, next } => self.collected(now, rollouts, next),
            ActorInput::Published => self.is_publishing = false,
            ActorInput::Pulled { version, weights } => {
                if self.pulls.remove(&version) == Some(self.generation) {
                    self.weights.put(version, weights);
                }
            }
            ActorInput::PullFailed { version, not_kept } => {
                self.may_pull_from = now + BACK_OFF;
                if self.pulls.remove(&version) == Some(self.generation)
                    && self.weights.failed(version, not_kept, self.next)
                {
                    self.let_go(now);
                }
            }
            ActorInput::Tick => self.look_at_the_time(now),
        }
        self.go_on(now);
        std::mem::take(&mut self.outputs)
    }

    /// Returns whether a hello is not answered yet; until it is, what comes from the network waits with the driver, all but
    /// presence.
    pub fn is_greeting(&self) -> bool {
        self.greeting.is_some()
    }

    /// Returns when a [`ActorInput::Tick`] is due, if one is due before the driver's next regular one.
    pub fn wakes_at(&self) -> Option<Instant> {
        match &self.greeting {
            Some(greeting) => greeting.retry_at,
            None => self.wants_weights().map(|_| self.may_pull_from),
        }
    }

    /// Begins no rollout any more, because the actor is about to leave: those that are done are still sent.
    pub(crate) fn begin_leaving(&mut self) {
        self.is_leaving = true;
    }

    /// Returns whether a rollout is being made, or handed to the network.
    pub(crate) fn is_busy(&self) -> bool {
        self.greeting.is_none() && (self.job.is_some() || self.is_publishing)
    }

    /// Says what the collecting thread waits for; `None` while it has a job.
    pub(crate) fn waits_for(&self) -> Option<CollectWait> {
        if self.job.is_some() {
            return None;
        }
        Some(if self.greeting.is_some() {
            CollectWait::Learner
        } else if self.next.is_none() {
            CollectWait::Environments
        } else if self.has_room() {
            CollectWait::Weights
        } else {
            CollectWait::Credit
        })
    }

    /// Returns whether more rollouts may be made.
    fn has_room(&self) -> bool {
        self.outbox.has_room(self.welcome.spec.schedule, self.window())
    }

    /// Returns how the actor stands, with what its process has counted.
    pub(crate) fn progress(&self, n_steps: u64) -> ActorProgress {
        ActorProgress {
            n_steps,
            n_unacknowledged: self.outbox.sent.0 - self.outbox.acknowledged.0,
            version: self.weights.newest_kept(),
            n_reconnects: self.n_reconnects,
            is_assigned: self.next.is_some(),
            is_searching: self.greeting.is_some(),
        }
    }

    /// Drops what was not sent, because the actor leaves. It begins nothing from now on.
    pub(crate) fn begin_farewell(&mut self) {
        self.has_ended = true;
        self.outbox.drop_unsent();
    }

    /// Returns the learner that this actor works for.
    pub(crate) fn learner(&self) -> Incarnation {
        self.welcome.weights.learner
    }

    fn window(&self) -> u32 {
        self.welcome.window.clamp(1, MAX_WINDOW)
    }

    fn order(&mut self, control: Control, reply: R) {
        let assignment = match control {
            Control::Assign(assignment) => assignment,
            Control::Stop { reason, cut_off } => {
                self.answer(reply);
                let run = self.welcome.run.clone();
                let cut = Err(Error::CutOff { run, reason: reason.clone() });
                return self.end(if cut_off { cut } else { Ok(ActorEnd::Dismissed { reason }) });
            }
            Control::Wait => return self.answer(reply),
        };
        // An order that is given again, because its answer was late or lost, is followed once and answered alike.
        let (generation, epoch) = (self.generation, assignment.epoch);
        if let Some(waiting) = self.orders.iter_mut().find(|(order, _)| order.epoch == epoch) {
            waiting.1 = reply;
        } else if let Some(restoring) =
            self.restoring.as_mut().filter(|r| (r.generation, r.epoch) == (generation, epoch))
        {
            if restoring.replies.len() < MAX_ORDERS {
                restoring.replies.push(reply);
            }
        } else if epoch > self.newest_epoch() {
            // One beyond is dropped without an answer, so its learner gives it again.
            if self.orders.len() < MAX_ORDERS {
                self.orders.push_back((assignment, reply));
            }
        } else {
            self.answer(reply);
        }
    }

    /// Returns the newest assignment that was given, followed already or not.
    fn newest_epoch(&self) -> Epoch {
        let restoring = self.restoring.as_ref().filter(|r| r.generation == self.generation);
        let waiting = self.orders.iter().map(|(order, _)| order.epoch);
        let known = restoring.map(|restoring| restoring.epoch);
        waiting.chain(known).max().unwrap_or_default().max(self.epoch)
    }

    /// Answers an order with what has come of the assignment that is followed.
    fn answer(&mut self, reply: R) {
        let (epoch, envs) = (self.epoch, self.unrestored.clone());
        let answer = if envs.is_empty() {
            ControlReply::Followed { epoch }
        } else {
            ControlReply::CannotRestore { epoch, envs }
        };
        self.outputs.push(ActorOutput::Reply(reply, answer));
    }

    fn restored(&mut self, envs: E, failed: Vec<EnvId>) {
        let Some(restored) = self.restoring.take() else { return };
        if restored.generation != self.generation {
            return; // Given by a learner that is gone; nobody waits for the answer.
        }
        let Restoration { epoch, keep, replies, .. } = restored;
        debug!(%epoch, "assigned");
        if !failed.is_empty() {
            let ids: Vec<String> = failed.iter().map(ToString::to_string).collect();
            warn!(
                run = %self.welcome.run,
                "environments {} cannot go on from their snapshots here, which another build may have made: left to \
                 the learner",
                ids.join(", ")
            );
        }
        (self.epoch, self.unrestored) = (epoch, failed);
        for reply in replies {
            self.answer(reply);
        }
        self.adoptions.push_back(Adoption { epoch, keep, envs });
    }

    fn credit(&mut self, now: Instant, credit: Credit) {
        if credit.learner != self.learner() {
            return;
        }
        (self.last_credit, self.credit_timeout) = (now, CREDIT_TIMEOUT);
        if self.outbox.credit(credit.acknowledged, credit.limit) {
            self.last_progress = now;
        }
    }

    fn collected(&mut self, now: Instant, rollouts: Vec<EncodedRollout>, next: Option<Iteration>) {
        if self.job.take() != Some(self.generation) {
            return; // Made for a learner that is gone.
        }
        self.next = next;
        if !self.outbox.is_waiting() {
            self.last_progress = now;
        }
        for rollout in rollouts {
            self.outbox.push(rollout);
        }
    }

    fn look_at_the_time(&mut self, now: Instant) {
        if self.greeting.is_some() {
            return;
        }
        let expects_some = !self.adoptions.is_empty() || !self.orders.is_empty();
        let is_idle = self.next.is_none() && !expects_some && self.restoring.is_none();
        let silence = now.saturating_duration_since(self.last_progress);
        if self.outbox.is_waiting() && silence > ACK_TIMEOUT {
            warn!(run = %self.welcome.run, "the learner does not acknowledge; asking again");
            self.greet(now);
        } else if self.job.is_none()
            && now.saturating_duration_since(self.last_credit) > self.credit_timeout
        {
            // Not while a rollout is made: the learner would take this actor for one that has lost its environments, and give them
            // anew. Whether it still counts on this actor shows when the rollout is sent.
            //
            // It may have given this actor up, over an order that was answered too late, without this actor's notice.
            // Less and less often, because one that is there and does not credit is not helped by hellos.
            debug!("no credit; asking whether this actor still belongs to the run");
            self.credit_timeout = (self.credit_timeout * 2).min(MAX_CREDIT_TIMEOUT);
            self.greet(now);
        } else if is_idle && silence > IDLE_TIMEOUT {
            debug!("no environments; asking for some");
            self.greet(now);
        }
    }

    /// Begins to say hello, unless that is under way.
    fn greet(&mut self, now: Instant) {
        if self.greeting.is_none() {
            self.n_reconnects += 1;
            self.greeting = Some(Greeting {
                since: now,
                logged: now,
                pause: BACK_OFF,
                timeout: HELLO_TIMEOUT,
                presence: None,
                published: self.outbox.made,
                retry_at: Some(now),
            });
        }
    }

    /// Says hello to a learner that is new, or looks for one that is gone. While a hello is under way, the newest of
    /// these is kept until its answer: a loss that was followed by a return needs no further hello.
    fn presence(&mut self, now: Instant, learner: Incarnation, is_there: bool) {
        let is_ours = learner == self.learner();
        if let Some(greeting) = &mut self.greeting {
            greeting.presence = Some((learner, is_there));
        } else if is_ours && !is_there {
            let wait = duration(self.settings.reconnect_timeout);
            let run = &self.welcome.run;
            warn!(%run, "the learner is gone; looking for it (--reconnect-timeout {wait})");
            self.greet(now);
        } else if !is_ours && is_there {
            self.greet(now);
        }
    }

    /// Returns a time between three quarters of this one and all of it.
    fn jittered(jitter: &mut Pcg64, time: Duration) -> Duration {
        time.mul_f64(jitter.uniform(0.75, 1.0))
    }

    fn not_welcomed(&mut self, now: Instant, error: leadtime_link::Error) {
        use leadtime_link::Error as LinkError;
        let Some(greeting) = &mut self.greeting else { return };
        match error {
            // The order to leave did not come through while this actor was looking for its learner.
            LinkError::Ending { .. } => {
                let reason = RUN_IS_ENDING.to_owned();
                return self.end(Ok(ActorEnd::Dismissed { reason }));
            }
            LinkError::Refused { .. } | LinkError::Taken { .. } => {
                return self.end(Err(error.into()));
            }
            _ => {}
        }
        debug!(%error, "hello not answered");
        let timeout = self.settings.reconnect_timeout;
        if now.saturating_duration_since(greeting.since) >= timeout {
            let run = self.welcome.run.clone();
            return self.end(Err(Error::LearnerLost { run, timeout, source: error }));
        }
        if now.saturating_duration_since(greeting.logged) >= LOG_PAUSE {
            greeting.logged = now;
            let gone = now.saturating_duration_since(greeting.since);
            let left = timeout.saturating_sub(gone);
            let (run, gone, left) = (&self.welcome.run, duration(gone), duration(left));
            warn!(%run, "still looking for the learner, gone for {gone}; for {left} more");
        }
        greeting.retry_at = Some(now + Self::jittered(&mut self.jitter, greeting.pause));
        greeting.pause = (greeting.pause * 2).min(MAX_BACK_OFF);
        greeting.timeout = (greeting.timeout * 2).min(MAX_HELLO_TIMEOUT);
    }

    /// Continues with the learner that sent the welcome, which may be a new one.
    fn welcomed(&mut self, now: Instant, welcome: Welcome) {
        let answered = self.greeting.take().map(|it| (it.presence, it.published));
        let (presence, published) = answered.unwrap_or((None, self.outbox.made));
        if self.welcome.spec != welcome.spec {
            return self.end(Err(Error::RunChanged(welcome.run)));
        }
        // No learner counts as far as that: somebody else gave that order, and no other would ever be followed.
        let is_astray = self.newest_epoch().0 > MAX_HEARD_EPOCH;
        if welcome.weights.learner == self.learner() && !is_astray {
            self.weights.announce(&welcome.weights);
        } else {
            let version = welcome.weights.newest();
            if is_astray {
                warn!(epoch = %self.newest_epoch(), "this actor followed an assignment with a number that no learner gives; starting over");
            } else {
                info!(%version, "the learner is back; starting over from its state");
            }
            self.generation += 1;
            (self.epoch, self.next) = (Epoch(0), None);
            self.unrestored.clear();
            self.orders.clear();
            self.adoptions.clear();
            // Made for the learner before, while this one read the hello: it would take them for its own, and refuse them.
            self.outbox.forget_after(published);
            self.weights = WeightCache::new(welcome.spec.schedule, &welcome.weights);
        }
        self.welcome = welcome;
        self.outbox.resume(self.welcome.resend_from, self.window());
        (self.last_progress, self.last_credit) = (now, now);
        if let Some((learner, is_there)) = presence {
            self.presence(now, learner, is_there);
        }
    }

    /// Drops environments that another actor steps by now. Kept, they would wait for weights that never come; and since
    /// this actor did not hear of it, the learner may have given it up.
    fn let_go(&mut self, now: Instant) {
        warn!(run = %self.welcome.run, "the run went on without this actor; asking for environments");
        self.next = None;
        let (epoch, envs) = (self.epoch, E::default());
        self.adoptions.push_front(Adoption { epoch, keep: Vec::new(), envs });
        self.greet(now);
    }

    fn end(&mut self, end: Result<ActorEnd, Error>) {
        self.has_ended = true;
        self.outputs.push(ActorOutput::End(end));
    }

    /// Begins whatever can be begun.
    fn go_on(&mut self, now: Instant) {
        if self.has_ended {
            return;
        }
        if let Some(greeting) = &mut self.greeting {
            if greeting.retry_at.is_some_and(|at| at <= now) {
                greeting.retry_at = None;
                let hello = compose_hello(&self.settings, &self.outbox);
                greeting.published = hello.published;
                let timeout = Self::jittered(&mut self.jitter, greeting.timeout);
                self.outputs.push(ActorOutput::Hello { hello, timeout });
            }
            return;
        }
        if self.is_leaving {
            return self.publish();
        }
        self.restore();
        self.publish();
        self.collect();
        self.pull(now);
    }

    /// Has the next assignment's environments made ready, one assignment at a time.
    fn restore(&mut self) {
        if self.restoring.is_some() {
            return;
        }
        let Some((assignment, reply)) = self.orders.pop_front() else { return };
        self.restoring = Some(Restoration {
            generation: self.generation,
            epoch: assignment.epoch,
            keep: assignment.keep.clone(),
            replies: vec![reply],
        });
        self.outputs.push(ActorOutput::Restore(assignment));
    }

    /// Hands the publishing thread, if it is idle, the rollouts that wait, as far as credit allows.
    fn publish(&mut self) {
        if self.is_publishing {
            return;
        }
        let next = iter::from_fn(|| self.outbox.send_next());
        let rollouts: Vec<EncodedRollout> = next.take(PUBLISHING).collect();
        if !rollouts.is_empty() {
            self.outputs.push(ActorOutput::Publish(rollouts));
            self.is_publishing = true;
        }
    }

    /// Gives the collecting thread its next job, if there is one.
    fn collect(&mut self) {
        if self.job.is_some() {
            return;
        }
        if let Some(Adoption { epoch, keep, envs }) = self.adoptions.pop_front() {
            self.job = Some(self.generation);
            return self.outputs.push(ActorOutput::Adopt { epoch, keep, envs });
        }
        let Some(next) = self.next else { return };
        if !self.has_room() {
            return;
        }
        if let Some((version, weights)) = self.weights.get(next) {
            self.job = Some(self.generation);
            self.outputs.push(ActorOutput::Collect { version, weights });
        }
    }

    fn wants_weights(&self) -> Option<(PolicyVersion, [u8; 32])> {
        if self.pulls.len() >= MAX_PULLS {
            return None;
        }
        self.weights.wanted(self.next, |version| self.pulls.contains_key(&version))
    }

    /// Begins to pull the weights that are missing, as many versions at once as may be under way.
    fn pull(&mut self, now: Instant) {
        while now >= self.may_pull_from
            && let Some((version, sha256)) = self.wants_weights()
        {
            self.pulls.insert(version, self.generation);
            self.outputs.push(ActorOutput::Pull { version, sha256 });
        }
    }
}

/// Composes a hello: who this is, and what it has made so far.
fn compose_hello(settings: &ActorSettings, outbox: &Outbox) -> Hello {
    Hello {
        program: settings.program.clone(),
        actor: settings.actor.clone(),
        incarnation: settings.start.incarnation(),
        cpu: settings.cpu.clone(),
        published: outbox.made,
        first_unacknowledged: outbox.acknowledged.next(),
    }
}

#[cfg(test)]
mod tests;
