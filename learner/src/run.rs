//! A run from its first hello to its last checkpoint.
//!
//! ```text
//! network events ──┐                      ┌─> credit, orders, weights
//! trained updates ─┼─> one loop: Wake ────┼─> rollouts to the training thread
//! silent actors ───┤   (Coordinator       ├─> checkpoints
//! time, stop ──────┘    decides)          └─> the sink: progress, events
//! ```
//!
//! The loop never trains and never waits for an actor, so it answers within milliseconds whatever happens.
//! Everything that decides is in the [`Coordinator`]; everything here carries it out.
//!
//! # Shutdown
//!
//! When all updates are done, or when asked to stop: actors are told, the update under way is waited for (for a
//! limited time), the state goes to the disk, the books are closed. All of it takes less than five seconds; an
//! update that takes longer is lost and made again after a resume, with the same bits.

mod ending;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use leadtime_link::{LearnerEvent, LearnerLink};
use leadtime_ppo::TrainerState;
use leadtime_proto::PolicyVersion;
use tokio::time::{Interval, MissedTickBehavior, interval};
use tokio_util::sync::CancellationToken;
use tracing::debug;

use crate::checkpoint::CheckpointStore;
use crate::coordinator::{Coordinator, Effect, HelloRefusal, Terms};
use crate::episodes::Episodes;
use crate::orders::{OrderFailure, Orders};
use crate::report::{
    PhaseTimes, ProgressSink, RatedPolicy, RunEnd, RunEvent, RunReport, UpdateProgress,
};
use crate::resume::{self, Checkpoint, SavedPolicy, Standing};
use crate::training::{Job, Outcome, Training, Updated};
use crate::{Error, LearnerConfig};

/// How often credit is repeated and actors that are gone are forgotten.
const TICK: Duration = Duration::from_millis(500);
/// How many events of the network are taken before anything else is looked at.
const EVENTS_AT_ONCE: usize = 256;
/// Pause between two reports that actors are missing.
const WAITING_EVERY: Duration = Duration::from_secs(30);
/// The best policy's file beside the checkpoints.
pub const BEST_POLICY: &str = "best.safetensors";

/// Everything that can wake a learner.
#[derive(Debug)]
enum Wake {
    /// Something came from the network.
    Network(LearnerEvent),
    /// The training thread is done with its job.
    Trained(Outcome),
    /// An order failed.
    Order(OrderFailure),
    /// Time has passed.
    Tick,
    /// The run is asked to end.
    Stop,
}

/// Runs a learner until all updates are done or it is asked to stop.
///
/// Needs tokio's multi-threaded runtime. A run that was interrupted goes on from its newest whole checkpoint.
///
/// # Errors
///
/// [`Error`]: the network cannot be opened, the disk is full or not writable, the configuration differs from the
/// one that the run was begun with, no checkpoint is whole, or training diverged. What is on the disk stays.
pub async fn run(
    config: LearnerConfig,
    mut sink: Box<dyn ProgressSink>,
    stop: CancellationToken,
) -> Result<RunReport, Error> {
    let store = CheckpointStore::open(&config.checkpoints)?;
    let mut standing = resume::begin(&config, &store)?;
    for event in standing.events.drain(..) {
        sink.on_event(&event);
    }
    if standing.start.version.0 >= config.settings.n_updates() {
        return ending::already_finished(&config, standing);
    }
    let mut listen = config.listen.clone();
    listen.rollouts_per_actor = listen.rollouts_per_actor.max(config.window as usize);
    let (link, events) =
        LearnerLink::open(&config.run, &config.spec.task.domain, config.incarnation, &listen)
            .await?;
    sink.on_event(&RunEvent::Listening { locators: link.locators() });
    let mut run = Run::new(config, store, sink, standing, link)?;
    let result = run.live(&events, &stop).await;
    if let Err(error) = &result {
        run.coordinator.stop_everyone(&format!("the learner ended: {error}"));
        run.act();
        run.farewell(&events).await.unwrap_or_else(|error| debug!(%error, "farewell failed"));
    }
    if let Err(error) = run.link.close().await {
        debug!(%error, "network not closed in time");
    }
    result
}

