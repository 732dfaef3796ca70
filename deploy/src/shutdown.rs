//! Shutdown, designed: three causes, one token, one deadline.
//!
//! Ctrl-C, SIGTERM and (for a supervised process) the end of standard input all cancel the same token; everything
//! that works watches it, writes its checkpoint and books, and returns. If that takes longer than
//! [`DEADLINE`] the process ends anyway, and a second Ctrl-C ends it at once. A supervisor has a little longer
//! ([`SUPERVISOR_DEADLINE`]): it must outlive its children to kill those that hang.
//!
//! A supervised process reads its standard input and does nothing with it: the supervisor holds the other end and
//! never writes. When the supervisor closes it, or dies in whatever way, the read ends: so there are no orphans.

use std::io::{self, Read as _};
use std::thread;
use std::time::Duration;

use tokio::signal::unix::{SignalKind, signal};
use tokio_util::sync::CancellationToken;

use crate::exit::ExitCode;

/// How long a process may take to end after it was asked to.
pub const DEADLINE: Duration = Duration::from_millis(4_400);
/// How long a supervisor may take: its children's [`DEADLINE`], the time to notice, and the time to kill.
pub const SUPERVISOR_DEADLINE: Duration = Duration::from_millis(4_950);

/// Who may ask a process to end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Watch {
    /// The person, by Ctrl-C or SIGTERM.
    Signals,
    /// The person or the supervisor, by closing standard input.
    SignalsAndStdin,
    /// The person, and the process has children to see off.
    SignalsAsSupervisor,
}

impl Watch {
    fn deadline(self) -> Duration {
        match self {
            Self::Signals | Self::SignalsAndStdin => DEADLINE,
            Self::SignalsAsSupervisor => SUPERVISOR_DEADLINE,
        }
    }
}

/// Starts to watch for a reason to end; call it inside the async runtime.
///
/// # Errors
///
/// If the system refuses a signal handler or a thread.
pub fn watch(who: Watch) -> io::Result<CancellationToken> {
    let token = CancellationToken::new();
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    let cancel = token.clone();
    tokio::spawn(async move {
        tokio::select! {
            _ = interrupt.recv() => tracing::info!("interrupted: finishing"),
            _ = terminate.recv() => tracing::info!("asked to terminate: finishing"),
        }
        cancel.cancel();
        tokio::select! {
            _ = interrupt.recv() => end_now(),
            _ = terminate.recv() => end_now(),
        }
    });
    if who == Watch::SignalsAndStdin {
        let cancel = token.clone();
        thread::Builder::new().name("supervisor-watch".to_owned()).spawn(move || {
            wait_for_end_of_input();
            cancel.cancel();
        })?;
    }
    let cancelled = token.clone();
    tokio::spawn(async move {
        cancelled.cancelled().await;
        let timer = thread::Builder::new().name("shutdown-deadline".to_owned());
        // A thread, because the runtime itself may be what does not end.
        let spawned = timer.spawn(move || {
            thread::sleep(who.deadline());
            end_now();
        });
        if spawned.is_err() {
            end_now();
        }
    });
    Ok(token)
}

fn wait_for_end_of_input() {
    let mut byte = [0; 64];
    let mut input = io::stdin().lock();
    loop {
        match input.read(&mut byte) {
            Ok(0) => return,
            Ok(_) => {}
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(_) => return,
        }
    }
}

#[expect(clippy::exit, reason = "the deadline has passed, or the person insists")]
fn end_now() {
    std::process::exit(ExitCode::Interrupted as i32);
}
