//! How long the trainings that are left will take, before they begin.

use std::fmt;
use std::time::Duration;

use leadtime_proto::phrase::{counted, duration};

use crate::plan::PlannedTraining;
use crate::provenance::minutes;
use crate::train::Crew;

/// Environment steps per second of one training by domain, where no run says; two trainings at a time on two cores. A quarter
/// of the runs of `docs/results/table1.json` and `docs/results/steakhouse.json` were at least as fast. The others ran beside
/// other work, so their mean says more about the machine than about Leadtime.
const PACES: [(&str, f64); 3] =
    [("lander", 33_000.0), ("highway", 24_000.0), ("steakhouse", 33_000.0)];
/// The pace of a domain that no table is made of: the slowest of [`PACES`].
const OTHER_PACE: f64 = 24_000.0;

/// How long trainings will take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainingEstimate {
    left: Duration,
    at_once: usize,
    /// Trainings whose recorded time says how fast others of their domain are.
    n_measured: usize,
    /// Trainings left of whose domain none has a recorded time.
    n_assumed: usize,
    /// The slowest and the fastest pace that these are reckoned with, in steps per second; without any, the bounds that
    /// nothing has moved yet.
    assumed: [f64; 2],
}

/// Writes it as a sentence.
impl fmt::Display for TrainingEstimate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { left, at_once, n_measured, n_assumed, assumed: [slowest, fastest] } = *self;
        write!(f, "about {} of training, {at_once} at a time", duration(left))?;
        if n_measured > 0 {
            write!(f, ", at the recorded pace of {}", counted(n_measured, "run"))?;
        }
        if n_assumed > 0 {
            let which = if n_measured > 0 { " for the others" } else { "" };
            let up_to = if slowest < fastest { format!(" to {fastest}") } else { String::new() };
            write!(
                f,
                ", at {slowest}{up_to} steps/s each{which}, the pace of the faster runs of docs/results"
            )?;
        }
        f.write_str("; evaluation comes on top")
    }
}

impl TrainingEstimate {
    /// Reckons with the times that runs have recorded, by domain.
    pub(crate) fn new(trainings: &[PlannedTraining], crew: Crew) -> Self {
        let recorded = trainings.iter().filter(|training| training.steps()[0] > 0);
        let paces: Vec<RecordedPace<'_>> =
            recorded.map(RecordedPace::of).filter(|pace| pace.seconds > 0.0).collect();
        let left = trainings.iter().map(|training| {
            let [done, all] = training.steps();
            (training.config.domain.as_str(), all - done)
        });
        Self::from_paces(&paces, &left.collect::<Vec<_>>(), crew.n_jobs())
    }

    fn from_paces(paces: &[RecordedPace<'_>], all: &[(&str, u64)], n_jobs: usize) -> Self {
        let unfinished = || all.iter().filter(|(_, steps)| *steps > 0);
        let (mut seconds, mut n_assumed) = (0.0, 0);
        let mut assumed = [f64::INFINITY, 0.0];
        for &(domain, steps) in unfinished() {
            let known = || paces.iter().filter(|pace| pace.domain == domain);
            let time: f64 = known().map(|pace| pace.seconds).sum();
            let made: f64 = known().map(|pace| pace.steps).sum();
            let pace = if time == 0.0 { assumed_pace(domain) } else { made / time };
            if time == 0.0 {
                n_assumed += 1;
                assumed = [pace.min(assumed[0]), pace.max(assumed[1])];
            }
            seconds += steps as f64 / pace;
        }
        let at_once = n_jobs.min(unfinished().count()).max(1);
        let left = Duration::try_from_secs_f64(seconds / at_once as f64).unwrap_or(Duration::MAX);
        let used =
            |pace: &&RecordedPace<'_>| unfinished().any(|(domain, _)| *domain == pace.domain);
        let n_measured = paces.iter().filter(used).count();
        Self { left, at_once, n_measured, n_assumed, assumed }
    }
}

fn assumed_pace(domain: &str) -> f64 {
    PACES.iter().find(|(known, _)| *known == domain).map_or(OTHER_PACE, |(_, pace)| *pace)
}

#[derive(Clone, Copy)]
struct RecordedPace<'a> {
    domain: &'a str,
    steps: f64,
    seconds: f64,
}

impl<'a> RecordedPace<'a> {
    fn of(training: &'a PlannedTraining) -> Self {
        let (domain, steps) = (training.config.domain.as_str(), training.steps()[0] as f64);
        Self { domain, steps, seconds: 60.0 * minutes(training) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recorded_paces_count_by_domain_and_a_named_one_stands_in() {
        let lander = RecordedPace { domain: "lander", steps: 1_000.0, seconds: 1.0 };
        // Nothing of its domain is left.
        let highway = RecordedPace { domain: "highway", ..lander };
        let left = [("lander", 60_000), ("lander", 60_000), ("lander", 0)];
        let estimate = TrainingEstimate::from_paces(&[lander, highway], &left, 2).to_string();
        assert_eq!(
            estimate,
            "about 1m 00s of training, 2 at a time, at the recorded pace of 1 run; evaluation comes on top"
        );
        let other = TrainingEstimate::from_paces(&[], &[("highway", 2_400_000)], 2).to_string();
        let told = "about 1m 40s of training, 1 at a time, at 24000 steps/s each, the pace of the faster runs of docs/results";
        assert!(other.starts_with(told), "{other}");
    }

    #[test]
    fn every_domain_of_the_tables_has_a_pace_of_its_own() {
        let left = [("highway", 2_400_000), ("lander", 3_300_000), ("mine", 2_400_000)];
        let estimate = TrainingEstimate::from_paces(&[], &left, 1).to_string();
        let told =
            "about 5m 00s of training, 1 at a time, at 24000 to 33000 steps/s each, the pace";
        assert!(estimate.starts_with(told), "{estimate}");
    }
}
