//! How far all trainings are, and how long the rest will take.

use std::fmt;
use std::path::Path;
use std::time::{Duration, Instant};

use leadtime_proto::phrase::{duration, time_left};

use crate::cache::EvalCache;
use crate::plan::PlannedTraining;

/// Gets what goes on while studies are carried out.
pub trait StudyObserver {
    /// Receives how far the trainings are, several times a second while they run.
    fn training(&mut self, progress: &TrainingProgress);
    /// Learns that the policies of a study are evaluated now.
    fn evaluating(&mut self, study: &str);
    /// Learns that they were evaluated, and how many evaluations had been made before.
    fn evaluated(&mut self, cache: &EvalCache);
    /// Receives a page that is not written to a file.
    fn page(&mut self, markdown: &str);
    /// Learns that a page was written.
    fn written(&mut self, path: &Path);
}

/// Where the trainings of all studies stand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TrainingProgress {
    n_runs: usize,
    n_finished: usize,
    /// Environment steps that are done.
    pub done: u64,
    /// Environment steps in all.
    pub all: u64,
    /// How long the rest takes at the present pace; `None` before anything was trained.
    left: Option<Duration>,
}

/// Writes it as a sentence.
impl fmt::Display for TrainingProgress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { n_runs, n_finished, done, all, left } = self;
        let percent = (100 * done).checked_div(*all).unwrap_or(100);
        write!(f, "{n_finished} of {n_runs} trainings finished, {percent} % of {all} steps")?;
        let Some(left) = left else { return Ok(()) };
        write!(f, ", {} left", duration(*left))
    }
}

/// Watches the trainings of all studies.
#[derive(Debug)]
pub(crate) struct TrainingWatch {
    trainings: Vec<PlannedTraining>,
    pace: TrainingPace,
    started: Instant,
}

impl TrainingWatch {
    /// Begins with these trainings, some of which may be finished.
    pub(crate) fn new(trainings: Vec<PlannedTraining>) -> Self {
        let pace = TrainingPace::new(trainings.iter().map(|training| training.steps()[0]));
        Self { trainings, pace, started: Instant::now() }
    }

    /// Counts the time as training from now on.
    pub(crate) fn resume(&mut self) {
        self.pace.resume(self.started.elapsed());
    }

    /// Counts the time no longer: what comes next is evaluation.
    pub(crate) fn pause(&mut self) {
        self.pace.pause(self.started.elapsed());
    }

    /// Looks at every run.
    pub(crate) fn look(&mut self) -> TrainingProgress {
        let steps: Vec<[u64; 2]> = self.trainings.iter().map(PlannedTraining::steps).collect();
        let n_finished = self.trainings.iter().filter(|training| training.is_finished()).count();
        self.pace.progress(&steps, n_finished, self.started.elapsed())
    }
}

/// How fast this sitting trains: its own steps over its own time of training.
///
/// What was trained before it began took none of its time, and evaluation trains nothing; so neither counts.
#[derive(Debug)]
struct TrainingPace {
    /// Where each training was taken up: the fewest steps that it had in this sitting. A run that goes on from a
    /// checkpoint first loses the steps after it.
    taken_up: Vec<u64>,
    /// Time of training before the stretch that goes on.
    spent: Duration,
    /// When that stretch began; `None` while nothing is trained.
    since: Option<Duration>,
}

impl TrainingPace {
    /// Begins where the trainings are: their steps so far.
    fn new(done: impl IntoIterator<Item = u64>) -> Self {
        Self { taken_up: done.into_iter().collect(), spent: Duration::ZERO, since: None }
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

    fn progress(
        &mut self,
        steps: &[[u64; 2]],
        n_finished: usize,
        now: Duration,
    ) -> TrainingProgress {
        for (taken_up, [done, _]) in self.taken_up.iter_mut().zip(steps) {
            *taken_up = (*taken_up).min(*done);
        }
        let sum = |i: usize| steps.iter().map(|steps| steps[i]).sum::<u64>();
        let (done, all) = (sum(0), sum(1));
        let gained = done - self.taken_up.iter().sum::<u64>();
        let left = time_left(self.spent(now), gained, all - done);
        TrainingProgress { n_runs: steps.len(), n_finished, done, all, left }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn minutes(minutes: u64) -> Duration {
        Duration::from_mins(minutes)
    }

    #[test]
    fn a_run_that_was_finished_before_does_not_shorten_the_time_left() {
        let mut pace = TrainingPace::new([4_000, 0, 0]);
        pace.resume(minutes(5));
        let steps = [[4_000, 4_000], [2_000, 3_000], [0, 3_000]];
        let before = pace.progress(&[[4_000, 4_000], [0, 3_000], [0, 3_000]], 1, minutes(6));
        assert_eq!(before.left, None);
        let progress = pace.progress(&steps, 1, minutes(36));
        assert_eq!(progress.left, Some(minutes(62)), "31 minutes for 2000 of 6000 steps");
        let expected = "1 of 3 trainings finished, 60 % of 10000 steps, 1h 02m left";
        assert_eq!(progress.to_string(), expected);
    }

    #[test]
    fn evaluation_between_trainings_does_not_count_as_training() {
        let mut pace = TrainingPace::new([0, 0]);
        pace.resume(minutes(0));
        pace.pause(minutes(10));
        pace.pause(minutes(50));
        let paused = pace.progress(&[[1_000, 1_000], [0, 1_000]], 1, minutes(60));
        assert_eq!(paused.left, Some(minutes(10)));
        pace.resume(minutes(60));
        let resumed = pace.progress(&[[1_000, 1_000], [500, 1_000]], 1, minutes(65));
        assert_eq!(resumed.left, Some(minutes(5)));
    }

    #[test]
    fn a_run_that_goes_on_from_a_checkpoint_counts_from_there() {
        let mut pace = TrainingPace::new([5_000]);
        pace.resume(minutes(0));
        assert_eq!(pace.progress(&[[4_000, 8_000]], 0, minutes(1)).left, None);
        assert_eq!(pace.progress(&[[6_000, 8_000]], 0, minutes(10)).left, Some(minutes(10)));
    }
}
