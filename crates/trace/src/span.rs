//! What is reported: a stretch of time that a thread spent on one thing.

use std::time::{Duration, Instant};

use crate::arrow::TraceArrow;
use crate::timed::Timed;

/// Where a span is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TraceTrack {
    /// On a thread's own line: its spans lie one after the other, or one inside another.
    Thread(&'static str),
    /// Among tasks of this kind, of which several are under way at once.
    Tasks(&'static str),
}

/// What a span counts as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SpanCategory {
    /// The thread had nothing to do.
    Wait,
    /// It worked. Waits and work of a track never overlap.
    Work,
    /// A part of work, or a frame around it: shown, but not counted once more.
    Detail,
}

impl SpanCategory {
    /// Returns the name that it has in the file.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Wait => "wait",
            Self::Work => "work",
            Self::Detail => "detail",
        }
    }
}

/// One end of an arrow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArrowEnd {
    /// It begins at the span.
    From(TraceArrow),
    /// It ends there. An arrow may end at several spans, or at none.
    To(TraceArrow),
}

/// A stretch of time that a thread spent on one thing.
#[derive(Clone, Copy, Debug)]
pub struct TraceSpan<'a> {
    /// Where it is drawn.
    pub track: TraceTrack,
    /// What it counts as.
    pub category: SpanCategory,
    /// What was done, or waited for. No character in it needs escaping in JSON.
    pub name: &'static str,
    /// The instant at which it began.
    pub start: Instant,
    /// How long it lasted.
    pub duration: Duration,
    /// Numbers that distinguish it from others of its name: a version, an iteration. As to names, see `name`.
    pub args: &'a [(&'static str, u64)],
    /// The arrow that begins or ends at it.
    pub arrow: Option<ArrowEnd>,
}

impl TraceSpan<'static> {
    /// Makes a span of what was measured, without numbers.
    pub fn of<T>(
        track: TraceTrack,
        category: SpanCategory,
        name: &'static str,
        timed: &Timed<T>,
    ) -> Self {
        let (start, duration) = (timed.start, timed.duration);
        Self { track, category, name, start, duration, args: &[], arrow: None }
    }
}

impl TraceSpan<'_> {
    /// Gives it numbers, by name.
    pub fn with<'a>(self, args: &'a [(&'static str, u64)]) -> TraceSpan<'a> {
        TraceSpan { args, ..self }
    }

    /// Lets an arrow begin or end at it.
    pub fn linked(self, arrow: Option<ArrowEnd>) -> Self {
        Self { arrow, ..self }
    }
}
