//! Refused messages in the log: anybody can send as many as they like, so each kind with its cause has one line a minute.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use leadtime_proto::{Refusal, RefusalCause};
use tracing::{debug, warn};

use crate::lock::lock;

/// Shortest pause between two such lines about the same.
const LINE_EVERY: Duration = Duration::from_mins(1);

/// When lines were written, and how many messages were refused since.
#[derive(Debug, Default)]
pub(crate) struct ToldRefusals(Mutex<BTreeMap<(&'static str, RefusalCause), RareLine>>);

/// A line of the log that others can cause as often as they like: when it was written last, and how often there was reason for it
/// since.
#[derive(Debug, Default)]
pub struct RareLine {
    at: Option<Instant>,
    n: u64,
    /// How many more lines there may be in the minute that the first one begins, and how many there were.
    n_more: u32,
    n_told: u32,
}

impl RareLine {
    /// Makes one for what is rightly told every time while it happens no more often than this in a minute.
    pub fn of_many(n_lines: u32) -> Self {
        Self { n_more: n_lines.saturating_sub(1), ..Self::default() }
    }

    /// Counts one more, and returns how many there were since the last line if it is time for another: once a minute, or as often as
    /// it was made for.
    pub fn next(&mut self, now: Instant) -> Option<u64> {
        self.n += 1;
        if self.at.is_none_or(|at| now.saturating_duration_since(at) >= LINE_EVERY) {
            (self.at, self.n_told) = (Some(now), 0);
        } else if self.n_told < self.n_more {
            self.n_told += 1;
        } else {
            return None;
        }
        Some(std::mem::take(&mut self.n))
    }

    /// Does the same, and returns what a line ends with: how often there was reason for one since the last, if not only now.
    pub fn suffix(&mut self, now: Instant) -> Option<String> {
        let n = self.next(now)?;
        Some(if n > 1 { format!(" ({n} times since the last line)") } else { String::new() })
    }
}

impl ToldRefusals {
    /// Logs that a message of this kind was refused, as a warning if it is time for one.
    pub(crate) fn tell(&self, kind: &'static str, refusal: &Refusal) {
        match self.count(kind, refusal.cause, Instant::now()) {
            None => debug!(kind, %refusal, "message refused"),
            Some(n) => warn!(kind, n, %refusal, "message refused"),
        }
    }

    /// Counts one more, and returns how many there were if it is time for a line.
    fn count(&self, kind: &'static str, cause: RefusalCause, now: Instant) -> Option<u64> {
        lock(&self.0).entry((kind, cause)).or_default().next(now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_written_once_a_minute_with_its_number() {
        let mut counted = RareLine::default();
        let start = Instant::now();
        let at = |seconds| start + Duration::from_secs(seconds);
        assert_eq!([0, 1, 59, 60].map(|s| counted.next(at(s))), [Some(1), None, None, Some(3)]);
    }

    #[test]
    fn what_is_told_every_time_is_counted_once_it_is_a_flood() {
        let (mut counted, start) = (RareLine::of_many(3), Instant::now());
        let mut at = |seconds| counted.next(start + Duration::from_secs(seconds));
        let told = [0, 1, 2, 3, 4, 61, 62].map(&mut at);
        assert_eq!(told, [Some(1), Some(1), Some(1), None, None, Some(3), Some(1)]);
        let flood = (0..6_000).filter(|i| at(1_000 + i / 100).is_some());
        assert_eq!(flood.count(), 3);
    }

    #[test]
    fn a_thousand_refused_messages_are_two_lines_in_the_minute_and_another_cause_has_its_own() {
        let (told, start) = (ToldRefusals::default(), Instant::now());
        let count = |cause, ms| {
            told.count("announcement", cause, start + Duration::from_millis(ms)).map(|n| (ms, n))
        };
        let lines: Vec<(u64, u64)> =
            (0..1_000).filter_map(|i| count(RefusalCause::Proof, 61 * i)).collect();
        assert_eq!(lines, [(0, 1), (61 * 984, 984)]);
        assert_eq!(count(RefusalCause::Malformed, 1), Some((1, 1)));
        assert_eq!(told.count("credit", RefusalCause::Proof, start), Some(1));
    }
}
