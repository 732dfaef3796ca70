//! The life of an actor process: what [`Actor`] decides, carried out.
//!
//! ```text
//! connect ── hello ── welcome ──> loop: what happens -> Actor -> what is to be done ──> dismissed, cancelled, an error
//!
//!            ┌── collect thread: environments x policy
//! the loop ──┼── restore thread: environments from snapshots
//!            ├── publish thread: rollouts to the network
//!            └── tasks: a hello, a pull of weights
//! ```
//!
//! The loop itself never waits for the network or for an environment.

use std::future::pending;
use std::mem;
use std::sync::Arc;
use std::time::{Duration, Instant};

use leadtime_link::{ActorEvent, ActorLink, ControlResponder, Events, RUN_IS_ENDING};
use leadtime_policy::Parameters;
use leadtime_proto::message::{Assignment, Hello, Welcome};
use leadtime_proto::{EnvId, Header, PolicySpec, PolicyVersion};
use leadtime_sims::Registry;
use leadtime_trace::Timed;
use tokio::sync::mpsc;
use tokio::time::{Interval, MissedTickBehavior, interval, sleep_until, timeout_at};
use tokio_util::sync::CancellationToken;
use tracing::{debug, info, warn};

use crate::collect::{CollectJob, CollectWorker, Collected, EnvBuilder, RestoredEnvs};
use crate::job_thread::{ENDING, JobThread};
use crate::metrics::Metrics;
use crate::outbox::EncodedRollout;
use crate::phases::{self, CollectWait};
use crate::sink::ActorSink;
use crate::state::{Actor, ActorInput, ActorOutput, MAX_PULLS};
use crate::{ActorEnd, ActorReport, ActorSettings, Error};

/// How often time-outs are looked at and metrics are published.
const TICK: Duration = Duration::from_secs(1);
/// How long a leaving actor waits for the acknowledgement of what it sent.
const FAREWELL: Duration = Duration::from_secs(1);
/// How much nicer the thread that collects is where it yields to the learner (nice(2)).
const NICENESS: i32 = 10;
/// How long an actor that is asked to stop may take to finish its current rollout.
const LAST_ROLLOUT: Duration = Duration::from_secs(1);

type LiveActor = Actor<Arc<Parameters>, ControlResponder, RestoredEnvs>;
type LiveInput = ActorInput<Arc<Parameters>, ControlResponder, RestoredEnvs>;
type LiveOutput = ActorOutput<Arc<Parameters>, ControlResponder, RestoredEnvs>;

/// The environments of an assignment that are ready, and those that cannot be.
type Restored = Timed<Result<(RestoredEnvs, Vec<EnvId>), Error>>;

/// A rollout that the network has taken, or not.
#[derive(Debug)]
struct SentRollout {
    header: Header,
    n_bytes: usize,
    sent: Timed<leadtime_link::Result<()>>,
}

/// Everything that can wake an actor.
#[derive(Debug)]
enum ActorWake {
    /// Something came from the network.
    Network(ActorEvent),
    /// A hello was answered, or not.
    Greeted(Result<Box<Welcome>, Box<leadtime_link::Error>>),
    /// The collecting thread is done with its job.
    Collected(Result<Collected, Error>),
    /// The restoring thread is.
    Restored(Restored),
    /// The publishing thread is.
    Published(Vec<SentRollout>),
    /// Weights have arrived, or will not.
    Pulled(PolicyVersion, Timed<leadtime_link::Result<Vec<u8>>>),
    /// Time has passed.
    Tick,
    /// The actor wants to be woken.
    Alarm,
    /// This process is asked to stop.
    Stop,
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
    run_watched(settings, registry, stop, Box::new(())).await
}

/// As [`run`], and reports what it does.
///
/// # Errors
///
/// As [`run`].
pub async fn run_watched(
    settings: ActorSettings,
    registry: Registry,
    stop: CancellationToken,
    sink: Box<dyn ActorSink>,
) -> Result<ActorReport, Error> {
    let opened = ActorLink::open(&settings.connect, &settings.actor, &settings.start);
    let (link, events) = tokio::select! {
        opened = opened => opened?,
        () = stop.cancelled() => return Err(Error::CancelledEarly),
    };
    let link = Arc::new(link);
    let result = live(settings, registry, &link, &events, &stop, sink).await;
    // After an error as well: the others see at once that this actor is gone, and do not wait for its silence.
    if let Err(error) = link.close().await {
        debug!(%error, "network not closed in time");
    }
    result
}

