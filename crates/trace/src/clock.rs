//! One clock for all processes of a machine.
//!
//! An [`Instant`] cannot be compared between processes. The system's monotonic clock can: it counts from the machine's start, for
//! everybody alike, and nobody can set it.

use std::time::Instant;

use rustix::time::{ClockId, clock_gettime};

/// How often both clocks are read; the pair that was read fastest counts, as a process may be interrupted in between.
const N_READINGS: usize = 16;

/// Converts this process's instants to nanoseconds since the machine was started.
#[derive(Clone, Copy, Debug)]
pub struct TraceClock {
    origin: Instant,
    origin_ns: u64,
}

impl TraceClock {
    /// Reads both clocks several times and keeps the pair that was read fastest.
    pub fn start() -> Self {
        let reading = || {
            let origin = Instant::now();
            let origin_ns = since_start_ns();
            (origin.elapsed(), Self { origin, origin_ns })
        };
        let more = (1..N_READINGS).map(|_| reading());
        let fastest = more.fold(reading(), |best, next| if next.0 < best.0 { next } else { best });
        fastest.1
    }

    /// Makes a clock that shows `origin_ns` at `origin`.
    #[cfg(test)]
    pub(crate) fn at(origin: Instant, origin_ns: u64) -> Self {
        Self { origin, origin_ns }
    }

    /// Returns when an instant was, in nanoseconds since the machine was started.
    pub fn ns(&self, at: Instant) -> u64 {
        match at.checked_duration_since(self.origin) {
            Some(later) => self.origin_ns + later.as_nanos() as u64,
            None => self.origin_ns.saturating_sub((self.origin - at).as_nanos() as u64),
        }
    }
}

fn since_start_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn two_clocks_agree_about_a_moment_before_and_after_they_were_started() {
        let (before, first) = (Instant::now(), TraceClock::start());
        let second = TraceClock::start();
        for at in [before, before + Duration::from_secs(3)] {
            // Both readings were the fastest of many: a thread that is interrupted in all of them sees a longer gap.
            let gap = first.ns(at).abs_diff(second.ns(at));
            assert!(gap < 5_000_000, "{gap} ns");
        }
        assert_eq!(first.ns(before + Duration::from_nanos(7)) - first.ns(before), 7);
    }
}
