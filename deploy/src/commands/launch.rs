//! Launches a learner and actors, and decides what their end means for the exit code.

use std::path::PathBuf;

use leadtime_runs::launch::{self, Launch, LaunchError};
use leadtime_runs::supervise::Ended;
use tokio_util::sync::CancellationToken;

use crate::exit::{ExitCode, Failure};
use leadtime_config::Config;

/// Runs learner and actors until the learner ends; returns the run's directory.
pub(super) async fn launch(
    config: &Config,
    what: &Launch<'_>,
    shutdown: &CancellationToken,
) -> Result<PathBuf, Failure> {
    let launched = launch::launch(config, what, shutdown).await.map_err(|error| {
        let is_ours = matches!(error, LaunchError::Start(_));
        let code = if is_ours { ExitCode::Failed } else { ExitCode::WrongInput };
        Failure { code, error: Some(error.into()) }
    })?;
    // The processes have logged why.
    match launched.ended {
        Ended::Learner(Some(0)) => Ok(launched.run),
        Ended::Learner(Some(code)) => Err(Failure::silent(ExitCode::from_status(code))),
        Ended::Learner(None) | Ended::NoActorLeft => Err(Failure::silent(ExitCode::Failed)),
        Ended::Stopped => Err(Failure::silent(ExitCode::Interrupted)),
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