async fn live(
    settings: ActorSettings,
    registry: Registry,
    link: &Arc<ActorLink>,
    events: &Events<ActorEvent>,
    stop: &CancellationToken,
    sink: Box<dyn ActorSink>,
) -> Result<ActorReport, Error> {
    let hello = LiveActor::first_hello(&settings);
    let greeting = link.hello(settings.run.as_ref(), &hello, settings.connect.timeout);
    let welcome = tokio::select! {
        welcome = greeting => welcome,
        () = stop.cancelled() => return Err(Error::CancelledEarly),
    };
    let welcome = match welcome {
        // The run ended while this actor was on its way: nothing has failed.
        Err(leadtime_link::Error::Ending { run }) => {
            info!("leaving: {RUN_IS_ENDING}");
            return Ok(ActorReport::of_latecomer(run));
        }
        welcome => welcome?,
    };
    info!(run = %welcome.run, domain = welcome.spec.task.domain, "joined");
    let mut process = Process::new(settings, registry, Arc::clone(link), welcome, sink)?;
    let end = process.work(events, stop).await?;
    process.farewell(events).await;
    match &end {
        ActorEnd::Dismissed { reason } => info!("leaving: {reason}"),
        ActorEnd::Cancelled => info!("leaving: asked to stop"),
    }
    Ok(process.report(end))
}

/// Lowers the priority of this thread. Linux keeps one for each; elsewhere it is the whole process that yields.
fn yield_to_learner() {
    if let Err(error) = rustix::process::nice(NICENESS) {
        debug!(%error, "collecting has the learner's priority");
    }
}

/// The threads and tasks of an actor process.
struct Process {
    actor: LiveActor,
    link: Arc<ActorLink>,
    policy: PolicySpec,
    collector: JobThread<CollectJob, Result<Collected, Error>>,
    restorer: JobThread<Assignment, Restored>,
    publisher: JobThread<Vec<EncodedRollout>, Vec<SentRollout>>,
    /// Where the tasks bring their results.
    tasks: (mpsc::Sender<ActorWake>, mpsc::Receiver<ActorWake>),
    n_steps: u32,
    metrics: Metrics,
    /// What the collecting thread waits for, or has waited for before its job.
    waits_for: CollectWait,
    sink: Box<dyn ActorSink>,
}

impl Process {
    fn new(
        settings: ActorSettings,
        registry: Registry,
        link: Arc<ActorLink>,
        welcome: Welcome,
        sink: Box<dyn ActorSink>,
    ) -> Result<Self, Error> {
        // What the learner says of the run is checked before anything is built by it.
        let (incarnation, spec) = (settings.start.incarnation(), welcome.spec.clone());
        let mut yields = settings.yields_to_learner;
        let actor = Actor::new(settings, welcome, Instant::now())?;
        let builder = EnvBuilder::new(registry, &spec)?;
        let mut worker = CollectWorker::new(builder.clone(), incarnation);
        let collect = move |job| {
            if mem::take(&mut yields) {
                yield_to_learner();
            }
            worker.work(job)
        };
        let sender = Arc::clone(&link);
        let send = move |rollout: EncodedRollout| {
            let EncodedRollout { header, payload } = rollout;
            let n_bytes = payload.len();
            let sent = Timed::measure(|| sender.publish_rollout(&header, payload));
            SentRollout { header, n_bytes, sent }
        };
        let publish =
            move |rollouts: Vec<EncodedRollout>| rollouts.into_iter().map(&send).collect();
        let restore = move |assignment| Timed::measure(|| builder.restore(assignment));
        Ok(Self {
            actor,
            link,
            policy: spec.policy,
            collector: JobThread::start("actor-collect", 1, collect)?,
            restorer: JobThread::start("actor-restore", 1, restore)?,
            publisher: JobThread::start("actor-publish", 1, publish)?,
            // A hello and as many pulls are under way at most: each has a place, so no task waits to hand in its result.
            tasks: mpsc::channel(MAX_PULLS + 1),
            n_steps: spec.n_steps,
            metrics: Metrics::default(),
            waits_for: CollectWait::Environments,
            sink,
        })
    }

