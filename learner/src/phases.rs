//! Where the learner's time goes: measured once, reported twice, as sums per update and as spans of a trace.
//!
//! ```text
//! train      │ wait for the loop │ update v+1               │ wait for rollouts │ update v+2
//!            │                   │ batch │ epochs │         │                   │ batch │ epochs │
//! loop       │ weights v         │ checkpoint v │           │ weights v+1       │
//! evaluate   │                   │ evaluate v                                   │
//! ```
//!
//! A wait is named after what came last: until then nothing else would have helped.

use std::time::Instant;

use leadtime_proto::PolicyVersion;
use leadtime_trace::{ArrowEnd, SpanCategory, Timed, TraceArrow, TraceSpan, TraceTrack};

use crate::report::{PhaseTimes, ProgressSink};
use crate::training::Updated;

const TRAIN: TraceTrack = TraceTrack::Thread("train");
const LOOP: TraceTrack = TraceTrack::Thread("loop");
const EVALUATE: TraceTrack = TraceTrack::Thread("evaluate");

/// What the training thread waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TrainingWait {
    /// A rollout of an environment is missing.
    Rollouts,
    /// Too many policies wait to be evaluated.
    Evaluation,
    /// Nothing can be saved.
    Disk,
    /// The loop has the next batch and is busy with the last update.
    Loop,
}

impl TrainingWait {
    fn name(self) -> &'static str {
        match self {
            Self::Rollouts => "wait for rollouts",
            Self::Evaluation => "wait for an evaluation",
            Self::Disk => "wait for the disk",
            Self::Loop => "wait for the loop",
        }
    }
}

/// Measures where the time since the last update went so far.
#[derive(Debug)]
pub(crate) struct PhaseClock {
    times: PhaseTimes,
    /// The time from which on the trainer's idle time has not been reported; `None` while it trains.
    idle_since: Option<Instant>,
    waits_for: TrainingWait,
    /// The rollout that came last.
    newest: Option<TraceArrow>,
    /// The one that ended the wait for the update under way.
    released_by: Option<TraceArrow>,
}

impl PhaseClock {
    /// Starts with a trainer that has nothing to do.
    pub(crate) fn start() -> Self {
        Self {
            times: PhaseTimes::default(),
            idle_since: Some(Instant::now()),
            waits_for: TrainingWait::Rollouts,
            newest: None,
            released_by: None,
        }
    }

    /// Notes a rollout that has come.
    pub(crate) fn arrived(&mut self, rollout: TraceArrow) {
        self.newest = Some(rollout);
    }

    /// Notes why no update can begin.
    pub(crate) fn waits_for(&mut self, what: TrainingWait) {
        self.waits_for = what;
    }

    /// Notes that an update begins now, before the training thread gets its batch.
    pub(crate) fn begins(&mut self, sink: &mut dyn ProgressSink) {
        self.waited(sink, Instant::now());
        self.idle_since = None;
        self.released_by = self.newest.filter(|_| self.waits_for == TrainingWait::Rollouts);
    }

    /// Notes an update that is done.
    pub(crate) fn trained(&mut self, sink: &mut dyn ProgressSink, updated: &Updated) {
        self.times.train = updated.took;
        (self.idle_since, self.waits_for) = (Some(Instant::now()), TrainingWait::Loop);
        let (rollouts, report) = (&updated.rollouts, &updated.report);
        let args = [
            ("version", updated.version.0),
            ("iteration", rollouts.iter().map(|it| it.iteration.0).min().unwrap_or(0)),
            ("staleness", report.staleness.keys().copied().max().unwrap_or(0)),
            ("rollouts", rollouts.len() as u64),
            ("samples", report.n_samples),
            ("epochs", report.n_epochs),
        ];
        let update = Timed { value: (), start: updated.started, duration: updated.took };
        let span = TraceSpan::of(TRAIN, SpanCategory::Work, "update", &update).with(&args);
        sink.on_span(&span.linked(self.released_by.map(ArrowEnd::To)));
        let mut start = updated.started;
        for &(part, end) in &updated.parts {
            let part_of = Timed { value: (), start, duration: end - start };
            sink.on_span(&TraceSpan::of(TRAIN, SpanCategory::Detail, part, &part_of));
            start = end;
        }
    }

    /// Notes that new weights were put on offer by this start of the learner.
    pub(crate) fn offered<T>(
        &mut self,
        sink: &mut dyn ProgressSink,
        learner: u64,
        version: PolicyVersion,
        offer: &Timed<T>,
    ) {
        self.times.weights = offer.duration;
        let args = [("version", version.0)];
        let arrow = ArrowEnd::From(TraceArrow::of_weights(learner, version.0));
        let span = TraceSpan::of(LOOP, SpanCategory::Work, "weights", offer).with(&args);
        sink.on_span(&span.linked(Some(arrow)));
    }

    /// Notes a checkpoint that was written, or could not be; a trainer that is idle had to wait for it, too.
    pub(crate) fn checkpointed<T>(
        &mut self,
        sink: &mut dyn ProgressSink,
        version: PolicyVersion,
        written: &Timed<T>,
    ) {
        self.times.checkpoint += written.duration;
        let args = [("version", version.0)];
        let span = TraceSpan::of(LOOP, SpanCategory::Work, "checkpoint", written).with(&args);
        sink.on_span(&span);
        if self.idle_since.is_some() {
            self.waited(sink, written.start);
            let name = "wait for the checkpoint";
            sink.on_span(&TraceSpan::of(TRAIN, SpanCategory::Wait, name, written));
            self.idle_since = Some(written.start + written.duration);
        }
    }

    /// Takes the times since the last update, and starts over.
    pub(crate) fn take(&mut self) -> PhaseTimes {
        std::mem::take(&mut self.times)
    }

    /// Notes idle time up to a moment.
    fn waited(&mut self, sink: &mut dyn ProgressSink, until: Instant) {
        let Some(start) = self.idle_since else { return };
        let wait = Timed { value: (), start, duration: until.saturating_duration_since(start) };
        self.times.wait += wait.duration;
        let name = self.waits_for.name();
        sink.on_span(&TraceSpan::of(TRAIN, SpanCategory::Wait, name, &wait));
    }
}

/// Reports a policy's evaluation on held-out episodes.
pub(crate) fn evaluated<T>(
    sink: &mut dyn ProgressSink,
    version: PolicyVersion,
    n_episodes: usize,
    evaluation: &Timed<T>,
) {
    let args = [("version", version.0), ("episodes", n_episodes as u64)];
    sink.on_span(&TraceSpan::of(EVALUATE, SpanCategory::Work, "evaluate", evaluation).with(&args));
}
