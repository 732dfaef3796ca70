//! How long an observation was on its way, as far as two clocks that know nothing of each other can tell.
//!
//! The shortest difference between arrival and the client's own time stands for no delay; what is more is delay. A process that
//! was frozen finds old observations in its buffers, which all arrive now: only the client's time gives them away.

/// How long a shortest difference counts, in nanoseconds: clocks drift. Without others it counts on.
const WINDOW: u64 = 30_000_000_000;
/// By which part of the time between two moments clocks may drift apart: one in ten thousand.
const DRIFT: u64 = 10_000;

/// A difference between arrival and the client's time, and when it was found.
#[derive(Clone, Copy, Debug)]
struct ClockDifference {
    nanoseconds: i64,
    at: u64,
}

/// The shortest difference of late.
#[derive(Clone, Debug, Default)]
pub(crate) struct TravelTime {
    /// Of this window and of the one before.
    shortest: [Option<ClockDifference>; 2],
    window_began: u64,
}

impl TravelTime {
    /// Forgets every difference, where the client's time is another one from now on.
    pub(crate) fn forget_if(&mut self, is_other: bool) {
        if is_other {
            *self = Self::default();
        }
    }

    /// Returns by how much an observation that arrives `now` was delayed, in nanoseconds. `t` is the client's time in seconds.
    pub(crate) fn delay(&mut self, now: u64, t: f64) -> u64 {
        let found = ClockDifference { nanoseconds: now as i64 - (t * 1e9) as i64, at: now };
        if now.saturating_sub(self.window_began) >= WINDOW {
            let before = self.shortest[0].or(self.shortest[1]);
            (self.shortest, self.window_began) = ([None, before], now);
        }
        let before = self.shortest[0].filter(|own| own.nanoseconds <= found.nanoseconds);
        self.shortest[0] = Some(before.unwrap_or(found));
        let known = self.shortest.into_iter().flatten();
        let delays = known.map(|it| {
            let drift = now.saturating_sub(it.at) / DRIFT;
            u64::try_from(found.nanoseconds - it.nanoseconds).unwrap_or(0).saturating_sub(drift)
        });
        delays.max().unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000_000;

    #[test]
    fn a_message_held_up_on_its_way_is_old_although_it_arrives_now() {
        let mut travel = TravelTime::default();
        for i in 0..10 {
            let sent = i as f64 * 0.1 + 77.0;
            let now = 5 * SECOND + i * SECOND / 10 + (i % 3) * 1_000_000;
            assert!(travel.delay(now, sent) <= 2_000_000);
        }
        // Two seconds later, what was sent a tenth after the last one.
        let delay = travel.delay(8 * SECOND, 78.0);
        assert!((1_990_000_000..=2_010_000_000).contains(&delay), "{delay}");
        assert!(travel.delay(8 * SECOND + 1_000, 80.0) < 2_000_000);
        // However long nothing came: a backlog of ten minutes is a backlog.
        let delay = travel.delay(700 * SECOND, 100.0);
        assert!((590..=675).contains(&(delay / SECOND)), "{delay}");
    }

    #[test]
    fn a_clock_that_is_slow_for_an_hour_makes_nothing_old() {
        let mut travel = TravelTime::default();
        for second in 0..3_600_u64 {
            let t = second as f64 * (1.0 - 1e-4);
            assert!(travel.delay(second * SECOND, t) < 10_000_000, "{second}");
        }
    }
}
