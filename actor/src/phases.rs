//! Where an actor's time goes, as spans of a trace: one of each kind per rollout of its environments, none per step.
//!
//! ```text
//! collect    │ wait for weights │ rollouts of iteration i            │ wait for credit │ rollouts of ...
//!            │                  │ infer     │ simulate      │ encode │
//! publish    │                  │                                    │ publish │ publish │
//! pull       │  weights v       │
//! ```
//!
//! Inference and simulation alternate with every step; within a rollout their sums are drawn one after the other.

use leadtime_proto::{Header, PolicyVersion};
use leadtime_trace::{ArrowEnd, SpanCategory, Timed, TraceArrow, TraceSpan, TraceTrack};

use crate::collect::Collected;
use crate::sink::ActorSink;

const COLLECT: TraceTrack = TraceTrack::Thread("collect");
const RESTORE: TraceTrack = TraceTrack::Thread("restore");
const PUBLISH: TraceTrack = TraceTrack::Thread("publish");
const PULL: TraceTrack = TraceTrack::Tasks("pull");

/// What the collecting thread waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CollectWait {
    /// A learner that was lost.
    Learner,
    /// It has no environments to step.
    Environments,
    /// The learner takes no more rollouts for now.
    Credit,
    /// The weights to act with are not here.
    Weights,
    /// The actor's loop has the next job and has not handed it over.
    Loop,
}

impl CollectWait {
    fn name(self) -> &'static str {
        match self {
            Self::Learner => "wait for the learner",
            Self::Environments => "wait for environments",
            Self::Credit => "wait for credit",
            Self::Weights => "wait for weights",
            Self::Loop => "wait for the loop",
        }
    }
}

/// Reports a job of the collecting thread, the wait before it, and what ended that wait.
pub(crate) fn collected(
    sink: &mut dyn ActorSink,
    collected: &Collected,
    waited_for: CollectWait,
    learner: u64,
) {
    let Collected { times, started, made, rollouts, .. } = collected;
    let mut at = started.checked_sub(times.wait).unwrap_or(*started);
    let mut lap = |category, name, duration| {
        let span =
            TraceSpan::of(COLLECT, category, name, &Timed { value: (), start: at, duration });
        at += duration;
        span
    };
    sink.on_span(&lap(SpanCategory::Wait, waited_for.name(), times.wait));
    let Some((iteration, version)) = made else {
        return sink.on_span(&lap(SpanCategory::Work, "adopt", times.adopt));
    };
    let parts = [("infer", times.infer), ("simulate", times.simulate), ("encode", times.encode)];
    let duration = parts.iter().map(|(_, took)| *took).sum();
    let args =
        [("iteration", iteration.0), ("version", version.0), ("rollouts", rollouts.len() as u64)];
    let all = Timed { value: (), start: *started, duration };
    let arrow = (waited_for == CollectWait::Weights)
        .then(|| ArrowEnd::To(TraceArrow::of_weights(learner, version.0)));
    let frame = TraceSpan::of(COLLECT, SpanCategory::Detail, "rollouts", &all);
    sink.on_span(&frame.with(&args).linked(arrow));
    for (name, took) in parts {
        sink.on_span(&lap(SpanCategory::Work, name, took));
    }
}

/// Reports that environments were made ready.
pub(crate) fn restored<T>(sink: &mut dyn ActorSink, restored: &Timed<T>) {
    sink.on_span(&TraceSpan::of(RESTORE, SpanCategory::Work, "restore", restored));
}

/// Reports a rollout that was handed to the network.
pub(crate) fn published<T>(
    sink: &mut dyn ActorSink,
    header: &Header,
    n_bytes: usize,
    published: &Timed<T>,
) {
    let Header { incarnation, sequence, version, .. } = header;
    let args = [("sequence", sequence.0), ("version", version.0), ("bytes", n_bytes as u64)];
    let arrow = ArrowEnd::From(TraceArrow::of_rollout(incarnation.0, sequence.0));
    let span = TraceSpan::of(PUBLISH, SpanCategory::Work, "publish", published).with(&args);
    sink.on_span(&span.linked(Some(arrow)));
}

/// Reports weights that were pulled, or could not be.
pub(crate) fn pulled<T, E>(
    sink: &mut dyn ActorSink,
    version: PolicyVersion,
    pulled: &Timed<Result<T, E>>,
) {
    let name = if pulled.value.is_ok() { "weights" } else { "weights that did not come" };
    let args = [("version", version.0)];
    sink.on_span(&TraceSpan::of(PULL, SpanCategory::Work, name, pulled).with(&args));
}
