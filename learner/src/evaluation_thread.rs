//! The thread that evaluates policies on held-out episodes, so that neither the loop nor training waits for them.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::Instant;

use leadtime_ppo::LearnerSettings;
use leadtime_trace::Timed;
use tokio::sync::mpsc;
use tokio::time::MissedTickBehavior;
use tokio_util::sync::CancellationToken;

use crate::Error;
use crate::coordinator::TICK;
use crate::held_out::{HeldOutEpisode, HeldOutEvaluation, PolicyEvaluator};
use crate::held_out_record::{EvaluationPlan, HeldOutRecord, WaitingPolicy};
use crate::phases;
use crate::report::{ProgressSink, RunEvent, RunHealth};

/// One policy and one result may be under way.
const DEPTH: usize = 1;

/// The result of an evaluation: its episodes, or half a sentence that says why there are none.
pub(crate) type Evaluated = Timed<Result<Vec<HeldOutEpisode>, String>>;

/// The loop's end of the evaluating thread; dropping it ends the evaluation under way.
#[derive(Debug)]
pub(crate) struct EvaluationThread {
    waiting: SyncSender<WaitingPolicy>,
    evaluated: mpsc::Receiver<Evaluated>,
    is_stopped: Arc<AtomicBool>,
    is_busy: bool,
}

impl EvaluationThread {
    /// Starts the thread that plays the episodes.
    pub(crate) fn start(evaluator: Box<dyn PolicyEvaluator>) -> Result<Self, Error> {
        let (waiting, inbox) = sync_channel(DEPTH);
        let (outbox, evaluated) = mpsc::channel(DEPTH);
        let is_stopped = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&is_stopped);
        thread::Builder::new()
            .name("learner-evaluate".to_owned())
            .spawn(move || work(evaluator, &inbox, &outbox, &stopped))
            .map_err(Error::Thread)?;
        Ok(Self { waiting, evaluated, is_stopped, is_busy: false })
    }

    /// Returns whether an evaluation is under way.
    pub(crate) fn is_busy(&self) -> bool {
        self.is_busy
    }

    /// Begins the evaluation of a policy, unless another one is under way.
    pub(crate) fn begin(&mut self, policy: &WaitingPolicy) {
        if !self.is_busy {
            // The queue is empty. A thread that is gone has closed it, which `evaluated` reports.
            drop(self.waiting.try_send(policy.clone()));
            self.is_busy = true;
        }
    }

    /// Waits for the end of the evaluation under way.
    pub(crate) async fn evaluated(&mut self) -> Evaluated {
        let evaluated = self.evaluated.recv().await;
        self.is_busy = false;
        let gone = || Timed::measure(|| Err("the thread that evaluates is gone".to_owned()));
        evaluated.unwrap_or_else(gone)
    }
}

impl Drop for EvaluationThread {
    fn drop(&mut self) {
        self.is_stopped.store(true, Ordering::Relaxed);
    }
}

fn work(
    mut evaluator: Box<dyn PolicyEvaluator>,
    inbox: &Receiver<WaitingPolicy>,
    outbox: &mpsc::Sender<Evaluated>,
    is_stopped: &AtomicBool,
) {
    let stopped = || is_stopped.load(Ordering::Relaxed);
    while let Ok(WaitingPolicy { policy, n_episodes }) = inbox.recv() {
        let started = Instant::now();
        let evaluated = match evaluator.evaluate(&policy.weights, n_episodes, &stopped) {
            Ok(Some(episodes)) => Ok(episodes),
            Ok(None) => return, // Nobody waits for it.
            Err(error) => Err(error.to_string()),
        };
        if outbox.blocking_send(Timed::since(started, evaluated)).is_err() {
            return;
        }
    }
}

/// A run's evaluations: which, and by whom.
#[derive(Debug)]
pub(crate) struct Evaluations {
    pub(crate) plan: EvaluationPlan,
    pub(crate) thread: EvaluationThread,
}

impl Evaluations {
    /// Plans the evaluations of a run and starts their thread.
    pub(crate) fn start(
        evaluation: HeldOutEvaluation,
        settings: &LearnerSettings,
    ) -> Result<Self, Error> {
        let HeldOutEvaluation { n_evaluations, max_episodes, stop_at, episodes, evaluator } =
            evaluation;
        let n_updates = settings.n_updates();
        let n_steps = n_updates * settings.n_envs as u64 * settings.n_steps as u64;
        let plan =
            EvaluationPlan { n_evaluations, max_episodes, stop_at, episodes, n_updates, n_steps };
        Ok(Self { plan, thread: EvaluationThread::start(evaluator)? })
    }

    /// Evaluates every policy that waits, telling how the run stands meanwhile. Returns false if it was asked to stop
    /// before.
    pub(crate) async fn finish(
        &mut self,
        record: &mut HeldOutRecord,
        sink: &mut dyn ProgressSink,
        stop: &CancellationToken,
        health: &RunHealth,
    ) -> bool {
        let mut ticks = tokio::time::interval(TICK);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        sink.on_event(&RunEvent::Evaluating);
        while let Some(next) = record.next() {
            self.thread.begin(next);
            tokio::select! {
                biased;
                () = stop.cancelled() => return false,
                _ = ticks.tick() => sink.on_tick(health),
                evaluated = self.thread.evaluated() => take_in(&self.plan, evaluated, record, sink),
            }
        }
        true
    }
}

/// Notes what the policy that was next did, or that it could not be evaluated.
pub(crate) fn take_in(
    plan: &EvaluationPlan,
    evaluated: Evaluated,
    record: &mut HeldOutRecord,
    sink: &mut dyn ProgressSink,
) {
    let Some(version) = record.next().map(|next| next.policy.version) else { return };
    let n_episodes = evaluated.value.as_ref().map_or(0, Vec::len);
    phases::evaluated(sink, version, n_episodes, &evaluated);
    match evaluated.value {
        Ok(episodes) => {
            record.take_in(plan, &episodes);
            sink.on_held_out(record.history());
        }
        Err(reason) => {
            record.take_in(plan, &[]);
            sink.on_event(&RunEvent::EvaluationFailed { version, reason });
        }
    }
}