    async fn work(
        &mut self,
        events: &Events<ActorEvent>,
        stop: &CancellationToken,
    ) -> Result<ActorEnd, Error> {
        // After a stall one tick is due, not one for every second of it.
        let mut ticks = interval(TICK);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            let wake = self.next_wake(events, &mut ticks, stop).await?;
            let Some(input) = self.input(wake)? else {
                self.finish_rollout(events, &mut ticks).await?;
                return Ok(ActorEnd::Cancelled);
            };
            for output in self.handle(input) {
                if let Some(end) = self.carry_out(output)? {
                    return Ok(end);
                }
            }
        }
    }

    /// Lets the actor decide what to do about something that happened.
    fn handle(&mut self, input: LiveInput) -> Vec<LiveOutput> {
        let outputs = self.actor.handle(Instant::now(), input);
        self.waits_for = self.actor.waits_for().unwrap_or(self.waits_for);
        outputs
    }

    /// Finishes the current rollout and sends it, if that takes at most [`LAST_ROLLOUT`]: otherwise another
    /// actor makes it again.
    async fn finish_rollout(
        &mut self,
        events: &Events<ActorEvent>,
        ticks: &mut Interval,
    ) -> Result<(), Error> {
        self.actor.begin_leaving();
        // The token that ended the work is cancelled for good: it would wake this loop without end.
        let never = CancellationToken::new();
        let deadline = tokio::time::Instant::now() + LAST_ROLLOUT;
        while self.actor.is_busy() {
            let wake = self.next_wake(events, ticks, &never);
            let Ok(wake) = timeout_at(deadline, wake).await else { break };
            let Some(input) = self.input(wake?)? else { break };
            for output in self.handle(input) {
                if self.carry_out(output)?.is_some() {
                    return Ok(());
                }
            }
        }
        Ok(())
    }

    async fn next_wake(
        &mut self,
        events: &Events<ActorEvent>,
        ticks: &mut Interval,
        stop: &CancellationToken,
    ) -> Result<ActorWake, Error> {
        let (alarm, listens) = (self.actor.wakes_at(), !self.actor.is_greeting());
        let alarm = async {
            match alarm {
                Some(at) => sleep_until(at.into()).await,
                None => pending().await,
            }
        };
        let own = async {
            Ok(tokio::select! {
                biased;
                Some(done) = self.tasks.1.recv() => done,
                published = self.publisher.result() => ActorWake::Published(published?),
                collected = self.collector.result() => ActorWake::Collected(collected?),
                restored = self.restorer.result() => ActorWake::Restored(restored?),
            })
        };
        let event = heard(events, listens);
        first_wake(stop, ticks, alarm, own, event).await
    }

    /// Converts a wake-up into an input of the actor; `None` if the process is asked to stop.
    fn input(&mut self, wake: ActorWake) -> Result<Option<LiveInput>, Error> {
        Ok(Some(match wake {
            ActorWake::Network(event) => from_network(event),
            ActorWake::Greeted(Ok(welcome)) => ActorInput::Welcomed(welcome),
            ActorWake::Greeted(Err(error)) => ActorInput::NotWelcomed(error),
            ActorWake::Collected(collected) => {
                let collected = collected.map_err(|error| self.told_apart(error))?;
                self.metrics.add(&collected, self.n_steps);
                let learner = self.actor.learner().0;
                phases::collected(self.sink.as_mut(), &collected, self.waits_for, learner);
                // Until the actor says otherwise: what comes between this job and the next is the loop.
                self.waits_for = CollectWait::Loop;
                ActorInput::Collected { rollouts: collected.rollouts, next: collected.next }
            }
            ActorWake::Restored(restored) => {
                phases::restored(self.sink.as_mut(), &restored);
                let restored = restored.value.map_err(|error| self.told_apart(error));
                let (envs, failed) = restored?;
                ActorInput::Restored { envs, failed }
            }
            ActorWake::Published(rollouts) => {
                for SentRollout { header, n_bytes, sent } in rollouts {
                    match &sent.value {
                        Ok(()) => self.metrics.publish += sent.duration,
                        // Not lost: it stays in the outbox until it is acknowledged.
                        Err(error) => debug!(%error, "rollout not published"),
                    }
                    phases::published(self.sink.as_mut(), &header, n_bytes, &sent);
                }
                ActorInput::Published
            }
            ActorWake::Pulled(version, pulled) => {
                phases::pulled(self.sink.as_mut(), version, &pulled);
                from_pull(version, pulled.value, &self.policy)
            }
            ActorWake::Alarm => ActorInput::Tick,
            ActorWake::Tick => {
                self.link.health()?;
                self.report_metrics();
                ActorInput::Tick
            }
            ActorWake::Stop => return Ok(None),
        }))
    }

    /// Distinguishes an environment that never worked here from one that did: only the latter justifies restarting this actor.
    fn told_apart(&self, error: Error) -> Error {
        match error {
            Error::Outside { reason } if self.metrics.n_steps == 0 => Error::NeverWorked { reason },
            error => error,
        }
    }

    /// Does what is to be done; returns how the actor ended if that is to leave.
    fn carry_out(&mut self, output: LiveOutput) -> Result<Option<ActorEnd>, Error> {
        match output {
            ActorOutput::Hello { hello, timeout } => self.greet(hello, timeout),
            ActorOutput::Reply(responder, answer) => {
                if let Err(error) = responder.reply(&answer) {
                    debug!(%error, "order not answered; it will come again");
                }
            }
            ActorOutput::Restore(assignment) => self.restorer.begin(assignment)?,
            ActorOutput::Adopt { epoch, keep, envs } => {
                self.collector.begin(CollectJob::Adopt { epoch, keep, envs })?;
            }
            ActorOutput::Collect { version, weights } => {
                self.collector.begin(CollectJob::Collect { version, weights })?;
            }
            ActorOutput::Publish(rollouts) => self.publisher.begin(rollouts)?,
            ActorOutput::Pull { version, sha256 } => {
                let (link, done) = (Arc::clone(&self.link), self.tasks.0.clone());
                tokio::spawn(async move {
                    let started = Instant::now();
                    // By digest: whoever answers, only what the learner announced is taken.
                    let pulled = link.pull_weights(version, sha256).await;
                    let pulled = Timed::since(started, pulled);
                    drop(done.send(ActorWake::Pulled(version, pulled)).await);
                });
            }
            ActorOutput::End(end) => return end.map(Some),
        }
        Ok(None)
    }

    fn greet(&self, hello: Hello, timeout: Duration) {
        let (link, done) = (Arc::clone(&self.link), self.tasks.0.clone());
        let run = self.actor.welcome.run.clone();
        tokio::spawn(async move {
            // By name: a learner of another run may be there by now, and this actor is built for one task.
            let answer = link.hello(Some(&run), &hello, timeout).await;
            drop(done.send(ActorWake::Greeted(answer.map(Box::new).map_err(Box::new))).await);
        });
    }

    fn report_metrics(&mut self) {
        self.sink.on_tick(self.actor.progress(self.metrics.n_steps));
        let report = self.metrics.report(&self.actor);
        if let Err(error) = self.link.publish_metrics(report.as_bytes()) {
            debug!(%error, "metrics not published");
        }
    }

    /// Waits a moment for the acknowledgement of what was sent; the rest is made again by others.
    async fn farewell(&mut self, events: &Events<ActorEvent>) {
        self.actor.begin_farewell();
        let deadline = tokio::time::Instant::now() + FAREWELL;
        while self.actor.outbox.is_waiting() {
            match timeout_at(deadline, events.recv()).await {
                Ok(Some(ActorEvent::LearnerLeft(learner))) if learner == self.actor.learner() => {
                    break;
                }
                // Credit says what has arrived. Orders go unanswered, as those to an actor that is gone.
                Ok(Some(event @ ActorEvent::Credit(_))) => {
                    self.actor.handle(Instant::now(), from_network(event));
                }
                Ok(Some(_)) => {}
                Ok(None) | Err(_) => break,
            }
        }
    }

    fn report(&self, end: ActorEnd) -> ActorReport {
        let Actor { welcome, outbox, n_reconnects, .. } = &self.actor;
        ActorReport {
            run: welcome.run.clone(),
            end,
            n_steps: self.metrics.n_steps,
            made: outbox.made,
            sent: outbox.sent,
            acknowledged: outbox.acknowledged,
            n_reconnects: *n_reconnects,
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // Together: one after the other, threads that are busy would take three times as long.
        let deadline = Instant::now() + ENDING;
        self.collector.end_by(deadline);
        self.restorer.end_by(deadline);
        self.publisher.end_by(deadline);
    }
}

