//! Whether a process is well: what a probe asks, answered from atomics.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// How long the main loop may take to go round once.
const LOOP_TIME: Duration = Duration::from_secs(10);
/// How long a process may take to begin its loop: it reads its files, and looks for its peers.
const START_TIME: Duration = Duration::from_mins(2);

/// A moment, or none yet, as milliseconds since a start; 0: none.
#[derive(Debug)]
pub(crate) struct Occasion {
    start: Instant,
    millis: AtomicU64,
}

impl Occasion {
    pub(crate) fn never(start: Instant) -> Self {
        Self { start, millis: AtomicU64::new(0) }
    }

    pub(crate) fn note(&self) {
        let millis = self.start.elapsed().as_millis() as u64;
        self.millis.store(millis.max(1), Ordering::Relaxed);
    }

    /// Returns the time since then; `None` if it was never.
    pub(crate) fn elapsed(&self) -> Option<Duration> {
        let millis = self.millis.load(Ordering::Relaxed);
        (millis > 0).then(|| self.start.elapsed().saturating_sub(Duration::from_millis(millis)))
    }
}

/// Whether the main loop goes round.
#[derive(Debug)]
pub(crate) struct Liveness {
    start: Instant,
    last_tick: Occasion,
    is_ending: AtomicBool,
}

impl Liveness {
    pub(crate) fn new() -> Arc<Self> {
        let start = Instant::now();
        let (last_tick, is_ending) = (Occasion::never(start), AtomicBool::new(false));
        Arc::new(Self { start, last_tick, is_ending })
    }

    /// Returns when the process began to be watched.
    pub(crate) fn start(&self) -> Instant {
        self.start
    }

    /// Notes that the loop went round.
    pub(crate) fn tick(&self) {
        self.last_tick.note();
    }

    /// Notes that the loop is over; what follows takes as long as it takes.
    pub(crate) fn end(&self) {
        self.is_ending.store(true, Ordering::Relaxed);
    }

    /// Tells whether the loop is over.
    pub(crate) fn is_ending(&self) -> bool {
        self.is_ending.load(Ordering::Relaxed)
    }

    /// Says what is wrong, if anything is.
    pub(crate) fn check(&self) -> Result<(), String> {
        let (silent, limit) = match self.last_tick.elapsed() {
            Some(silent) => (silent, LOOP_TIME),
            None => (self.start.elapsed(), START_TIME),
        };
        if self.is_ending() || silent <= limit {
            return Ok(());
        }
        Err(format!("the main loop has not gone round for {} s", silent.as_secs()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn started(ago: Duration) -> Liveness {
        let start = Instant::now().checked_sub(ago).unwrap();
        Liveness { start, last_tick: Occasion::never(start), is_ending: AtomicBool::new(false) }
    }

    #[test]
    fn a_loop_that_stands_still_is_not_alive() {
        let liveness = started(Duration::from_mins(1));
        liveness.check().expect("it may take its time to start");
        liveness.last_tick.millis.store(45_000, Ordering::Relaxed);
        let wrong = liveness.check().unwrap_err();
        assert_eq!(wrong, "the main loop has not gone round for 15 s");
        liveness.tick();
        liveness.check().unwrap();
        liveness.last_tick.millis.store(45_000, Ordering::Relaxed);
        liveness.end();
        liveness.check().expect("there is no loop any more");
        assert!(started(Duration::from_mins(3)).check().is_err(), "it never began");
    }
}
