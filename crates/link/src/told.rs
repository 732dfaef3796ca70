//! Refused messages in the log: anybody can send as many as they like, so each kind with its cause has one line a minute.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use leadtime_proto::{Refusal, RefusalCause};
use tracing::{debug, warn};

use crate::lock::lock;

/// Shortest pause between two lines about one kind of message and one cause.
const LINE_EVERY: Duration = Duration::from_mins(1);

/// When lines were written, and how many messages were refused since.
#[derive(Debug, Default)]
pub(crate) struct ToldRefusals(Mutex<BTreeMap<(&'static str, RefusalCause), ToldLine>>);

/// The last line about one kind of message and one cause.
#[derive(Debug)]
struct ToldLine {
    at: Instant,
    n_since: u64,
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
        let mut told = lock(&self.0);
        let Some(line) = told.get_mut(&(kind, cause)) else {
            told.insert((kind, cause), ToldLine { at: now, n_since: 0 });
            return Some(1);
        };
        line.n_since += 1;
        if now.saturating_duration_since(line.at) < LINE_EVERY {
            return None;
        }
        line.at = now;
        Some(std::mem::take(&mut line.n_since))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
