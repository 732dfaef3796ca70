//! Traces: what every thread of a run's processes did when, as a timeline that Perfetto and Chrome open.
//!
//! What this crate does not know: actors, learners, files by name, the wall clock.
//!
//! ```text
//! learner ── TraceSpan ──> TraceWriter ──┐
//! actor   ── TraceSpan ──> TraceWriter ──┼── appended to one file ──> TraceSummary: who waited for whom
//! actor   ── TraceSpan ──> TraceWriter ──┘
//! ```
//!
//! A process reports its spans per rollout and per update, never per step. What measures always reports them, to a sink
//! that ignores them unless a trace is asked for.
//!
//! # Where to start
//!
//! [`TraceSpan`] is what is reported; [`TraceWriter`] has the format and its limit.

mod arrow;
mod clock;
mod span;
mod summary;
mod timed;
mod writer;

pub use arrow::TraceArrow;
pub use clock::TraceClock;
pub use span::{ArrowEnd, SpanCategory, TraceSpan, TraceTrack};
pub use summary::{RoleSummary, TraceSummary, TrackSummary};
pub use timed::Timed;
pub use writer::{CLOSING, MAX_BYTES, TraceProcess, TraceWriter, opening};
