//! Learner and actors on this machine until the learner ends, and what their end means for the exit code.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use leadtime_config::Config;
use leadtime_runs::launch::{self, Launch, LaunchError, Launched};
use leadtime_runs::supervise::Ended;
use leadtime_runs::{RunRecord, name_in_place};
use tokio_util::sync::CancellationToken;

use crate::exit::{ExitCode, Failure};
use crate::output;

/// Says how a run goes on, and returns true, if it was begun and has not reached its end.
pub(super) fn goes_on(run: &Path, what: &Launch<'_>) -> bool {
    let record = RunRecord::read(run).ok().filter(|record| record.result.is_none());
    let Some(record) = record else { return false };
    let mut options = vec!["--actors".into(), what.n_actors.to_string().into()];
    options.extend(what.listen.iter().flat_map(|listen| ["--listen".into(), listen.into()]));
    options.extend(what.guard.iter().cloned());
    output::next_resumes("up", run, &name_in_place(run, &record), &options);
    true
}

/// Runs learner and actors until the learner ends, and says how a run that has not reached its end goes on; returns the
/// run's directory.
pub(super) async fn launch(
    config: &Config,
    what: &Launch<'_>,
    shutdown: &CancellationToken,
) -> Result<PathBuf, Failure> {
    launch_or_drain(config, what, shutdown, &AtomicBool::new(false)).await
}

/// As [`launch()`]; a run that ends in order because it was drained is a success, and how it goes on is left to say.
pub(super) async fn launch_or_drain(
    config: &Config,
    what: &Launch<'_>,
    shutdown: &CancellationToken,
    drained: &AtomicBool,
) -> Result<PathBuf, Failure> {
    let launched = carry_out(config, what, shutdown).await?;
    let in_order = [ExitCode::Done, ExitCode::Interrupted];
    let in_order = in_order.map(|code| Ended::Stopped(Some(code as i32)));
    if drained.load(Ordering::Relaxed) && in_order.contains(&launched.ended) {
        return Ok(launched.run);
    }
    // After anything else that is the learner's own error, the same command would end in the same way.
    let [lost, interrupted] =
        [ExitCode::PeerLost, ExitCode::Interrupted].map(|code| Ended::Learner(Some(code as i32)));
    let may_pass = [Ended::NoActorLeft, Ended::Learner(None), lost, interrupted];
    let stopped = [Ended::Stopped(None), Ended::Stopped(Some(ExitCode::Interrupted as i32))];
    if stopped.contains(&launched.ended) || may_pass.contains(&launched.ended) {
        goes_on(&launched.run, what);
    }
    outcome(launched)
}

/// Runs learner and actors until the learner ends.
pub(super) async fn carry_out(
    config: &Config,
    what: &Launch<'_>,
    shutdown: &CancellationToken,
) -> Result<Launched, Failure> {
    launch::launch(config, what, shutdown).await.map_err(|error| {
        let is_ours = matches!(error, LaunchError::Start(_));
        let code = if is_ours { ExitCode::Failed } else { ExitCode::WrongInput };
        Failure::of(code, error)
    })
}

/// Returns the run's directory, or what another end than a good one means for the exit code.
pub(super) fn outcome(launched: Launched) -> Result<PathBuf, Failure> {
    // The processes have logged why.
    match launched.ended {
        // The learner reached the run's end, though it was asked to stop.
        Ended::Learner(Some(0)) | Ended::Stopped(Some(0)) => Ok(launched.run),
        Ended::Learner(Some(code)) | Ended::Stopped(Some(code)) => {
            Err(Failure::silent(ExitCode::from_status(code)))
        }
        Ended::Learner(None) | Ended::NoActorLeft => Err(Failure::silent(ExitCode::Failed)),
        Ended::Stopped(None) => Err(Failure::silent(ExitCode::Interrupted)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_supervisor_retries_the_exit_codes_of_failures_that_may_pass() {
        let retried = [ExitCode::Failed, ExitCode::PeerLost].map(|code| code as i32);
        assert_eq!(leadtime_runs::supervise::RETRIED, retried);
    }
}
