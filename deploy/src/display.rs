//! Progress for a person: a bar on a terminal, a plain line now and then in a log.

use std::time::{Duration, Instant};

use indicatif::ProgressBar;
use leadtime_learner::UpdateProgress;

use crate::logging;

/// Pause between two plain lines.
const LINE_EVERY: Duration = Duration::from_secs(5);

/// Shows how far a run has come.
#[derive(Debug)]
pub(crate) enum Display {
    /// A bar, on a terminal.
    Bar(ProgressBar),
    /// Lines, anywhere else; with the time of the last one.
    Lines(Option<Instant>),
}

impl Display {
    /// Chooses by where standard error goes.
    pub(crate) fn new() -> Self {
        // The message gives way where the terminal is narrow.
        let template = "{bar:24} {pos}/{len} updates  {wide_msg} {elapsed}, {eta} left";
        logging::bar(template).map_or(Self::Lines(None), Self::Bar)
    }

    /// Shows one update.
    pub(crate) fn update(&mut self, progress: &UpdateProgress) {
        match self {
            Self::Bar(bar) => {
                if bar.position() == 0 {
                    // What a predecessor did took no time of this process.
                    bar.set_position(progress.n_updates.saturating_sub(1));
                    bar.reset_eta();
                }
                bar.set_length(progress.n_updates_total);
                bar.set_position(progress.n_updates);
                bar.set_message(summary(progress));
            }
            Self::Lines(last) => {
                let due = last.is_none_or(|at| at.elapsed() >= LINE_EVERY);
                if due || progress.n_updates == progress.n_updates_total {
                    *last = Some(Instant::now());
                    let (n, total) = (progress.n_updates, progress.n_updates_total);
                    tracing::info!("update {n}/{total}  {}", summary(progress));
                }
            }
        }
    }

    /// Removes the bar.
    pub(crate) fn finish(&mut self) {
        if let Self::Bar(bar) = self {
            bar.finish_and_clear();
        }
    }
}

fn summary(progress: &UpdateProgress) -> String {
    let mut parts = vec![format!("{} steps", progress.n_steps)];
    if let Some(success) = progress.episodes.success {
        parts.push(format!("success {success:.2}"));
    }
    if let Some(episode_return) = progress.episodes.episode_return {
        parts.push(format!("return {episode_return:.1}"));
    }
    parts.push(format!("{:.0} steps/s", progress.steps_per_second));
    parts.push(format!("{} actors", progress.n_actors));
    parts.join("  ")
}
