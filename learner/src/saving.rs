//! What to do while the newest state cannot be saved: continue, try again, and finally wait for room.
//!
//! ```text
//! failed ── training goes on, a try every RETRY ── patience is over: no further update ── saved: as before
//! ```
//!
//! A full disk is no reason to lose what was learned since the last checkpoint. Pure: the time is handed in.

use std::time::{Duration, Instant};

/// Pause between two tries to write a checkpoint; shorter where the patience is.
const RETRY: Duration = Duration::from_secs(30);
/// The shortest pause between two tries.
const MIN_RETRY: Duration = Duration::from_millis(500);

/// Why and since when the newest state is not on the disk.
#[derive(Clone, Copy, Debug)]
struct Failing {
    since: Instant,
    retry_at: Instant,
    /// Whether it was reported that no further update is begun.
    told_pause: bool,
}

/// Whether checkpoints can be written at present.
#[derive(Debug)]
pub(crate) struct Saving {
    patience: Duration,
    failing: Option<Failing>,
}

impl Saving {
    /// Starts with a disk that is believed to work; training goes on for `patience` once it does not.
    pub(crate) fn new(patience: Duration) -> Self {
        Self { patience, failing: None }
    }

    /// Returns the pause between two tries.
    pub(crate) fn retry(&self) -> Duration {
        RETRY.min(self.patience).max(MIN_RETRY)
    }

    /// Notes a failure. Returns whether it is the first one in a row: worth a line in the log.
    pub(crate) fn failed(&mut self, now: Instant) -> bool {
        let retry_at = now + self.retry();
        let is_first = self.failing.is_none();
        let fresh = Failing { since: now, retry_at, told_pause: false };
        self.failing.get_or_insert(fresh).retry_at = retry_at;
        is_first
    }

    /// Notes that the state is saved. Returns for how long it could not be, if it could not.
    pub(crate) fn succeeded(&mut self, now: Instant) -> Option<Duration> {
        self.failing.take().map(|failing| now.duration_since(failing.since))
    }

    /// Returns for how long the newest state could not be saved; `None` if it can be.
    pub(crate) fn unsaved(&self, now: Instant) -> Option<Duration> {
        self.failing.map(|failing| now.duration_since(failing.since))
    }

    /// Returns whether a try that failed should be repeated now.
    pub(crate) fn is_retry_due(&self, now: Instant) -> bool {
        self.failing.is_some_and(|failing| now >= failing.retry_at)
    }

    /// Returns whether updates wait until the state can be saved.
    pub(crate) fn is_paused(&self, now: Instant) -> bool {
        self.unsaved(now).is_some_and(|unsaved| unsaved >= self.patience)
    }

    /// Returns for how long nothing could be saved when updates begin to wait for it; once per failure.
    pub(crate) fn begins_to_pause(&mut self, now: Instant) -> Option<Duration> {
        let unsaved = self.unsaved(now).filter(|_| self.is_paused(now))?;
        let failing = self.failing.as_mut()?;
        (!std::mem::replace(&mut failing.told_pause, true)).then_some(unsaved)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_is_told_once_and_tried_again_until_patience_ends() {
        let start = Instant::now();
        let at = |seconds| start + Duration::from_secs(seconds);
        let mut saving = Saving::new(Duration::from_mins(10));
        assert!(!saving.is_retry_due(at(0)) && saving.unsaved(at(0)).is_none());
        assert!(saving.failed(at(0)));
        assert!(!saving.is_retry_due(at(29)) && saving.is_retry_due(at(30)));
        assert!(!saving.failed(at(30)), "told before");
        assert!(!saving.is_retry_due(at(59)) && saving.is_retry_due(at(60)));
        assert!(!saving.is_paused(at(599)) && saving.begins_to_pause(at(599)).is_none());
        assert!(saving.is_paused(at(600)));
        assert_eq!(saving.begins_to_pause(at(600)), Some(Duration::from_mins(10)));
        assert_eq!(saving.begins_to_pause(at(601)), None, "told before");
        assert_eq!(saving.succeeded(at(630)), Some(Duration::from_secs(630)));
        assert!(!saving.is_paused(at(9_999)) && saving.succeeded(at(9_999)).is_none());
        assert!(saving.failed(at(10_000)), "another failure");
    }

    #[test]
    fn little_patience_tries_more_often() {
        let (now, mut saving) = (Instant::now(), Saving::new(Duration::from_secs(1)));
        saving.failed(now);
        assert!(saving.is_retry_due(now + Duration::from_secs(1)));
        assert!(Saving::new(Duration::ZERO).retry() >= MIN_RETRY);
    }
}