struct Run {
    config: LearnerConfig,
    store: CheckpointStore,
    sink: Box<dyn ProgressSink>,
    link: Arc<LearnerLink>,
    orders: Orders,
    coordinator: Coordinator,
    training: Training,
    is_training: bool,
    n_updates: u64,
    version: PolicyVersion,
    best: Option<RatedPolicy>,
    episodes: Episodes,
    staleness: BTreeMap<u64, u64>,
    uniform_before: bool,
    last_update: Instant,
    last_checkpoint: (Instant, u64),
    wait: Duration,
    idle_since: Instant,
    /// When it was last told that actors are missing; `None` while there are enough.
    told_waiting: Option<Instant>,
}

impl Run {
    fn new(
        config: LearnerConfig,
        store: CheckpointStore,
        sink: Box<dyn ProgressSink>,
        standing: Standing,
        link: LearnerLink,
    ) -> Result<Self, Error> {
        let Standing { trainer, start, offered, best, episodes, staleness, uniform, .. } = standing;
        let (version, n_updates) = (trainer.version(), trainer.version().0);
        for (version, weights) in offered {
            link.offer_weights(version, weights)?;
        }
        let link = Arc::new(link);
        let now = Instant::now();
        Ok(Self {
            coordinator: Coordinator::new(terms(&config), start),
            orders: Orders::new(Arc::clone(&link)),
            training: Training::start(trainer)?,
            is_training: false,
            config,
            store,
            sink,
            link,
            n_updates,
            version,
            best,
            episodes,
            staleness,
            uniform_before: uniform,
            last_update: now,
            last_checkpoint: (now, n_updates),
            wait: Duration::ZERO,
            idle_since: now,
            told_waiting: None,
        })
    }

