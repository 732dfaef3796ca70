//! The life of an actor process.
//!
//! ```text
//! connect ── hello ── welcome ──> loop: Wake ──> dismissed, cancelled, or an error
//!                        ▲          │
//!                        └── greet ─┘  learner lost, silent, or new
//! ```
//!
//! The loop has at most one job with the collecting thread, one pull of weights and a few rollouts with the
//! publishing thread under way; everything else waits in the [`Outbox`]. Whatever goes wrong with the learner,
//! the remedy is the same: say hello again, hear from where to resend, go on.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use leadtime_link::{ActorEvent, ActorLink, ControlResponder};
use leadtime_policy::Parameters;
use leadtime_proto::message::{Control, ControlAck, Credit, Welcome};
use leadtime_proto::{Epoch, Iteration, PolicyVersion};
use leadtime_sims::Registry;
use tokio::sync::mpsc;
use tokio::time::{Interval, MissedTickBehavior, interval, timeout_at};
use tokio_util::sync::CancellationToken;
use tracing::{debug, info, warn};

use crate::greeting::{compose_hello, is_same_run};
use crate::metrics::Metrics;
use crate::outbox::Outbox;
use crate::shelf::{Pull, Shelf};
use crate::threads::{Collected, Collector, Job, PUBLISHING, Publisher};
use crate::{ActorEnd, ActorReport, ActorSettings, Error};

/// How often time-outs are looked at and metrics are published.
const TICK: Duration = Duration::from_secs(1);
/// How long rollouts may stay unacknowledged before the actor says hello again.
const ACK_TIMEOUT: Duration = Duration::from_secs(3);
/// How long an actor without environments waits before it says hello again.
const IDLE_TIMEOUT: Duration = Duration::from_secs(10);
/// How long one hello may take.
const HELLO_TIMEOUT: Duration = Duration::from_secs(2);
/// First and longest pause between hellos that failed.
const BACK_OFF: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(2));
/// How long a leaving actor waits for the acknowledgement of what it sent.
const FAREWELL: Duration = Duration::from_secs(1);

/// Everything that can wake an actor.
#[derive(Debug)]
enum Wake {
    /// Something came from the network.
    Network(ActorEvent),
    /// The collecting thread is done with its job.
    Collected(Box<Result<Collected, Error>>),
    /// A rollout is with the network.
    Published(Result<Duration, Error>),
    /// Weights have arrived, or will not.
    Pulled(Pulled),
    /// Time has passed.
    Tick,
    /// This process is asked to stop.
    Stop,
}

/// The end of a pull that was begun in some generation.
type Pulled = (u64, Result<(PolicyVersion, Vec<u8>), leadtime_link::Error>);

/// What the loop does next.
enum Next {
    GoOn,
    Greet,
    Leave(ActorEnd),
}

/// Runs an actor until it is dismissed, cancelled, or cannot go on.
///
/// Needs tokio's multi-threaded runtime.
///
/// # Errors
///
/// [`Error`]: nobody at the address, several runs there and none named, refused or cut off by the learner, a task
/// that cannot be built or is another one here, or the learner lost for longer than the settings allow.
pub async fn run(
    settings: ActorSettings,
    registry: Registry,
    stop: CancellationToken,
) -> Result<ActorReport, Error> {
    let opened = ActorLink::open(&settings.connect, &settings.actor, settings.incarnation);
    let (link, events) = tokio::select! {
        opened = opened => opened?,
        () = stop.cancelled() => return Err(Error::CancelledEarly),
    };
    let link = Arc::new(link);
    let result = live(settings, registry, &link, &events, &stop).await;
    if let Err(error) = link.close().await {
        debug!(%error, "network not closed in time");
    }
    result
}

async fn live(
    settings: ActorSettings,
    registry: Registry,
    link: &Arc<ActorLink>,
    events: &flume::Receiver<ActorEvent>,
    stop: &CancellationToken,
) -> Result<ActorReport, Error> {
    let hello = compose_hello(&settings, &Outbox::default());
    let greeting = link.hello(settings.run.as_ref(), &hello, settings.connect.timeout);
    let welcome = tokio::select! {
        welcome = greeting => welcome?,
        () = stop.cancelled() => return Err(Error::CancelledEarly),
    };
    info!(run = %welcome.run, domain = welcome.task.domain, "joined");
    let mut actor = Actor::new(settings, registry, Arc::clone(link), welcome)?;
    let end = actor.work(events, stop).await?;
    actor.farewell(events).await;
    info!(?end, "leaving");
    Ok(actor.report(end))
}

