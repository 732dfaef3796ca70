//! Nanoseconds since a notifier went to work: the only clock of its sessions.

use std::time::{Duration, Instant};

/// A clock that starts at some hours, so that times before the start are not negative.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LiveClock {
    started: Instant,
}

/// What the clock shows when it starts, in nanoseconds.
const START: u64 = 3_600_000_000_000;

impl LiveClock {
    /// Starts a clock at [`START`].
    pub(crate) fn start() -> Self {
        Self { started: Instant::now() }
    }

    /// Returns the time, in nanoseconds.
    pub(crate) fn now(&self) -> u64 {
        self.at(Instant::now())
    }

    /// Returns what the clock showed at a moment.
    pub(crate) fn at(&self, moment: Instant) -> u64 {
        START + moment.saturating_duration_since(self.started).as_nanos() as u64
    }

    /// Returns how long it is until the clock shows a time.
    pub(crate) fn until(&self, time: u64) -> Duration {
        Duration::from_nanos(time.saturating_sub(self.now()))
    }
}
