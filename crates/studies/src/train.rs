//! Trains what is missing: each training a run of its own, some at a time.

use std::collections::VecDeque;
use std::path::Path;
use std::time::Duration;

use leadtime_runs::Naming;
use leadtime_runs::build::n_cores;
use leadtime_runs::launch::{Launch, launch};
use leadtime_runs::supervise::Ended;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use crate::error::Error;
use crate::plan::PlannedTraining;
use crate::progress::{StudyObserver, TrainingWatch};

/// Pause between two looks at how far the trainings are.
const LOOK_EVERY: Duration = Duration::from_millis(500);

/// How many processes train.
#[derive(Clone, Copy, Debug)]
pub struct Crew {
    /// Trainings at a time; one per core if left out, as a learner and its actor wait for each other.
    pub jobs: Option<u32>,
    /// Actor processes per training.
    pub actors: u32,
}

impl Crew {
    /// Returns how many trainings run at a time.
    pub(crate) fn n_jobs(self) -> usize {
        self.jobs.map_or_else(n_cores, |jobs| jobs as usize)
    }
}

/// Brings every training to its end; those that are finished are left alone.
pub(crate) async fn train(
    trainings: &[&PlannedTraining],
    crew: Crew,
    watch: &mut TrainingWatch,
    observer: &mut dyn StudyObserver,
    shutdown: &CancellationToken,
) -> Result<(), Error> {
    let mut waiting: VecDeque<&PlannedTraining> =
        trainings.iter().copied().filter(|training| !training.is_finished()).collect();
    if let Some(first) = waiting.front() {
        let runs = &first.config.run.directory;
        std::fs::create_dir_all(runs).map_err(Error::file("making", runs))?;
    }
    let n_jobs = crew.n_jobs();
    // Cancelled for all of them when one fails.
    let stop = shutdown.child_token();
    let mut working: JoinSet<Result<(), Error>> = JoinSet::new();
    let mut verdict = Ok(());
    let mut looks = tokio::time::interval(LOOK_EVERY);
    watch.resume();
    loop {
        while working.len() < n_jobs && !stop.is_cancelled() {
            let Some(next) = waiting.pop_front() else { break };
            working.spawn(carry_out(next.clone(), crew.actors, stop.clone()));
        }
        if working.is_empty() {
            break;
        }
        tokio::select! {
            Some(ended) = working.join_next() => {
                // A panic in a training's task is a bug; it goes on here.
                let ended = ended.unwrap_or_else(|error| std::panic::resume_unwind(error.into_panic()));
                if let (Err(error), Ok(())) = (ended, &verdict) {
                    stop.cancel();
                    verdict = Err(error);
                }
            }
            _ = looks.tick() => observer.training(&watch.look()),
        }
    }
    observer.training(&watch.look());
    watch.pause();
    if shutdown.is_cancelled() { Err(Error::Interrupted) } else { verdict }
}

async fn carry_out(
    training: PlannedTraining,
    n_actors: u32,
    stop: CancellationToken,
) -> Result<(), Error> {
    let log = training.log();
    let what = Launch { stderr_log: Some(log.clone()), ..Launch::new(Naming::Resume, n_actors) };
    let code = match launch(&training.config, &what, &stop).await?.ended {
        Ended::Learner(Some(0)) | Ended::Stopped(Some(0)) => return Ok(()),
        Ended::Stopped(_) => return Err(Error::Interrupted),
        Ended::Learner(code) => code,
        Ended::NoActorLeft => None,
    };
    // The processes logged the reason, but not where the user sees it.
    Err(Error::Training { run: training.name.to_string(), code, last: last_line(&log), log })
}

fn last_line(log: &Path) -> String {
    let text = std::fs::read_to_string(log).unwrap_or_default();
    let last = text.lines().rev().find(|line| !line.trim().is_empty());
    last.unwrap_or("nothing was logged").trim().to_owned()
}
