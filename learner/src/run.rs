//! A run from its first hello to its last checkpoint.
//!
//! ```text
//! network events ──┐                          ┌─> credit, control, weights
//! trained updates ─┼─> one loop: LearnerWake ─┼─> rollouts to the training thread
//! silent actors ───┤   (Coordinator decides)  ├─> checkpoints, policies to the evaluating thread
//! time, stop ──────┘                          └─> the sink: progress, events
//! ```
//!
//! The loop never trains and never waits for an actor, so it answers within milliseconds whatever happens.
//! Everything that decides is in the [`Coordinator`]; everything here carries it out.
//!
//! # Shutdown
//!
//! When all updates are done, when a policy is as good as was asked for, or when asked to stop: actors are told, the update
//! under way is waited for (both together for [`FAREWELL`] at most), the state goes to the disk, the books are closed. An update
//! that takes longer is made again after a resume, with the same bits: the state before it is what is saved. A state that cannot be
//! written is tried again for [`KEPT`]. A policy that waits to be evaluated is saved as well. Only when all updates are done, the end
//! waits for its evaluation. How long the process lets all of this take is not decided here. A run that fails ends in the same way:
//! the state after its last good update is saved.

use std::sync::Arc;
use std::time::{Duration, Instant};

use leadtime_link::{LearnerEvent, LearnerLink};
use leadtime_ppo::TrainerState;
use leadtime_proto::PolicyVersion;
use leadtime_proto::message::{HelloReply, Welcome};
use leadtime_proto::phrase::with_causes;
use leadtime_trace::{Timed, TraceArrow};
use serde_json::json;
use tokio::time::{Interval, MissedTickBehavior, interval};
use tokio_util::sync::CancellationToken;
use tracing::{debug, warn};

use crate::bulletin::{Bulletin, RosterHead, roster};
use crate::checkpoint::{CheckpointError, CheckpointStore};
use crate::control_outbox::{ControlOutbox, ControlOutcome};
use crate::coordinator::{Coordinator, CoordinatorSettings, Effect, HelloRefusal, TICK};
use crate::ending;
use crate::evaluation_thread::{Evaluated, Evaluations, take_in};
use crate::held_out::HeldOutEvaluation;
use crate::phases::{PhaseClock, TrainingWait};
use crate::report::{
    ProgressSink, RatedPolicy, RunEnd, RunEvent, RunHealth, RunReport, UpdateProgress,
};
use crate::resume::{self, Checkpoint, ResumePoint, TrainingRecord};
use crate::saving::Saving;
use crate::training::{TrainingThread, Updated};
use crate::{Error, LearnerConfig};

/// How many events of the network are taken before anything else is looked at.
const EVENTS_AT_ONCE: usize = 256;
/// Pause between two reports that actors are missing.
const WAITING_EVERY: Duration = Duration::from_secs(30);
/// How long the end of a run waits for actors to leave and for the update under way.
const FAREWELL: Duration = Duration::from_millis(2_500);
/// How long the end of a run that cannot be saved is kept in memory; it is tried again every [`TICK`].
const KEPT: Duration = Duration::from_mins(1);

/// Everything that can wake a learner.
#[derive(Debug)]
enum LearnerWake {
    /// Something came from the network.
    Network(LearnerEvent),
    /// The training thread is done with an update, or failed.
    Trained(Box<Result<Updated, Error>>),
    /// The evaluating thread is done with a policy.
    Evaluated(Evaluated),
    /// A control message was answered, or was not.
    Control(ControlOutcome),
    /// Time has passed.
    Tick,
    /// The run is asked to end.
    Stop,
}

/// By what a run is ended before its last update.
#[derive(Clone, Debug, Default)]
pub struct RunStop {
    /// Asks the run to end with a checkpoint.
    pub ask: CancellationToken,
    /// Asks it to give up what it cannot save. It counts only if it comes after the run was asked to end: somebody insists.
    pub insist: CancellationToken,
}

