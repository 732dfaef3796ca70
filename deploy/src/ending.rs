//! How a command ends that is asked to end: whether that is a failure, and with which exit code if it takes too long.
//!
//! SIGUSR1 drains a learner, or a command with its learners (`up`, `race`, `compare`): it ends as on SIGTERM, with success.
//! `smoke` ends so without success, which would say that it has passed.

use std::io;
use std::process;
use std::sync::atomic::{AtomicBool, Ordering};

use leadtime_process::shutdown;
pub(crate) use leadtime_process::shutdown::{Watch, drain_on_request};
use tokio_util::sync::CancellationToken;

use crate::exit::{Blame as _, ExitCode, Failure};

/// Starts to watch for a reason to end; call it inside the async runtime. Fails if the system refuses a handler or a
/// thread.
pub(crate) fn watch(who: Watch) -> io::Result<CancellationToken> {
    shutdown::watch(who, end_now)
}

/// Ends a command at SIGTERM and SIGHUP that does not [`watch`]: what it writes is whole or not there. With a log file, SIGHUP
/// reopens it instead. Fails as [`watch`] does.
pub(crate) fn at_once() -> io::Result<()> {
    shutdown::end_at_once(end_now)
}

/// Returns what was done; `None` if it was interrupted because SIGUSR1 asked for the end, which is no failure.
pub(crate) fn unless_drained<T>(
    done: Result<T, Failure>,
    drained: &AtomicBool,
) -> Result<Option<T>, Failure> {
    match done {
        Err(failure)
            if failure.code == ExitCode::Interrupted && drained.load(Ordering::Relaxed) =>
        {
            Ok(None)
        }
        done => done.map(Some),
    }
}

/// Does blocking work that leaves nothing half done, unless the process is asked to end meanwhile: then the work goes on
/// until the process ends.
pub(crate) async fn unless_cancelled<T: Send + 'static>(
    shutdown: &CancellationToken,
    work: impl FnOnce() -> Result<T, Failure> + Send + 'static,
) -> Result<T, Failure> {
    tokio::select! {
        () = shutdown.cancelled() => Err(Failure::silent(ExitCode::Interrupted)),
        done = tokio::task::spawn_blocking(work) => done.blame(ExitCode::Failed)?,
    }
}

#[expect(clippy::exit, reason = "the deadline has passed, or the person insists")]
fn end_now() {
    let code = if shutdown::is_unsaved() { ExitCode::WrongInput } else { ExitCode::Interrupted };
    process::exit(code as i32);
}
