//! How often a worker has died, and when that is too often.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// The number of deaths after which a worker is given up.
pub(crate) const MAX_DEATHS: usize = 3;
/// Deaths are counted over this time, if steps were answered in between.
const DEATH_WINDOW: Duration = Duration::from_mins(1);

/// When workers have died, each of which was started in place of the one before.
#[derive(Debug, Default)]
pub(crate) struct WorkerDeaths {
    recent: VecDeque<Instant>,
    /// Deaths since a step was answered. Such a worker gets nowhere, however slowly it fails.
    n_since_step: usize,
}

impl WorkerDeaths {
    /// Counts a death; returns over what there were [`MAX_DEATHS`], if so.
    pub(crate) fn count(&mut self, now: Instant) -> Option<&'static str> {
        self.recent.push_back(now);
        self.recent.retain(|death| now.saturating_duration_since(*death) < DEATH_WINDOW);
        self.n_since_step += 1;
        if self.recent.len() >= MAX_DEATHS {
            Some("within a minute")
        } else if self.n_since_step >= MAX_DEATHS {
            Some("without a step in between")
        } else {
            None
        }
    }

    /// Takes note that a step was answered.
    pub(crate) fn stepped(&mut self) {
        self.n_since_step = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts deaths that are so many seconds apart; returns what each of them comes to.
    fn counted(seconds: u64, steps: bool) -> Vec<Option<&'static str>> {
        let (mut deaths, began) = (WorkerDeaths::default(), Instant::now());
        let of = |i: u32| {
            if steps {
                deaths.stepped();
            }
            deaths.count(began + Duration::from_secs(seconds) * i)
        };
        (0..3).map(of).collect()
    }

    #[test]
    fn a_worker_that_fails_slowly_is_given_up_unless_it_steps_in_between() {
        assert_eq!(counted(35, false), [None, None, Some("without a step in between")]);
        assert_eq!(counted(35, true), [None; 3]);
        assert_eq!(counted(20, true), [None, None, Some("within a minute")]);
    }
}