/// Runs a learner until all updates are done or it is asked to stop.
///
/// Needs tokio's multi-threaded runtime. A run that was interrupted goes on from its newest whole checkpoint. Without
/// `held_out` no policy is evaluated, and the newest is the best one.
///
/// # Errors
///
/// [`Error`]: the network cannot be opened, the disk is full or not writable, the configuration differs from the
/// one that the run was begun with, no checkpoint is whole, or training diverged. What is on the disk stays, and what was
/// trained until then is saved.
pub async fn run(
    config: LearnerConfig,
    mut sink: Box<dyn ProgressSink>,
    held_out: Option<HeldOutEvaluation>,
    stop: RunStop,
) -> Result<RunReport, Error> {
    let mut store = CheckpointStore::open(&config.checkpoints, config.retention)?;
    let mut point = resume::begin(&config, &mut store)?;
    for event in point.events.drain(..) {
        sink.on_event(&event);
    }
    let settings = &config.settings;
    let evaluations =
        held_out.map(|held_out| Evaluations::start(held_out, settings)).transpose()?;
    let reached = evaluations
        .as_ref()
        .and_then(|it| point.record.held_out.reached(&it.plan, point.start.version));
    if reached.is_some() || point.start.version.0 >= settings.n_updates() {
        return ending::already_trained(&config, point, sink.as_mut(), evaluations, &stop.ask)
            .await;
    }
    // An actor may have a whole window on its way: with fewer places the link would refuse what credit allowed.
    let mut listen = config.listen.clone();
    listen.rollouts_per_actor = listen.rollouts_per_actor.max(config.window as usize);
    let (mut link, events) =
        LearnerLink::open(&config.run, &config.spec.task.domain, &config.start, &listen).await?;
    if let Some(archive) = sink.archive() {
        link.answer_observers(archive)?;
    }
    sink.on_event(&RunEvent::Listening { locators: link.locators() });
    let mut run = RunLoop::new(config, store, sink, point, link, evaluations)?;
    let result = match run.live(&events, &stop).await {
        Ok(end) => run.end(&events, end, &stop).await,
        Err(error) => {
            run.fail(&error, &events, &stop).await;
            Err(error)
        }
    };
    let how = result.as_ref().map_or("failed", |report| report.end.name());
    run.bulletin.finish(&json!({"kind": "end", "how": how, "update": run.version.0})).await;
    if let Err(error) = run.link.close().await {
        debug!(%error, "network not closed in time");
    }
    result
}

struct RunLoop {
    config: LearnerConfig,
    store: CheckpointStore,
    sink: Box<dyn ProgressSink>,
    link: Arc<LearnerLink>,
    outbox: ControlOutbox,
    bulletin: Bulletin,
    coordinator: Coordinator,
    training: TrainingThread,
    is_training: bool,
    /// `None` where no policy is evaluated.
    evaluations: Option<Evaluations>,
    /// The trainer's state after the last finished update.
    state: TrainerState,
    version: PolicyVersion,
    record: TrainingRecord,
    last_update: Instant,
    last_checkpoint: (Instant, u64),
    saving: Saving,
    /// Where the time since the last update went so far.
    phases: PhaseClock,
    /// Observers are told who is here at every other tick.
    is_even_tick: bool,
    /// When it was last reported that actors are missing; `None` while there are enough.
    warned_waiting_at: Option<Instant>,
}

impl RunLoop {
    fn new(
        config: LearnerConfig,
        store: CheckpointStore,
        mut sink: Box<dyn ProgressSink>,
        point: ResumePoint,
        link: LearnerLink,
        evaluations: Option<Evaluations>,
    ) -> Result<Self, Error> {
        let ResumePoint { trainer, start, offered, record, .. } = point;
        let version = trainer.version();
        let mut phases = PhaseClock::start();
        // Of a run that goes on: in a schedule with a lag, rollouts are due that older versions have to make.
        for (version, weights) in offered {
            let offer = Timed::measure(|| link.offer_weights(version, weights));
            phases.offered(sink.as_mut(), config.start.incarnation().0, version, &offer);
            offer.value?;
        }
        let link = Arc::new(link);
        let now = Instant::now();
        let settings = CoordinatorSettings {
            learner: config.start.incarnation(),
            spec: config.spec.clone(),
            window: config.window,
            actors_min: config.actors_min,
        };
        Ok(Self {
            coordinator: Coordinator::new(settings, start),
            outbox: ControlOutbox::new(Arc::clone(&link)),
            bulletin: Bulletin::start(Arc::clone(&link)),
            is_even_tick: false,
            state: trainer.state()?,
            training: TrainingThread::start(trainer)?,
            is_training: false,
            evaluations,
            saving: Saving::new(config.checkpoint_patience),
            config,
            store,
            sink,
            link,
            version,
            record,
            last_update: now,
            last_checkpoint: (now, version.0),
            phases,
            warned_waiting_at: None,
        })
    }

