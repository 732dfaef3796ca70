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
    /// Where this process took the run up, and when: what a predecessor did took no time of this one.
    began: Option<(u64, Instant)>,
}

impl Display {
    /// Chooses by where standard error goes.
    pub(crate) fn new() -> Self {
        Self { is_bar: terminal::is_watched() && log::is_chatty(), last: None, began: None }
    }

    /// Shows one update.
    pub(crate) fn update(&mut self, progress: &UpdateProgress) {
        let (n, total) = (progress.n_updates, progress.n_updates_total);
        let (first, since) = *self.began.get_or_insert((n, Instant::now()));
        let every = if self.is_bar { BAR_EVERY } else { LINE_EVERY };
        if n != total && self.last.is_some_and(|at| at.elapsed() < every) {
            return;
        }
        self.last = Some(Instant::now());
        let left = time_left(since.elapsed(), n.saturating_sub(first), total.saturating_sub(n));
        if self.is_bar {
            terminal::show_bar(n as f64 / total as f64, |room| summary(progress, left, room));
        } else {
            tracing::info!("{}", summary(progress, left, usize::MAX));
        }
    }
}

impl Drop for Display {
    fn drop(&mut self) {
        terminal::hide_bar();
    }
}

/// Says how far a run is, in at most `width` characters: the last parts give way first.
fn summary(progress: &UpdateProgress, left: Option<Duration>, width: usize) -> String {
    let UpdateProgress { n_updates, n_updates_total, episodes, held_out, .. } = progress;
    let held_out = held_out.and_then(|means| means.success);
    let parts = [
        Some(format!("{n_updates}/{n_updates_total} updates")),
        left.filter(|_| n_updates < n_updates_total).map(|left| format!("{} left", duration(left))),
        episodes.success.map(|success| format!("success {success:.2}")),
        held_out.map(|success| format!("held out {success:.2}")),
        episodes.episode_return.map(|total| format!("return {total:.1}")),
        Some(format!("{:.0} steps/s", progress.steps_per_second)),
        Some(counted(progress.n_actors, "actor")),
        Some(counted(progress.n_steps, "step")),
    ];
    fitted(parts.into_iter().flatten(), width)
}
