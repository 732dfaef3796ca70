//! Progress for a person: a bar on a terminal, a plain line now and then in a log.

use std::time::{Duration, Instant};

use leadtime_learner::UpdateProgress;
use leadtime_proto::phrase::{counted, duration, time_left};
use leadtime_table::fitted;

use crate::{log, terminal};

/// Pause between two plain lines, and between two states of the bar.
const LINE_EVERY: Duration = Duration::from_secs(5);
const BAR_EVERY: Duration = Duration::from_millis(100);

/// Shows how far a run has come.
#[derive(Debug)]
pub(crate) struct Display {
    is_bar: bool,
    last: Option<Instant>,
    pace: StepRate,
    /// Where this process took the run up, and when: what a predecessor did took no time of this one.
    began: Option<(u64, Instant)>,
}

impl Display {
    /// Chooses by where standard error goes.
    pub(crate) fn new() -> Self {
        Self {
            is_bar: terminal::is_watched() && log::is_chatty(),
            last: None,
            pace: StepRate::default(),
            began: None,
        }
    }

    /// Shows how far training has come with an update.
    pub(crate) fn update(&mut self, progress: &UpdateProgress) {
        let (n, total) = (progress.n_updates, progress.n_updates_total);
        let (first, since) = *self.began.get_or_insert((n, Instant::now()));
        let per_second =
            self.pace.rate(Instant::now(), progress.n_steps, progress.steps_per_second);
        let every = if self.is_bar { BAR_EVERY } else { LINE_EVERY };
        if n != total && self.last.is_some_and(|at| at.elapsed() < every) {
            return;
        }
        self.last = Some(Instant::now());
        let left = time_left(since.elapsed(), n.saturating_sub(first), total.saturating_sub(n));
        if self.is_bar {
            let part = n as f64 / total as f64;
            terminal::show_bar(part, |room| summary(progress, left, per_second, room));
        } else {
            tracing::info!("{}", summary(progress, left, per_second, usize::MAX));
        }
    }
}

/// How fast a run goes, over the last five to ten seconds: a single update says little, and the one that a line waited for is
/// slower than most.
#[derive(Debug, Default)]
struct StepRate {
    /// When how many steps were done: at the last mark, and at the one before.
    marks: [Option<(Instant, u64)>; 2],
}

impl StepRate {
    /// Returns the steps per second up to now; what the last update says, where that is all there is.
    fn rate(&mut self, now: Instant, n_steps: u64, of_last: f64) -> f64 {
        let last = self.marks[0];
        if last.is_none_or(|(at, _)| now.duration_since(at) >= LINE_EVERY) {
            self.marks = [Some((now, n_steps)), last];
        }
        let Some((at, n_before)) = self.marks[1].or(last) else { return of_last };
        let seconds = now.duration_since(at).as_secs_f64();
        let n_since = n_steps.saturating_sub(n_before);
        if n_since == 0 || seconds <= 0.0 { of_last } else { n_since as f64 / seconds }
    }
}

impl Drop for Display {
    fn drop(&mut self) {
        terminal::hide_bar();
    }
}

/// Says how far a run is, in at most `width` characters: the last parts give way first.
fn summary(
    progress: &UpdateProgress,
    left: Option<Duration>,
    per_second: f64,
    width: usize,
) -> String {
    let UpdateProgress { n_updates, n_updates_total, episodes, held_out, .. } = progress;
    let held_out = held_out.and_then(|means| means.success);
    let parts = [
        Some(format!("{n_updates}/{n_updates_total} updates")),
        left.filter(|_| n_updates < n_updates_total).map(|left| format!("{} left", duration(left))),
        episodes.success.map(|success| format!("success {success:.2}")),
        held_out.map(|success| format!("held out {success:.2}")),
        episodes.episode_return.map(|total| format!("return {total:.1}")),
        Some(format!("{per_second:.0} steps/s")),
        Some(counted(progress.n_actors, "actor")),
        Some(counted(progress.n_steps, "step")),
    ];
    fitted(parts.into_iter().flatten(), width)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pace_is_that_of_seconds_and_not_of_the_update_that_a_line_waited_for() {
        let (start, mut pace) = (Instant::now(), StepRate::default());
        let at = |millis: u64| start + Duration::from_millis(millis);
        assert!((pace.rate(at(0), 512, 100.0) - 100.0).abs() < 1e-9, "all there is");
        for update in 1..=490_u64 {
            pace.rate(at(10 * update), 512 * (1 + update), 51_200.0);
        }
        // The next takes a second.
        let told = pace.rate(at(5_900), 512 * 492, 512.0);
        assert!((told - 491.0 * 512.0 / 5.9).abs() < 1.0, "{told}");
        let told = pace.rate(at(6_000), 512 * 502, 51_200.0);
        assert!((told - 501.0 * 512.0 / 6.0).abs() < 1.0, "{told}");
        // A standstill counts.
        let told = pace.rate(at(36_000), 512 * 503, 17.0);
        assert!((told - 11.0 * 512.0 / 30.1).abs() < 1.0, "{told}");
    }
}
