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
    pace: Pace,
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
        let steps: Vec<[u64; 2]> = trainings.iter().map(Training::steps).collect();
        let pace = Pace::new(&steps);
        Self { trainings, pace, started: Instant::now(), bar, last_line: None }
    }

    /// Lets the time count as training.
    pub(super) fn resume(&mut self) {
        self.pace.resume(self.started.elapsed());
    }

    /// Lets the time count no longer: what comes next is judging.
    pub(super) fn pause(&mut self) {
        self.pace.pause(self.started.elapsed());
    }

    /// Looks at every run and says how far they are.
    pub(super) fn look(&mut self) {
        let steps: Vec<[u64; 2]> = self.trainings.iter().map(Training::steps).collect();
        let n_finished = self.trainings.iter().filter(|training| training.is_finished()).count();
        let tally = Tally::new(&steps, n_finished);
        let text = tally.sentence(self.pace.left(&steps, self.started.elapsed()));
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
    fn new(steps: &[[u64; 2]], n_finished: usize) -> Self {
        let sum = |i: usize| steps.iter().map(|steps| steps[i]).sum();
        Self { n_runs: steps.len(), n_finished, done: sum(0), all: sum(1) }
    }

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

/// How fast this sitting trains: its own steps over its own time of training.
///
/// What was trained before it began took none of its time, and judging trains nothing; so neither counts.
#[derive(Debug)]
struct Pace {
    /// Where each training was taken up: the fewest steps that it had in this sitting. A run that goes on from a
    /// checkpoint first loses the steps after it.
    taken_up: Vec<u64>,
    /// Time of training before the stretch that goes on.
    spent: Duration,
    /// When that stretch began; `None` while nothing is trained.
    since: Option<Duration>,
}

impl Pace {
    /// Begins where the trainings are: steps done, and in all.
    fn new(steps: &[[u64; 2]]) -> Self {
        let taken_up = steps.iter().map(|[done, _]| *done).collect();
        Self { taken_up, spent: Duration::ZERO, since: None }
    }

    fn resume(&mut self, now: Duration) {
        self.since.get_or_insert(now);
    }

    fn pause(&mut self, now: Duration) {
        self.spent = self.spent(now);
        self.since = None;
    }

    fn spent(&self, now: Duration) -> Duration {
        self.spent + self.since.map_or(Duration::ZERO, |since| now.saturating_sub(since))
    }

    /// Estimates how long the rest will take; `None` before anything was trained.
    fn left(&mut self, steps: &[[u64; 2]], now: Duration) -> Option<Duration> {
        for (taken_up, [done, _]) in self.taken_up.iter_mut().zip(steps) {
            *taken_up = (*taken_up).min(*done);
        }
        let gains = self.taken_up.iter().zip(steps).map(|(taken_up, [done, _])| done - taken_up);
        let gained: u64 = gains.sum();
        let open: u64 = steps.iter().map(|[done, all]| all.saturating_sub(*done)).sum();
        let seconds = self.spent(now).as_secs_f64() * open as f64 / gained as f64;
        if gained == 0 { None } else { Duration::try_from_secs_f64(seconds).ok() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn minutes(minutes: u64) -> Duration {
        Duration::from_mins(minutes)
    }

    #[test]
    fn what_was_finished_before_does_not_shorten_the_time_left() {
        let mut pace = Pace::new(&[[4_000, 4_000], [0, 3_000], [0, 3_000]]);
        pace.resume(minutes(5));
        let steps = [[4_000, 4_000], [2_000, 3_000], [0, 3_000]];
        assert_eq!(pace.left(&[[4_000, 4_000], [0, 3_000], [0, 3_000]], minutes(6)), None);
        let left = pace.left(&steps, minutes(36)).unwrap();
        assert_eq!(left, minutes(62), "31 minutes for 2000 of 6000 steps");
        let sentence = Tally::new(&steps, 1).sentence(Some(left));
        let expected = "1 of 3 trainings finished, 60 % of 10000 steps, 1:02:00 of training left";
        assert_eq!(sentence, expected);
    }

    #[test]
    fn judging_between_trainings_takes_no_time_of_training() {
        let mut pace = Pace::new(&[[0, 1_000], [0, 1_000]]);
        pace.resume(minutes(0));
        pace.pause(minutes(10));
        pace.pause(minutes(50));
        assert_eq!(pace.left(&[[1_000, 1_000], [0, 1_000]], minutes(60)), Some(minutes(10)));
        pace.resume(minutes(60));
        assert_eq!(pace.left(&[[1_000, 1_000], [500, 1_000]], minutes(65)), Some(minutes(5)));
    }

    #[test]
    fn a_run_that_goes_on_from_a_checkpoint_counts_from_there() {
        let mut pace = Pace::new(&[[5_000, 8_000]]);
        pace.resume(minutes(0));
        assert_eq!(pace.left(&[[4_000, 8_000]], minutes(1)), None);
        assert_eq!(pace.left(&[[6_000, 8_000]], minutes(10)), Some(minutes(10)));
    }
}