struct Actor {
    settings: ActorSettings,
    link: Arc<ActorLink>,
    welcome: Welcome,
    outbox: Outbox,
    shelf: Shelf,
    collector: Collector,
    publisher: Publisher,
    pulls: (mpsc::Sender<Pulled>, mpsc::Receiver<Pulled>),
    /// Counts learners: what was begun under an older one is of no use.
    generation: u64,
    job_generation: Option<u64>,
    n_publishing: usize,
    is_pulling: bool,
    may_pull_from: Instant,
    paused: bool,
    epoch: Epoch,
    next: Option<Iteration>,
    assignments: VecDeque<Job>,
    last_progress: Instant,
    metrics: Metrics,
}

impl Actor {
    fn new(
        settings: ActorSettings,
        registry: Registry,
        link: Arc<ActorLink>,
        welcome: Welcome,
    ) -> Result<Self, Error> {
        let mut outbox = Outbox::default();
        outbox.resume(welcome.resend_from, welcome.window);
        let now = Instant::now();
        Ok(Self {
            collector: Collector::start(registry, &welcome, settings.incarnation)?,
            publisher: Publisher::start(Arc::clone(&link))?,
            shelf: Shelf::new(welcome.schedule, welcome.version),
            pulls: mpsc::channel(1),
            settings,
            link,
            welcome,
            outbox,
            generation: 0,
            job_generation: None,
            n_publishing: 0,
            is_pulling: false,
            may_pull_from: now,
            paused: false,
            epoch: Epoch(0),
            next: None,
            assignments: VecDeque::new(),
            last_progress: now,
            metrics: Metrics::default(),
        })
    }