/// Waits for something from the network; while the actor does not listen, for presence alone.
async fn heard(events: &Events<ActorEvent>, listens: bool) -> Option<ActorEvent> {
    if listens { events.recv().await } else { events.recv_presence().await }
}

/// Converts the result of a pull into an input of the actor.
///
/// Bytes with the announced digest that are no weights were announced by somebody else: the learner's own are of the
/// policy that its welcome describes. So the announcement is forgotten, as that of a version that nobody keeps.
fn from_pull(
    version: PolicyVersion,
    pulled: leadtime_link::Result<Vec<u8>>,
    policy: &PolicySpec,
) -> LiveInput {
    let bytes = match pulled {
        Ok(bytes) => bytes,
        Err(error) => {
            debug!(%error, "weights not pulled; trying again");
            let not_kept = matches!(error, leadtime_link::Error::NotKept { .. });
            return ActorInput::PullFailed { version, not_kept };
        }
    };
    match Parameters::from_safetensors(&bytes, policy) {
        Ok(parameters) => ActorInput::Pulled { version, weights: Arc::new(parameters) },
        Err(error) => {
            warn!(%version, "the announced weights cannot be read ({error}); trying again");
            ActorInput::PullFailed { version, not_kept: true }
        }
    }
}

/// Waits for the first of these. What has happened already comes in this order: the time and the actor's own threads before what
/// strangers can flood, or time-outs would never be looked at.
async fn first_wake(
    stop: &CancellationToken,
    ticks: &mut Interval,
    alarm: impl Future<Output = ()>,
    own: impl Future<Output = Result<ActorWake, Error>>,
    event: impl Future<Output = Option<ActorEvent>>,
) -> Result<ActorWake, Error> {
    Ok(tokio::select! {
        biased;
        () = stop.cancelled() => ActorWake::Stop,
        _ = ticks.tick() => ActorWake::Tick,
        () = alarm => ActorWake::Alarm,
        own = own => own?,
        event = event => ActorWake::Network(event.ok_or(Error::ThreadGone("network"))?),
    })
}