    async fn live(
        &mut self,
        events: &flume::Receiver<LearnerEvent>,
        stop: &CancellationToken,
    ) -> Result<RunReport, Error> {
        let mut ticks = interval(TICK);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            match self.next_wake(events, &mut ticks, stop).await? {
                Wake::Stop => return self.end(events, RunEnd::Stopped).await,
                wake => self.handle(wake, events)?,
            }
            if self.n_updates >= self.config.settings.n_updates() {
                return self.end(events, RunEnd::Finished).await;
            }
            if stop.is_cancelled() {
                continue; // No further update: the sink may have asked for exactly this many.
            }
            self.train()?;
            self.act();
        }
    }

    async fn next_wake(
        &mut self,
        events: &flume::Receiver<LearnerEvent>,
        ticks: &mut Interval,
        stop: &CancellationToken,
    ) -> Result<Wake, Error> {
        Ok(tokio::select! {
            biased;
            () = stop.cancelled() => Wake::Stop,
            // Before what strangers can flood, or credit would never be repeated.
            _ = ticks.tick() => Wake::Tick,
            outcome = self.training.outcome(), if self.is_training => Wake::Trained(outcome),
            failure = self.orders.failure() => Wake::Order(failure),
            event = events.recv_async() => Wake::Network(event.map_err(|_closed| Error::LinkGone)?),
        })
    }

    fn handle(&mut self, wake: Wake, events: &flume::Receiver<LearnerEvent>) -> Result<(), Error> {
        match wake {
            Wake::Network(event) => {
                self.network(event);
                for event in events.try_iter().take(EVENTS_AT_ONCE) {
                    self.network(event);
                }
            }
            Wake::Trained(outcome) => self.trained(outcome)?,
            Wake::Order(OrderFailure::Silent(key)) => self.coordinator.give_up(&key),
            Wake::Order(OrderFailure::CannotRestore(key, envs)) => {
                self.coordinator.cannot_restore(&key, &envs);
            }
            Wake::Tick => self.tick()?,
            Wake::Stop => {}
        }
        Ok(())
    }

    fn network(&mut self, event: LearnerEvent) {
        match event {
            LearnerEvent::Hello { hello, reply } => {
                let answered = match self.coordinator.hello(&hello) {
                    Ok(resend_from) => {
                        let window = self.coordinator.window();
                        let weights = self.link.announcement();
                        reply.welcome(self.config.welcome(weights, resend_from, window))
                    }
                    Err(HelloRefusal::Taken) => reply.taken(),
                    Err(refusal) => reply.refuse(&refusal.to_string()),
                };
                if let Err(error) = answered {
                    debug!(actor = %hello.actor, %error, "hello not answered; it will come again");
                }
            }
            LearnerEvent::Rollout { actor, header, payload } => {
                self.coordinator.rollout(actor, &header, &payload);
            }
            LearnerEvent::Joined { actor, incarnation } => {
                self.coordinator.joined(actor, incarnation);
            }
            LearnerEvent::Left { actor, incarnation } => self.coordinator.left(actor, incarnation),
            LearnerEvent::Refused { actor, refusal, .. } => {
                self.coordinator.refused_by_link(actor, refusal);
            }
        }
    }

    fn tick(&mut self) -> Result<(), Error> {
        self.link.health()?;
        self.coordinator.refused_without_event(self.link.take_uncounted());
        self.coordinator.credit_everyone();
        self.tell_waiting();
        let members = self.coordinator.members();
        self.orders.retain(|(actor, incarnation)| members.get(actor) == Some(incarnation));
        let metrics = format!(
            "{{\"version\":{},\"n_actors\":{},\"n_queued\":{}}}",
            self.version,
            self.coordinator.n_actors(),
            self.coordinator.n_pending(),
        );
        if let Err(error) = self.link.publish_metrics(metrics.as_bytes()) {
            debug!(%error, "metrics not published");
        }
        Ok(())
    }

    /// Says that actors are missing, at once and then every [`WAITING_EVERY`].
    fn tell_waiting(&mut self) {
        let Some(n_needed) = self.coordinator.n_actors_needed() else {
            self.told_waiting = None;
            return;
        };
        if self.told_waiting.is_none_or(|at| at.elapsed() >= WAITING_EVERY) {
            self.told_waiting = Some(Instant::now());
            let n_actors = self.coordinator.n_actors();
            self.sink.on_event(&RunEvent::WaitingForActors { n_actors, n_needed });
        }
    }

    /// Hands the next batch to the training thread, if it is idle and the batch is there.
    fn train(&mut self) -> Result<(), Error> {
        if self.is_training {
            return Ok(());
        }
        let Some(batch) = self.coordinator.next_batch() else { return Ok(()) };
        let (since, n_then) = self.last_checkpoint;
        let interval = self.config.checkpoint_interval;
        let next = self.n_updates + 1;
        let want_state = next == self.config.settings.n_updates()
            || next - n_then >= interval.updates
            || since.elapsed() >= interval.time;
        self.training.begin(Job::Update { rollouts: batch.rollouts, want_state })?;
        self.is_training = true;
        self.wait = self.idle_since.elapsed();
        Ok(())
    }

    fn trained(&mut self, outcome: Outcome) -> Result<(), Error> {
        self.is_training = false;
        self.idle_since = Instant::now();
        let updated = match outcome {
            Outcome::Failed(error) => return Err(error),
            Outcome::State(_) => return Ok(()),
            Outcome::Updated(updated) => *updated,
        };
        self.version = updated.version;
        self.n_updates += 1;
        self.coordinator.trained(updated.version);
        self.link.offer_weights(updated.version, Arc::clone(&updated.weights))?;
        self.link.retire_weights(self.oldest_needed());
        let ends = updated.rollouts.iter().flat_map(|rollout| &rollout.ends);
        self.episodes.extend(&self.config.spec.env, ends.map(|end| &end.summary));
        for (&staleness, &n_rollouts) in &updated.report.staleness {
            *self.staleness.entry(staleness).or_default() += n_rollouts;
        }
        self.rate(&updated.weights);
        self.tell_progress(&updated);
        match updated.state {
            Some(state) => self.checkpoint(*state),
            None => Ok(()),
        }
    }

    /// Keeps the policy if it is the best so far.
    fn rate(&mut self, weights: &Arc<[u8]>) {
        let Some(score) = self.episodes.score() else { return };
        let best = self.best.as_ref().and_then(|best| best.score);
        if best.is_none_or(|best| score > best) {
            let (version, weights) = (self.version, Arc::clone(weights));
            self.best = Some(RatedPolicy { version, score: Some(score), weights });
        }
    }

    fn tell_progress(&mut self, updated: &Updated) {
        let n_steps = self.config.steps_per_update();
        let elapsed = std::mem::replace(&mut self.last_update, Instant::now()).elapsed();
        self.sink.on_update(&UpdateProgress {
            update: updated.report.clone(),
            n_updates: self.n_updates,
            n_updates_total: self.config.settings.n_updates(),
            n_steps: self.n_updates * n_steps,
            steps_per_second: n_steps as f64 / elapsed.as_secs_f64().max(f64::EPSILON),
            phases: PhaseTimes { wait: self.wait, train: updated.took },
            episodes: self.episodes.means(),
            n_actors: self.coordinator.n_actors(),
            n_queued: self.coordinator.n_pending() as usize,
            books: self.coordinator.books().clone(),
        });
    }

    /// Carries out what the coordinator decided.
    fn act(&mut self) {
        for effect in self.coordinator.take_effects() {
            match effect {
                Effect::Event(event) => {
                    if let RunEvent::CutOff { actor, incarnation, .. } = &event {
                        self.link.cut_off(actor, *incarnation);
                    }
                    self.sink.on_event(&event);
                }
                Effect::Control { to, control } => {
                    if !self.orders.give(&to, control) {
                        self.coordinator.give_up(&to);
                    }
                }
                Effect::Credit { to, credit } => {
                    if let Err(error) = self.link.send_credit(&to, credit) {
                        debug!(actor = %to, %error, "credit not sent; it will be repeated");
                    }
                }
            }
        }
    }

    fn oldest_needed(&self) -> PolicyVersion {
        self.config.spec.schedule.oldest_needed(self.version)
    }

    fn last(&self) -> RatedPolicy {
        let weights = self.link.weights_since(self.version).pop();
        let (version, weights) = weights.expect("the newest version is on offer");
        RatedPolicy { version, score: self.episodes.score(), weights }
    }

    fn checkpoint(&mut self, trainer: TrainerState) -> Result<(), Error> {
        let mut older = self.link.weights_since(self.oldest_needed());
        older.pop(); // The trainer's own.
        let older = older.into_iter().map(|(version, weights)| {
            SavedPolicy::from(&RatedPolicy { version, score: None, weights })
        });
        let checkpoint = Checkpoint {
            identity: self.config.identity,
            trainer,
            places: self.coordinator.places(),
            epoch: self.coordinator.epoch(),
            older: older.collect(),
            best: self.best.as_ref().map(SavedPolicy::from),
            episodes: self.episodes.clone(),
            staleness: self.staleness.clone(),
            books: self.coordinator.books().clone(),
            waiting: self.coordinator.n_pending(),
            uniform: self.is_uniform(),
        };
        let (store, best, n_updates) = (&self.store, &self.best, self.n_updates);
        let path = tokio::task::block_in_place(|| {
            let path = store.write(n_updates, &checkpoint)?;
            if let Some(best) = best {
                store.write_file(BEST_POLICY, &best.weights)?;
            }
            Ok::<_, Error>(path)
        })?;
        self.last_checkpoint = (Instant::now(), n_updates);
        self.sink.on_policies(&self.last(), self.best.as_ref());
        self.sink.on_event(&RunEvent::CheckpointWritten { path, n_updates });
        Ok(())
    }

    fn is_uniform(&self) -> bool {
        self.uniform_before && self.coordinator.is_uniform()
    }
}

fn terms(config: &LearnerConfig) -> Terms {
    Terms {
        learner: config.incarnation,
        spec: config.spec.clone(),
        window: config.window,
        actors_min: config.actors_min,
        program: config.program.clone(),
        cpu: config.cpu.clone(),
    }
}
