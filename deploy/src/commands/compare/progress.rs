//! How far all trainings are, and how long the rest will take.

use std::io::{self, IsTerminal as _};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use super::plan::Training;
use crate::{logging, output};

/// Pause between two plain lines.
const LINE_EVERY: Duration = Duration::from_secs(15);

/// Shows progress over the trainings of all studies: a bar on a terminal, a plain line now and then elsewhere.
#[derive(Debug)]
pub(super) struct Progress {
    trainings: Vec<Training>,
    /// Steps that were done when this started.
    before: u64,
    started: Instant,
    bar: Option<ProgressBar>,
    last_line: Option<Instant>,
}

impl Progress {
    /// Begins with these trainings, some of which may be finished.
    pub(super) fn new(trainings: Vec<Training>) -> Self {
        let bar = io::stderr().is_terminal().then(|| {
            let style = ProgressStyle::with_template("{bar:32} {msg}");
            let style = style.unwrap_or_else(|_| ProgressStyle::default_bar());
            logging::bars().add(ProgressBar::new(0).with_style(style))
        });
        let mut progress =
            Self { trainings, before: 0, started: Instant::now(), bar, last_line: None };
        progress.before = progress.tally().done;
        progress
    }

    /// Looks at every run and says how far they are.
    pub(super) fn look(&mut self) {
        let tally = self.tally();
        let elapsed = self.started.elapsed();
        let text = tally.sentence(left(tally.done - self.before.min(tally.done), &tally, elapsed));
        if let Some(bar) = &self.bar {
            bar.set_length(tally.all);
            bar.set_position(tally.done);
            bar.set_message(text);
            return;
        }
        if self.last_line.is_none_or(|at| at.elapsed() >= LINE_EVERY) {
            self.last_line = Some(Instant::now());
            output::say(&text);
        }
    }

    fn tally(&self) -> Tally {
        let mut tally = Tally { n_runs: self.trainings.len(), ..Tally::default() };
        for training in &self.trainings {
            let [done, all] = training.steps();
            tally.done += done;
            tally.all += all;
            tally.n_finished += usize::from(training.is_finished());
        }
        tally
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

/// Where the trainings stand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Tally {
    n_runs: usize,
    n_finished: usize,
    done: u64,
    all: u64,
}

impl Tally {
    fn sentence(&self, left: Option<Duration>) -> String {
        let Self { n_runs, n_finished, done, all } = *self;
        let percent = (100 * done).checked_div(all).unwrap_or(100);
        let left = left.map_or(String::new(), |left| {
            let minutes = left.as_secs() / 60;
            format!(
                ", {}:{:02}:{:02} of training left",
                minutes / 60,
                minutes % 60,
                left.as_secs() % 60
            )
        });
        format!("{n_finished} of {n_runs} trainings finished, {percent} % of {all} steps{left}")
    }
}

/// Estimates the time left from what was done in this sitting; `None` before anything was.
fn left(done_now: u64, tally: &Tally, elapsed: Duration) -> Option<Duration> {
    let open = tally.all - tally.done.min(tally.all);
    let seconds = elapsed.as_secs_f64() * open as f64 / done_now as f64;
    (done_now > 0).then(|| Duration::from_secs_f64(seconds))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_left_counts_only_what_was_done_in_this_sitting() {
        let tally = Tally { n_runs: 3, n_finished: 1, done: 6_000, all: 10_000 };
        assert_eq!(left(0, &tally, Duration::from_secs(9)), None);
        let left = left(2_000, &tally, Duration::from_mins(31)).unwrap();
        assert_eq!(left, Duration::from_mins(62));
        let sentence = tally.sentence(Some(left));
        let expected = "1 of 3 trainings finished, 60 % of 10000 steps, 1:02:00 of training left";
        assert_eq!(sentence, expected);
    }
}