fn from_network(event: ActorEvent) -> LiveInput {
    match event {
        ActorEvent::Control { learner, control, reply } => {
            ActorInput::Order { learner, control, reply }
        }
        ActorEvent::Credit(credit) => ActorInput::Credit(credit),
        ActorEvent::Announcement(news) => ActorInput::Announcement(news),
        ActorEvent::LearnerJoined(learner) => ActorInput::LearnerJoined(learner),
        ActorEvent::LearnerLeft(learner) => ActorInput::LearnerLeft(learner),
    }
}

#[cfg(test)]
mod tests {
    use std::future::ready;

    use leadtime_proto::{ActionSpec, EnvSpec, Incarnation};
    use tokio::time::interval_at;

    use super::*;

    #[tokio::test]
    async fn a_flood_from_the_network_keeps_out_neither_the_clock_nor_the_actors_own_threads() {
        let stop = CancellationToken::new();
        // A tick is due, and the next one is not.
        let mut ticks = interval_at(Instant::now().checked_sub(TICK).unwrap().into(), TICK);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let flood = || ready(Some(ActorEvent::LearnerJoined(Incarnation(1))));
        let own = || ready(Ok(ActorWake::Greeted(Err(Box::new(leadtime_link::Error::Dead)))));
        let wake = first_wake(&stop, &mut ticks, ready(()), own(), flood()).await.unwrap();
        assert!(matches!(wake, ActorWake::Tick), "{wake:?}");
        let wake = first_wake(&stop, &mut ticks, ready(()), own(), flood()).await.unwrap();
        assert!(matches!(wake, ActorWake::Alarm), "{wake:?}");
        let wake = first_wake(&stop, &mut ticks, pending(), own(), flood()).await.unwrap();
        assert!(matches!(wake, ActorWake::Greeted(_)), "{wake:?}");
        let wake = first_wake(&stop, &mut ticks, pending(), pending(), flood()).await.unwrap();
        assert!(matches!(wake, ActorWake::Network(_)), "{wake:?}");
        stop.cancel();
        let wake = first_wake(&stop, &mut ticks, ready(()), own(), flood()).await.unwrap();
        assert!(matches!(wake, ActorWake::Stop), "{wake:?}");
    }

    #[test]
    fn announced_bytes_that_are_not_weights_are_pulled_again() {
        let actions = ActionSpec::discrete("a", 2);
        let policy = PolicySpec::dense(&EnvSpec { obs_dim: 1, actions, metrics: Vec::new() }, &[8]);
        let version = PolicyVersion(3);
        for rubbish in [vec![0; 100], Vec::new()] {
            let input = from_pull(version, Ok(rubbish), &policy);
            assert!(
                matches!(
                    input,
                    ActorInput::PullFailed { version: PolicyVersion(3), not_kept: true }
                ),
                "{input:?}"
            );
        }
        let failed = from_pull(version, Err(leadtime_link::Error::Dead), &policy);
        assert!(matches!(failed, ActorInput::PullFailed { not_kept: false, .. }), "{failed:?}");
    }
}