    async fn work(
        &mut self,
        events: &flume::Receiver<ActorEvent>,
        stop: &CancellationToken,
    ) -> Result<ActorEnd, Error> {
        let mut ticks = interval(TICK);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            let wake = self.next_wake(events, &mut ticks, stop).await?;
            match self.handle(wake)? {
                Next::GoOn => {}
                Next::Leave(end) => return Ok(end),
                Next::Greet => {
                    if !self.greet(stop).await? {
                        return Ok(ActorEnd::Cancelled);
                    }
                }
            }
            self.publish()?;
            self.collect()?;
            self.pull();
        }
    }

    async fn next_wake(
        &mut self,
        events: &flume::Receiver<ActorEvent>,
        ticks: &mut Interval,
        stop: &CancellationToken,
    ) -> Result<Wake, Error> {
        Ok(tokio::select! {
            biased;
            () = stop.cancelled() => Wake::Stop,
            event = events.recv_async() => {
                Wake::Network(event.map_err(|_closed| Error::ThreadGone { name: "network" })?)
            }
            published = self.publisher.result(), if self.n_publishing > 0 => {
                Wake::Published(published)
            }
            collected = self.collector.result(), if self.job_generation.is_some() => {
                Wake::Collected(Box::new(collected))
            }
            Some(pulled) = self.pulls.1.recv() => Wake::Pulled(pulled),
            _ = ticks.tick() => Wake::Tick,
        })
    }

    fn handle(&mut self, wake: Wake) -> Result<Next, Error> {
        match wake {
            Wake::Network(event) => return self.network(event),
            Wake::Collected(collected) => self.collected((*collected)?),
            Wake::Published(published) => {
                self.n_publishing -= 1;
                match published {
                    Ok(took) => self.metrics.publish += took,
                    // Not on its way: the missing acknowledgement brings it back.
                    Err(error) => debug!(%error, "rollout not published"),
                }
            }
            Wake::Pulled(pulled) => self.pulled(pulled)?,
            Wake::Tick => return Ok(self.tick()),
            Wake::Stop => return Ok(Next::Leave(ActorEnd::Cancelled)),
        }
        Ok(Next::GoOn)
    }

    fn network(&mut self, event: ActorEvent) -> Result<Next, Error> {
        match event {
            ActorEvent::Control { control, ack } => return self.control(control, ack),
            ActorEvent::Credit(credit) => self.credit(credit),
            ActorEvent::Announcement(news) => {
                if news.learner == self.welcome.learner {
                    self.shelf.announce(news.version);
                }
            }
            ActorEvent::LearnerJoined(learner) if learner != self.welcome.learner => {
                return Ok(Next::Greet);
            }
            ActorEvent::LearnerLeft(learner) if learner == self.welcome.learner => {
                warn!(run = %self.welcome.run, "the learner is gone; looking for it");
                return Ok(Next::Greet);
            }
            ActorEvent::LearnerJoined(_) | ActorEvent::LearnerLeft(_) => {}
        }
        Ok(Next::GoOn)
    }

    fn control(&mut self, control: Control, ack: ControlResponder) -> Result<Next, Error> {
        let mut next = Next::GoOn;
        match control {
            Control::Assign(assignment) => {
                // An order that is given twice is followed once.
                if assignment.epoch > self.epoch {
                    self.epoch = assignment.epoch;
                    debug!(epoch = %self.epoch, given = assignment.envs.len(), "assigned");
                    self.assignments.push_back(Job::Assign(assignment));
                }
            }
            Control::Pause => self.paused = true,
            Control::Resume => self.paused = false,
            Control::Stop { reason, cut_off: false } => {
                next = Next::Leave(ActorEnd::Dismissed { reason });
            }
            Control::Stop { reason, cut_off: true } => {
                self.acknowledge(ack);
                let run = self.welcome.run.clone();
                return Err(Error::CutOff { run, reason });
            }
        }
        self.acknowledge(ack);
        Ok(next)
    }

    fn acknowledge(&self, ack: ControlResponder) {
        if let Err(error) = ack.acknowledge(ControlAck { epoch: self.epoch }) {
            debug!(%error, "order not acknowledged; it will come again");
        }
    }

    fn credit(&mut self, credit: Credit) {
        if credit.learner == self.welcome.learner
            && self.outbox.credit(credit.acknowledged, credit.limit)
        {
            self.last_progress = Instant::now();
        }
    }

    fn collected(&mut self, collected: Collected) {
        let generation = self.job_generation.take();
        self.metrics.add(&collected, self.welcome.n_steps);
        if generation != Some(self.generation) {
            return; // Made for a learner that is gone.
        }
        self.next = collected.next;
        if !self.outbox.is_waiting() {
            self.last_progress = Instant::now();
        }
        for parcel in collected.parcels {
            self.outbox.push(parcel);
        }
    }

    fn pulled(&mut self, (generation, pulled): Pulled) -> Result<(), Error> {
        self.is_pulling = false;
        if generation != self.generation {
            return Ok(());
        }
        match pulled {
            Ok((version, bytes)) => {
                let parameters = Parameters::from_safetensors(&bytes, &self.welcome.policy)?;
                self.shelf.put(version, parameters);
            }
            Err(error) => {
                debug!(%error, "weights not pulled; trying again");
                self.may_pull_from = Instant::now() + BACK_OFF.0;
            }
        }
        Ok(())
    }

    fn tick(&mut self) -> Next {
        let report = self.metrics.report(self.outbox.acknowledged(), self.next);
        if let Err(error) = self.link.publish_metrics(report.as_bytes()) {
            debug!(%error, "metrics not published");
        }
        let is_idle = self.next.is_none() && self.assignments.is_empty() && !self.paused;
        let silence = self.last_progress.elapsed();
        if self.outbox.is_waiting() && silence > ACK_TIMEOUT {
            warn!(run = %self.welcome.run, "the learner does not acknowledge; asking again");
            Next::Greet
        } else if is_idle && silence > IDLE_TIMEOUT {
            debug!("no environments; asking for some");
            Next::Greet
        } else {
            Next::GoOn
        }
    }

    /// Hands rollouts to the publishing thread as far as credit and its queue allow.
    fn publish(&mut self) -> Result<(), Error> {
        while self.n_publishing < PUBLISHING
            && let Some(parcel) = self.outbox.next_to_send()
        {
            self.publisher.begin(parcel.clone())?;
            self.outbox.mark_sent();
            self.n_publishing += 1;
        }
        Ok(())
    }

    /// Gives the collecting thread its next job, if there is one.
    fn collect(&mut self) -> Result<(), Error> {
        if self.job_generation.is_some() {
            return Ok(());
        }
        let Some(job) = self.assignments.pop_front().or_else(|| self.next_collection()) else {
            return Ok(());
        };
        self.collector.begin(job)?;
        self.job_generation = Some(self.generation);
        Ok(())
    }

    /// Returns the job of collecting the next iteration, if there is room for it and its weights are here.
    fn next_collection(&self) -> Option<Job> {
        let has_room = self.outbox.has_room(self.welcome.schedule, self.welcome.window);
        let next = self.next.filter(|_| has_room && !self.paused)?;
        let (version, parameters) = self.shelf.get(next)?;
        Some(Job::Collect { version, parameters })
    }

    /// Begins to pull the weights that are missing, unless a pull is under way.
    fn pull(&mut self) {
        if self.is_pulling || Instant::now() < self.may_pull_from {
            return;
        }
        let Some(wanted) = self.shelf.wanted(self.next) else { return };
        let version = match wanted {
            Pull::Version(version) => Some(version),
            Pull::Newest => None,
        };
        let (link, pulls) = (Arc::clone(&self.link), self.pulls.0.clone());
        let generation = self.generation;
        self.is_pulling = true;
        tokio::spawn(async move {
            let pulled = link.pull_weights(version).await;
            drop(pulls.send((generation, pulled)).await);
        });
    }

    /// Says hello until it is answered. Returns whether it was; otherwise this process is asked to stop.
    async fn greet(&mut self, stop: &CancellationToken) -> Result<bool, Error> {
        let (started, timeout) = (Instant::now(), self.settings.reconnect_timeout);
        let run = self.welcome.run.clone();
        let mut pause = BACK_OFF.0;
        self.metrics.n_reconnects += 1;
        loop {
            let hello = compose_hello(&self.settings, &self.outbox);
            let source = tokio::select! {
                () = stop.cancelled() => return Ok(false),
                answer = self.link.hello(Some(&run), &hello, HELLO_TIMEOUT) => match answer {
                    Ok(welcome) => return self.welcomed(welcome).map(|()| true),
                    Err(
                        error @ (leadtime_link::Error::Refused { .. }
                        | leadtime_link::Error::Taken { .. }),
                    ) => return Err(error.into()),
                    Err(error) => error,
                },
            };
            debug!(%source, "hello not answered");
            if started.elapsed() >= timeout {
                return Err(Error::LearnerLost { run, timeout, source });
            }
            tokio::select! {
                () = stop.cancelled() => return Ok(false),
                () = tokio::time::sleep(pause) => pause = (pause * 2).min(BACK_OFF.1),
            }
        }
    }

    /// Goes on with a learner that may be a new one.
    fn welcomed(&mut self, welcome: Welcome) -> Result<(), Error> {
        if !is_same_run(&self.welcome, &welcome) {
            return Err(Error::RunChanged { run: welcome.run });
        }
        if welcome.learner != self.welcome.learner {
            info!(version = %welcome.version, "the learner is back; starting over from its state");
            self.generation += 1;
            self.epoch = Epoch(0);
            self.next = None;
            self.assignments.clear();
            self.shelf = Shelf::new(welcome.schedule, welcome.version);
        }
        self.shelf.announce(welcome.version);
        self.outbox.resume(welcome.resend_from, welcome.window);
        self.last_progress = Instant::now();
        self.welcome = welcome;
        Ok(())
    }

    /// Waits a moment for the acknowledgement of what was sent; the rest is made again by others.
    async fn farewell(&mut self, events: &flume::Receiver<ActorEvent>) {
        self.outbox.drop_unsent();
        let deadline = tokio::time::Instant::now() + FAREWELL;
        while self.outbox.is_waiting() {
            match timeout_at(deadline, events.recv_async()).await {
                Ok(Ok(ActorEvent::Credit(credit))) => self.credit(credit),
                Ok(Ok(ActorEvent::LearnerLeft(learner))) if learner == self.welcome.learner => {
                    break;
                }
                Ok(Ok(_)) => {}
                Ok(Err(_)) | Err(_) => break,
            }
        }
    }

    fn report(self, end: ActorEnd) -> ActorReport {
        ActorReport {
            run: self.welcome.run,
            end,
            n_steps: self.metrics.n_steps,
            made: self.outbox.made(),
            sent: self.outbox.sent(),
            acknowledged: self.outbox.acknowledged(),
            n_reconnects: self.metrics.n_reconnects,
        }
    }
}
