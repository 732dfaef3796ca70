//! Trains what is missing: each training a run of its own, some at a time.

use std::collections::VecDeque;
use std::time::Duration;

use anyhow::Context as _;
use leadtime_runs::Naming;
use leadtime_runs::launch::Launch;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use super::plan::Training;
use super::progress::Progress;
use crate::cli::CompareArgs;
use crate::commands::launch::launch;
use crate::exit::{Blame as _, ExitCode, Failure};

/// Pause between two looks at how far the trainings are.
const LOOK_EVERY: Duration = Duration::from_millis(500);

/// Brings every training to its end; those that are finished are left alone.
///
/// # Errors
///
/// [`Failure`] of the first training that failed, after the others were stopped; or the interruption.
pub(super) async fn train(
    trainings: &[&Training],
    args: &CompareArgs,
    progress: &mut Progress,
    shutdown: &CancellationToken,
) -> Result<(), Failure> {
    let mut waiting: VecDeque<&Training> =
        trainings.iter().copied().filter(|training| !training.is_finished()).collect();
    if let Some(first) = waiting.front() {
        let runs = &first.config.run.directory;
        std::fs::create_dir_all(runs)
            .with_context(|| format!("making {}", runs.display()))
            .blame(ExitCode::WrongInput)?;
    }
    // Cancelled for all of them when one fails.
    let stop = shutdown.child_token();
    let mut working: JoinSet<Result<(), Failure>> = JoinSet::new();
    let mut verdict = Ok(());
    let mut looks = tokio::time::interval(LOOK_EVERY);
    progress.resume();
    loop {
        while working.len() < jobs(args) && !stop.is_cancelled() {
            let Some(next) = waiting.pop_front() else { break };
            working.spawn(carry_out(next.clone(), args.actors, stop.clone()));
        }
        if working.is_empty() {
            break;
        }
        tokio::select! {
            Some(ended) = working.join_next() => {
                let ended = ended.context("a training's task").map_err(Failure::from).flatten();
                if let (Err(failure), Ok(())) = (ended, &verdict) {
                    stop.cancel();
                    verdict = Err(failure);
                }
            }
            _ = looks.tick() => progress.look(),
        }
    }
    progress.look();
    progress.pause();
    if shutdown.is_cancelled() { Err(Failure::silent(ExitCode::Interrupted)) } else { verdict }
}

/// Returns how many trainings go on at a time: one per core, as a learner and its actor wait for each other.
pub(super) fn jobs(args: &CompareArgs) -> usize {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    args.jobs.map_or(cores, |jobs| jobs as usize)
}

async fn carry_out(
    training: Training,
    n_actors: u32,
    stop: CancellationToken,
) -> Result<(), Failure> {
    let log = training.log();
    let what = Launch { stderr_log: Some(log.clone()), ..Launch::new(Naming::Resume, n_actors) };
    match launch(&training.config, &what, &stop).await.map(|_run| ()) {
        // The processes have said why, but not to the person.
        Err(Failure { code, error: None }) if code != ExitCode::Interrupted => {
            let sentence = format!("run `{}` failed: {}", training.name, last_words(&log));
            Err(Failure { code, error: Some(anyhow::Error::msg(sentence)) })
        }
        other => other,
    }
}

/// Returns the last line of a log, and where the rest is.
fn last_words(log: &std::path::Path) -> String {
    let text = std::fs::read_to_string(log).unwrap_or_default();
    let last = text.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or("it said nothing");
    format!("{} (all of it: {})", last.trim(), log.display())
}