    /// Goes round until there is a reason to end, and returns it.
    async fn live(
        &mut self,
        events: &flume::Receiver<LearnerEvent>,
        stop: &RunStop,
    ) -> Result<RunEnd, Error> {
        // After a stall one tick is due: lateness is counted in ticks, and nobody was heard while the loop stood still.
        let mut ticks = interval(TICK);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            let version = self.version;
            match self.next_wake(events, &mut ticks, &stop.ask).await? {
                LearnerWake::Stop => return Ok(RunEnd::Stopped),
                wake => self.handle(wake, events)?,
            }
            let is_over = self.is_over();
            // None follows when the run is asked to stop: the sink may have asked for exactly this many.
            if !is_over && !stop.ask.is_cancelled() {
                self.train()?;
                self.evaluate();
                self.act();
            }
            // After the next update has begun: the training thread does not wait for the disk.
            if self.version > version && self.is_checkpoint_due() {
                self.save()?;
            }
            if is_over {
                return Ok(RunEnd::Finished);
            }
        }
    }

    /// Returns whether there is nothing left to train, and says so where that is before the last update.
    fn is_over(&mut self) -> bool {
        if self.version.0 >= self.config.settings.n_updates() {
            return true;
        }
        let evaluations = self.evaluations.as_ref();
        let reached =
            evaluations.and_then(|it| self.record.held_out.reached(&it.plan, self.version));
        if let Some(means) = reached {
            self.sink.on_event(&RunEvent::Reached { means });
        }
        reached.is_some()
    }

    async fn next_wake(
        &mut self,
        events: &flume::Receiver<LearnerEvent>,
        ticks: &mut Interval,
        stop: &CancellationToken,
    ) -> Result<LearnerWake, Error> {
        Ok(tokio::select! {
            biased;
            // In this order, and the network last: strangers can flood it, and everything else would wait.
            () = stop.cancelled() => LearnerWake::Stop,
            updated = self.training.updated(), if self.is_training => {
                LearnerWake::Trained(Box::new(updated))
            }
            Some(evaluated) = next_evaluated(self.evaluations.as_mut()) => {
                LearnerWake::Evaluated(evaluated)
            }
            Some(outcome) = self.outbox.outcomes.recv() => LearnerWake::Control(outcome),
            wake = tick_or_event(ticks, events) => wake?,
        })
    }

    fn handle(
        &mut self,
        wake: LearnerWake,
        events: &flume::Receiver<LearnerEvent>,
    ) -> Result<(), Error> {
        match wake {
            LearnerWake::Network(event) => {
                // Several at a time: what follows every wake-up costs more than an event.
                self.network(event);
                for event in events.try_iter().take(EVENTS_AT_ONCE) {
                    self.network(event);
                }
            }
            LearnerWake::Trained(updated) => {
                self.is_training = false;
                self.trained((*updated)?)?;
            }
            LearnerWake::Evaluated(evaluated) => {
                if let Some(Evaluations { plan, .. }) = &self.evaluations {
                    take_in(plan, evaluated, &mut self.record.held_out, self.sink.as_mut());
                }
            }
            LearnerWake::Control(outcome) => {
                self.controlled(outcome);
                while let Ok(outcome) = self.outbox.outcomes.try_recv() {
                    self.controlled(outcome);
                }
            }
            LearnerWake::Tick => self.tick()?,
            LearnerWake::Stop => {}
        }
        Ok(())
    }

    fn controlled(&mut self, outcome: ControlOutcome) {
        match outcome {
            ControlOutcome::Answered(key, membership) => {
                self.coordinator.answered(&key, membership);
            }
            ControlOutcome::Followed(key, membership, epoch) => {
                self.coordinator.followed(&key, membership, epoch);
            }
            ControlOutcome::Silent(key, membership) => self.coordinator.silent(&key, membership),
            ControlOutcome::CannotRestore(key, epoch, envs) => {
                self.coordinator.cannot_restore(&key, epoch, &envs);
            }
            ControlOutcome::Astray(key, membership, told) => {
                self.coordinator.astray(&key, membership, told);
            }
        }
    }

    fn network(&mut self, event: LearnerEvent) {
        match event {
            LearnerEvent::Hello { hello, reply } => {
                let answer = match self.coordinator.hello(&hello) {
                    Ok(resend_from) => HelloReply::Welcome(Box::new(Welcome {
                        run: self.config.run.clone(),
                        spec: self.config.spec.clone(),
                        window: self.coordinator.window(),
                        weights: self.link.announcement(),
                        resend_from,
                    })),
                    Err(HelloRefusal::Taken) => HelloReply::Taken,
                    Err(refusal) => HelloReply::Refused { reason: refusal.to_string() },
                };
                if let Err(error) = reply.reply(&answer) {
                    debug!(actor = %hello.actor, %error, "hello not answered; it will come again");
                }
            }
            LearnerEvent::Rollout { actor, header, payload } => {
                let (start, sequence) = (header.incarnation.0, header.sequence.0);
                self.phases.arrived(TraceArrow::of_rollout(start, sequence));
                self.coordinator.rollout(actor, &header, &payload);
            }
            LearnerEvent::Joined(actor, start) => self.coordinator.joined(actor, start),
            LearnerEvent::Left(actor, start) => self.coordinator.left(actor, start),
            LearnerEvent::Refused { actor, refusal, .. } => {
                self.coordinator.refused_by_link(actor, refusal);
            }
        }
    }

    fn tick(&mut self) -> Result<(), Error> {
        self.link.health()?;
        self.coordinator.refused_without_event(self.link.take_uncounted());
        self.coordinator.tick();
        self.report_waiting();
        let members = self.coordinator.members();
        self.outbox.retain(|(actor, incarnation)| members.get(actor) == Some(incarnation));
        self.is_even_tick = !self.is_even_tick;
        if self.is_even_tick {
            self.tell_roster();
        }
        self.sink.on_tick(&self.health());
        self.mind_the_disk()
    }

    /// Tells observers who is here.
    fn tell_roster(&self) {
        let run = RosterHead {
            version: self.version.0,
            n_updates_total: self.config.settings.n_updates(),
            n_queued: self.coordinator.n_pending(),
            n_needed: self.coordinator.n_actors_needed(),
            checkpoint: self.last_checkpoint.1,
        };
        let queued = self.link.queued_bytes();
        self.bulletin.tell(&roster(run, self.coordinator.roster_entries(), &queued));
    }

    /// Reports that actors are missing, at once and then every [`WAITING_EVERY`].
    fn report_waiting(&mut self) {
        let Some(n_needed) = self.coordinator.n_actors_needed() else {
            self.warned_waiting_at = None;
            return;
        };
        if self.warned_waiting_at.is_none_or(|at| at.elapsed() >= WAITING_EVERY) {
            self.warned_waiting_at = Some(Instant::now());
            let n_actors = self.coordinator.n_answering();
            self.sink.on_event(&RunEvent::WaitingForActors { n_actors, n_needed });
        }
    }

    /// Hands the next batch to the training thread, if it is idle and the batch is there, and not too many policies wait to
    /// be evaluated.
    fn train(&mut self) -> Result<(), Error> {
        if self.is_training {
            return Ok(());
        }
        if self.evaluations.as_ref().is_some_and(|it| self.record.held_out.is_full(&it.plan)) {
            self.phases.waits_for(TrainingWait::Evaluation);
            return Ok(());
        }
        if self.saving.is_paused(Instant::now()) {
            self.phases.waits_for(TrainingWait::Disk);
            return Ok(());
        }
        let Some(batch) = self.coordinator.next_batch() else {
            self.phases.waits_for(TrainingWait::Rollouts);
            return Ok(());
        };
        self.phases.begins(self.sink.as_mut());
        self.training.begin(batch, self.coordinator.take_broken_off())?;
        self.is_training = true;
        Ok(())
    }

    fn trained(&mut self, updated: Updated) -> Result<(), Error> {
        self.phases.trained(self.sink.as_mut(), &updated);
        let started = Instant::now();
        self.version = updated.version;
        self.coordinator.trained(updated.version);
        // Before everything that takes time: actors wait for it. Where it fails, the update is made all the same.
        let offered = self.link.offer_weights(updated.version, Arc::clone(&updated.weights));
        // After the offer: there is always a version to pull.
        self.link.retire_weights(self.oldest_needed());
        let (learner, offer) = (self.config.start.incarnation().0, Timed::since(started, ()));
        self.phases.offered(self.sink.as_mut(), learner, updated.version, &offer);
        let ends = updated.rollouts.iter().flat_map(|rollout| &rollout.ends);
        self.record.episodes.extend(&self.config.spec.env, ends.map(|end| &end.summary));
        for (&staleness, &n_rollouts) in &updated.report.staleness {
            *self.record.staleness.entry(staleness).or_default() += n_rollouts;
        }
        self.queue_evaluation(&updated.weights);
        self.report_progress(&updated);
        // Together with the record above: a checkpoint holds both, and they must be of the same update.
        self.state = updated.state;
        offered?;
        Ok(())
    }

    /// Returns whether the state after an update that has just ended is to be written.
    fn is_checkpoint_due(&self) -> bool {
        let (since, n_then) = self.last_checkpoint;
        let interval = self.config.checkpoint_interval;
        let is_due = self.version.0 >= self.config.settings.n_updates()
            || self.version.0 - n_then >= interval.updates
            || since.elapsed() >= interval.time;
        // While it fails, the clock says when to try again.
        is_due && self.saving.unsaved(Instant::now()).is_none()
    }

    /// Queues the newest policy to be evaluated, if its version is due.
    fn queue_evaluation(&mut self, weights: &Arc<[u8]>) {
        let Some(plan) = self.evaluations.as_ref().map(|it| it.plan) else { return };
        if plan.is_due(self.version) {
            let (version, weights) = (self.version, Arc::clone(weights));
            let TrainingRecord { episodes, held_out, .. } = &mut self.record;
            let policy = RatedPolicy { version, score: episodes.score(), held_out: None, weights };
            held_out.queue(&plan, policy, &episodes.means());
        }
    }

    /// Hands the next policy to the evaluating thread, if it is idle.
    fn evaluate(&mut self) {
        if let (Some(evaluations), Some(next)) =
            (&mut self.evaluations, self.record.held_out.next())
        {
            evaluations.thread.begin(next);
        }
    }

    fn report_progress(&mut self, updated: &Updated) {
        let n_steps = self.config.steps_per_update();
        let elapsed = std::mem::replace(&mut self.last_update, Instant::now()).elapsed();
        self.sink.on_update(&UpdateProgress {
            update: updated.report.clone(),
            n_updates: self.version.0,
            n_updates_total: self.config.settings.n_updates(),
            n_steps: self.version.0 * n_steps,
            steps_per_second: n_steps as f64 / elapsed.as_secs_f64().max(f64::EPSILON),
            phases: self.phases.take(),
            episodes: self.record.episodes.means(),
            held_out: self.record.held_out.history().last().copied(),
            n_actors: self.coordinator.n_actors(),
            n_queued: self.coordinator.n_pending() as usize,
            books: self.coordinator.books().clone(),
        });
        if let Some(update) = self.sink.bulletin() {
            self.bulletin.post(update);
        }
    }

    /// Carries out what the coordinator decided.
    fn act(&mut self) {
        for effect in self.coordinator.take_effects() {
            match effect {
                Effect::Event(event) => {
                    // At the door, not only in the coordinator: what is not accepted any more must take no place in the queue.
                    if let RunEvent::CutOff { actor, incarnation, .. } = &event {
                        self.link.cut_off(actor, *incarnation);
                    }
                    self.sink.on_event(&event);
                }
                Effect::Control { to, membership, control } => {
                    if !self.outbox.send(&to, membership, control) {
                        self.coordinator.silent(&to, membership);
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
        let TrainingRecord { episodes, held_out, .. } = &self.record;
        RatedPolicy { version, score: episodes.score(), held_out: held_out.of(version), weights }
    }

    /// Writes the state after the last finished update; one that is under way is not in it.
    fn checkpoint(&mut self) -> Result<(), Error> {
        let mut older = self.link.weights_since(self.oldest_needed());
        older.pop(); // The trainer's own.
        let older = older.into_iter();
        let older = older.map(|(version, weights)| RatedPolicy {
            version,
            score: None,
            held_out: None,
            weights,
        });
        let (state, record) = (self.state.clone(), self.record.clone());
        let identity = self.config.identity;
        let checkpoint =
            Checkpoint::of(&self.coordinator, state, identity, older.collect(), record);
        let (store, n_updates) = (&mut self.store, self.version.0);
        // Other tasks go on with other threads meanwhile: those that answer pulls and deliver orders.
        let write = || tokio::task::block_in_place(|| store.write(n_updates, &checkpoint));
        let written = Timed::measure(write);
        self.phases.checkpointed(self.sink.as_mut(), self.version, &written);
        let path = written.value?;
        self.last_checkpoint = (Instant::now(), n_updates);
        // After the checkpoint: no policy file is newer than what a resume goes on from.
        let last = self.last();
        let best = ending::best(&self.record, self.evaluations.as_ref(), &last);
        self.sink.on_policies(&last, best, self.record.held_out.history());
        self.sink.on_event(&RunEvent::CheckpointWritten { path, n_updates });
        Ok(())
    }

    fn health(&self) -> RunHealth {
        let now = Instant::now();
        RunHealth {
            n_actors: self.coordinator.n_answering(),
            has_enough_actors: self.coordinator.n_actors_needed().is_none(),
            n_envs_waiting: self.coordinator.n_envs_waiting(),
            n_queued: self.coordinator.n_pending() as usize,
            queued_bytes: self.link.n_queued_bytes(),
            unsaved: self.saving.unsaved(now),
            is_paused: self.saving.is_paused(now),
            refusals: self.coordinator.books().refusals.clone(),
        }
    }

    /// Writes a checkpoint; that it cannot be written is no reason to end the run.
    fn save(&mut self) -> Result<(), Error> {
        match self.checkpoint() {
            Err(Error::Checkpoint(error @ CheckpointError::Write { .. })) => {
                if self.saving.failed(Instant::now()) {
                    let (reason, retry) = (with_causes(&error), self.saving.retry());
                    self.sink.on_event(&RunEvent::CheckpointFailed { reason, retry });
                }
                Ok(())
            }
            written => self.recovered(written),
        }
    }

    /// Notes that a checkpoint could be written, if it could, and says so after failures.
    fn recovered(&mut self, written: Result<(), Error>) -> Result<(), Error> {
        if let (Ok(()), Some(unsaved)) = (&written, self.saving.succeeded(Instant::now())) {
            self.sink.on_event(&RunEvent::CheckpointRecovered { unsaved });
        }
        written
    }

    /// Tries again what could not be saved, and says when updates begin to wait for it.
    fn mind_the_disk(&mut self) -> Result<(), Error> {
        if self.saving.is_retry_due(Instant::now()) {
            self.save()?;
        }
        if let Some(unsaved) = self.saving.begins_to_pause(Instant::now()) {
            self.sink.on_event(&RunEvent::Paused { unsaved });
        }
        Ok(())
    }

    /// Saves the end of the run. If that fails, tries again until somebody insists on the end, or [`KEPT`] is over.
    async fn save_end(&mut self, stop: &RunStop) -> Result<(), Error> {
        let deadline = Instant::now() + KEPT;
        // Whoever asked the run to end did not ask for this to be given up; whoever asks now does.
        let had_insisted = stop.insist.is_cancelled();
        let mut is_told = false;
        loop {
            let written = self.checkpoint();
            let Err(Error::Checkpoint(error @ CheckpointError::Write { .. })) = &written else {
                return self.recovered(written);
            };
            self.saving.failed(Instant::now());
            if !std::mem::replace(&mut is_told, true) {
                let reason = with_causes(error);
                self.sink.on_event(&RunEvent::Unsaved { reason, kept: KEPT });
            }
            let is_given_up = stop.insist.is_cancelled() && !had_insisted;
            if is_given_up || Instant::now() >= deadline {
                return written;
            }
            self.sink.on_tick(&self.health());
            tokio::select! {
                () = tokio::time::sleep(TICK) => {}
                () = stop.insist.cancelled(), if !had_insisted => {}
            }
        }
    }

    /// Ends a run that is finished or was asked to stop. Where that fails nothing is left to do: its actors are dismissed, and what
    /// can be saved is saved.
    async fn end(
        &mut self,
        events: &flume::Receiver<LearnerEvent>,
        mut end: RunEnd,
        stop: &RunStop,
    ) -> Result<RunReport, Error> {
        self.sink.on_event(&RunEvent::Stopping);
        let reason = match end {
            RunEnd::Stopped => "the learner was asked to stop",
            RunEnd::Finished | RunEnd::AlreadyFinished => "the run is finished",
        };
        self.coordinator.stop_everyone(reason);
        self.act();
        let farewell = self.farewell(events).await;
        // After the farewell: until then the update under way may still end, and its rollouts are trained on.
        self.coordinator.close();
        self.save_end(stop).await?;
        farewell?;
        // The evaluations come after what was trained is safe: they may take long, and may be cut short.
        let health = self.health();
        if let (RunEnd::Finished, Some(evaluations), Some(_)) =
            (end, &mut self.evaluations, self.record.held_out.next())
        {
            let (record, sink) = (&mut self.record.held_out, self.sink.as_mut());
            if !evaluations.finish(record, sink, &stop.ask, &health).await {
                end = RunEnd::Stopped;
            }
            self.save_end(stop).await?;
        }
        let (books, builds) = (self.coordinator.books().clone(), self.coordinator.builds().clone());
        let (last, evaluations) = (self.last(), self.evaluations.as_ref());
        ending::report(&self.config, end, last, evaluations, self.record.clone(), books, builds)
    }

    /// Ends a run that has failed on its way. Its actors are dismissed: they would look for it until their time-out. What was trained
    /// until then is whole, and is saved, unless that is what failed.
    async fn fail(
        &mut self,
        error: &Error,
        events: &flume::Receiver<LearnerEvent>,
        stop: &RunStop,
    ) {
        self.coordinator.stop_everyone(&format!("the learner ended: {error}"));
        self.act();
        self.farewell(events).await.unwrap_or_else(|error| debug!(%error, "farewell failed"));
        if !matches!(error, Error::Checkpoint(_)) {
            self.coordinator.close();
            self.save_end(stop).await.unwrap_or_else(|error| warn!(%error, "the end is not saved"));
        }
    }

    /// Goes on listening until the actors have left and the update under way is done, or time is up; then returns the first error.
    async fn farewell(&mut self, events: &flume::Receiver<LearnerEvent>) -> Result<(), Error> {
        // The run's own token may be cancelled already, and would wake this loop without end.
        let never = CancellationToken::new();
        let mut ticks = interval(TICK);
        let deadline = tokio::time::Instant::now() + FAREWELL;
        let mut result = Ok(());
        while self.coordinator.n_actors() > 0 || self.is_training {
            let wake = self.next_wake(events, &mut ticks, &never);
            let Ok(wake) = tokio::time::timeout_at(deadline, wake).await else { break };
            // Whatever fails, the actors have still to be told.
            result = result.and(self.handle(wake?, events));
            self.evaluate();
            self.act();
        }
        result
    }
}

/// Waits for the evaluation under way; `None` if there is none.
async fn next_evaluated(evaluations: Option<&mut Evaluations>) -> Option<Evaluated> {
    let evaluations = evaluations.filter(|it| it.thread.is_busy())?;
    Some(evaluations.thread.evaluated().await)
}

/// Waits for time to pass or something from the network.
async fn tick_or_event(
    ticks: &mut Interval,
    events: &flume::Receiver<LearnerEvent>,
) -> Result<LearnerWake, Error> {
    Ok(tokio::select! {
        // The network may always have something to say; time passes all the same.
        biased;
        _ = ticks.tick() => LearnerWake::Tick,
        event = events.recv_async() => LearnerWake::Network(event.map_err(|_closed| Error::LinkGone)?),
    })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::fs;
    use std::path::{Path, PathBuf};
    use std::sync::Mutex;

    use leadtime_link::ListenSettings;
    use leadtime_proto::{ActorId, Incarnation};
    use tokio::time::interval_at;

    use super::*;
    use crate::HeldOutMeans;
    use crate::resume::tests::{batch, config};

    /// Remembers what happens, and clears the way for checkpoints once it is told that the end cannot be saved.
    struct Mender {
        in_the_way: PathBuf,
        heard: Arc<Mutex<Vec<RunEvent>>>,
    }

    impl ProgressSink for Mender {
        fn on_update(&mut self, _progress: &UpdateProgress) {}

        fn on_event(&mut self, event: &RunEvent) {
            if let RunEvent::Unsaved { .. } = event {
                fs::remove_file(&self.in_the_way).unwrap();
            }
            self.heard.lock().unwrap().push(event.clone());
        }

        fn on_policies(&mut self, _: &RatedPolicy, _: &RatedPolicy, _: &[HeldOutMeans]) {}

        fn on_held_out(&mut self, _history: &[HeldOutMeans]) {}
    }

    /// Begins a run of one update in a directory; returns it with what its sink will hear.
    async fn begun(directory: &Path) -> (RunLoop, Arc<Mutex<Vec<RunEvent>>>) {
        let endpoint = format!("unixsock-stream/{}", directory.join("z.sock").display());
        let listen = ListenSettings::new(vec![endpoint.parse().unwrap()]);
        let checkpoints = directory.join("checkpoints");
        let config = LearnerConfig { listen, checkpoints: checkpoints.clone(), ..config() };
        let mut store = CheckpointStore::open(&checkpoints, config.retention).unwrap();
        let point = resume::begin(&config, &mut store).unwrap();
        let (run, domain) = (&config.run, &config.spec.task.domain);
        let opened = LearnerLink::open(run, domain, &config.start, &config.listen).await;
        let (link, _events) = opened.unwrap();
        let heard = Arc::default();
        let sink = Mender { in_the_way: checkpoints, heard: Arc::clone(&heard) };
        (RunLoop::new(config, store, Box::new(sink), point, link, None).unwrap(), heard)
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn an_update_whose_weights_cannot_be_announced_ends_the_run_and_is_saved() {
        let directory = tempfile::tempdir().unwrap();
        let (mut run, _heard) = begun(directory.path()).await;
        run.link.close().await.unwrap();
        run.training.begin(batch(&run.config), BTreeSet::new()).unwrap();
        let updated = run.training.updated().await.unwrap();
        let error = run.trained(updated).unwrap_err();
        assert!(matches!(error, Error::Link(_)), "{error}");
        run.save_end(&RunStop::default()).await.unwrap();
        let saved = run.store.newest::<Checkpoint>().unwrap().unwrap().state;
        // The state and the record of the run are of the same update.
        let n_rollouts: u64 = saved.record.staleness.values().sum();
        assert_eq!((saved.trainer.version(), n_rollouts), (PolicyVersion(1), 2));
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn an_end_that_can_be_saved_after_all_is_saved_and_that_is_told() {
        use RunEvent::{CheckpointRecovered, CheckpointWritten, Unsaved};
        let directory = tempfile::tempdir().unwrap();
        let (mut run, heard) = begun(directory.path()).await;
        let checkpoints = directory.path().join("checkpoints");
        fs::rename(&checkpoints, directory.path().join("away")).unwrap();
        fs::write(&checkpoints, "in the way").unwrap();
        run.save_end(&RunStop::default()).await.unwrap();
        let heard = heard.lock().unwrap();
        let is_told = matches!(
            &heard[..],
            [Unsaved { .. }, CheckpointWritten { .. }, CheckpointRecovered { .. }]
        );
        assert!(is_told, "{heard:?}");
        assert!(run.saving.unsaved(Instant::now()).is_none());
    }

    #[tokio::test]
    async fn a_flood_from_the_network_does_not_stop_the_clock() {
        let (flood, events) = flume::bounded(100);
        let actor = ActorId::new("a").unwrap();
        while flood.try_send(LearnerEvent::Joined(actor.clone(), Incarnation(1))).is_ok() {}
        // A tick is due, and the next one is not.
        let mut ticks = interval_at(Instant::now().checked_sub(TICK).unwrap().into(), TICK);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let wake = tick_or_event(&mut ticks, &events).await.unwrap();
        assert!(matches!(wake, LearnerWake::Tick), "{wake:?}");
        let wake = tick_or_event(&mut ticks, &events).await.unwrap();
        assert!(matches!(wake, LearnerWake::Network(_)), "{wake:?}");
    }
}
