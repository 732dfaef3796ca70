//! Other learners of a run's name that are present on the same network.
//!
//! Their presence proves nothing, and that of a learner that was killed lasts a moment longer than the learner: so one that stays is
//! reported, and nothing else depends on it.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use leadtime_proto::Incarnation;

/// Presence that lasts this long is not that of a learner that was killed.
const STAYS: Duration = Duration::from_secs(10);
/// Shortest pause between two reports: anybody can show presence.
const REPORT_EVERY: Duration = Duration::from_mins(1);
/// The most starts that are known at once.
const MAX_OTHERS: usize = 64;

/// The starts of other learners that are there.
#[derive(Debug, Default)]
pub(crate) struct OtherLearners {
    /// Since when each of them is there, and whether it was reported.
    present: BTreeMap<Incarnation, (Instant, bool)>,
    reported_at: Option<Instant>,
}

impl OtherLearners {
    /// Notes that one is there, as often as that is told, or gone.
    pub(crate) fn heard(&mut self, start: Incarnation, is_there: bool, now: Instant) {
        if !is_there {
            self.present.remove(&start);
        } else if self.present.len() < MAX_OTHERS {
            self.present.entry(start).or_insert((now, false));
        }
    }

    /// Forgets who is there: it is told anew.
    pub(crate) fn forget(&mut self) {
        self.present.clear();
    }

    /// Returns whether one that stays is to be reported, which each is once.
    pub(crate) fn is_news(&mut self, now: Instant) -> bool {
        let lasted = |since: Instant, time| now.saturating_duration_since(since) >= time;
        let may_report = self.reported_at.is_none_or(|at| lasted(at, REPORT_EVERY));
        let present = self.present.values_mut();
        let news: Vec<_> = present.filter(|it| !it.1 && lasted(it.0, STAYS)).collect();
        if !may_report || news.is_empty() {
            return false;
        }
        for (_, is_reported) in news {
            *is_reported = true;
        }
        self.reported_at = Some(now);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_that_stays_is_reported_once_and_one_that_was_killed_is_not() {
        let (mut others, start) = (OtherLearners::default(), Instant::now());
        others.heard(Incarnation(1), true, start);
        others.heard(Incarnation(1), true, start + STAYS / 2);
        assert!(!others.is_news(start + STAYS / 2));
        others.heard(Incarnation(1), false, start + STAYS / 2);
        assert!(!others.is_news(start + STAYS), "it was killed");
        others.heard(Incarnation(2), true, start);
        assert!(others.is_news(start + STAYS));
        assert!(!others.is_news(start + 2 * REPORT_EVERY), "reported before");
        others.forget();
        others.heard(Incarnation(2), true, start + 2 * REPORT_EVERY);
        assert!(others.is_news(start + 3 * REPORT_EVERY), "back on another connection");
    }

    #[test]
    fn strangers_who_show_presence_fill_neither_the_log_nor_the_memory() {
        let (mut others, start) = (OtherLearners::default(), Instant::now());
        let mut n_reports = 0;
        for second in 0..600_u64 {
            let now = start + Duration::from_secs(second);
            others.heard(Incarnation(second), true, now);
            if second >= 20 {
                others.heard(Incarnation(second - 20), false, now);
            }
            n_reports += usize::from(others.is_news(now));
        }
        assert_eq!(n_reports, 10, "one a minute");
        (0..10_000).for_each(|n| others.heard(Incarnation(n), true, start));
        assert_eq!(others.present.len(), MAX_OTHERS);
    }
}
