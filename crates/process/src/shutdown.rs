//! Shutdown, designed: three causes, one token, one deadline.
//!
//! Ctrl-C, SIGTERM, SIGHUP (the terminal was closed) and, for a supervised process, the end of standard input all cancel
//! the same token; everything that works watches it, writes its checkpoint and books, and returns. If that takes longer than
//! [`DEADLINE`] the process ends anyway, and a second Ctrl-C ends it at once. A supervisor has a little longer
//! ([`SUPERVISOR_DEADLINE`]): it must outlive its children to kill those that hang. A learner that cannot save what it has
//! learned may go on trying for [`UNSAVED_TIME`].
//!
//! With a log file, SIGHUP reopens it and ends nothing. SIGUSR1 ends a process that asks for it ([`drain_on_request`]) as SIGTERM does;
//! whether that is a success is the caller's. A learner that is drained, or has reached its `--stop-after`, cancels a child of the token:
//! such an end was planned, and has no deadline.
//!
//! A supervised process reads its standard input and does nothing with it: the supervisor holds the other end and
//! never writes. When the supervisor closes it, or dies in whatever way, the read ends: so there are no orphans.

use std::fs;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use leadtime_runs::supervise::GRACE;
use tokio::runtime;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio_util::sync::CancellationToken;

use crate::log_file;

/// How long a process may take to end after it was asked to.
pub const DEADLINE: Duration = Duration::from_millis(4_400);
/// How long a supervisor may take: its children's [`DEADLINE`], the time to notice, and the time to kill.
const SUPERVISOR_DEADLINE: Duration = Duration::from_millis(4_950);
const _: () = assert!(
    DEADLINE.as_millis() < GRACE.as_millis() && GRACE.as_millis() < SUPERVISOR_DEADLINE.as_millis(),
    "a child ends by itself first, then it is killed, then the supervisor ends"
);

/// How much longer a process may take that tries to save what it has learned.
const UNSAVED_TIME: Duration = Duration::from_mins(1);
/// Linux's SIGXFSZ: a file would become larger than the system's limit allows.
const FILE_TOO_LARGE: i32 = 25;
/// Whether the process holds what it could not save.
static IS_UNSAVED: AtomicBool = AtomicBool::new(false);

/// Gives the process a minute more to end, because it holds what it cannot save; its exit code is to say so.
pub fn wait_for_unsaved() {
    IS_UNSAVED.store(true, Ordering::Relaxed);
}

/// Tells whether the process holds what it could not save.
pub fn is_unsaved() -> bool {
    IS_UNSAVED.load(Ordering::Relaxed)
}

/// Asks the process to end on SIGUSR1, too; returns whether that was the reason.
///
/// # Errors
///
/// If the system refuses a handler.
pub fn drain_on_request(shutdown: &CancellationToken) -> io::Result<Arc<AtomicBool>> {
    let mut asked = signal(SignalKind::user_defined1())?;
    let drained = Arc::new(AtomicBool::new(false));
    let (note, shutdown) = (Arc::clone(&drained), shutdown.clone());
    tokio::spawn(async move {
        asked.recv().await;
        if !shutdown.is_cancelled() {
            tracing::info!("asked to drain: finishing");
            note.store(true, Ordering::Relaxed);
            shutdown.cancel();
        }
    });
    Ok(drained)
}

/// Who may ask a process to end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Watch {
    /// The person, by Ctrl-C, SIGTERM or SIGHUP.
    Signals,
    /// The person or the supervisor, by closing standard input.
    SignalsAndStdin,
    /// The person, and the process has children to see off.
    SignalsAsSupervisor,
}

/// Starts to watch for a reason to end; call it inside the async runtime. `end_now` ends the process: it is called where the
/// deadline has passed, or the person insists.
///
/// # Errors
///
/// If the system refuses a handler or a thread.
pub fn watch(who: Watch, end_now: fn()) -> io::Result<CancellationToken> {
    let token = CancellationToken::new();
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    let mut hangup = end_of_terminal()?;
    // A process that listens for it is not ended by it: a limit on files (`ulimit -f`) is an error of the write, as a full disk is. The handler stays.
    drop(signal(SignalKind::from_raw(FILE_TOO_LARGE))?);
    let cancel = token.clone();
    tokio::spawn(async move {
        tokio::select! {
            _ = interrupt.recv() => tracing::info!("interrupted: finishing"),
            _ = terminate.recv() => tracing::info!("asked to terminate: finishing"),
            () = received(hangup.as_mut()) => tracing::info!("the terminal was closed: finishing"),
        }
        cancel.cancel();
        // A hang-up is no insistence: a closing terminal sends several.
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
    let deadline = if who == Watch::SignalsAsSupervisor { SUPERVISOR_DEADLINE } else { DEADLINE };
    tokio::spawn(async move {
        cancelled.cancelled().await;
        let timer = thread::Builder::new().name("shutdown-deadline".to_owned());
        // A thread, because the runtime itself may be what does not end.
        let spawned = timer.spawn(move || {
            thread::sleep(deadline);
            if is_unsaved() {
                thread::sleep(UNSAVED_TIME);
            }
            end_now();
        });
        if spawned.is_err() {
            end_now();
        }
    });
    Ok(token)
}

/// Ends a process at SIGTERM and SIGHUP that has nothing to finish; with a log file, SIGHUP reopens it instead. `end_now` ends
/// the process. For what does not [`watch`], and outside the async runtime.
///
/// # Errors
///
/// If the system refuses a handler or a thread.
pub fn end_at_once(end_now: fn()) -> io::Result<()> {
    let runtime = runtime::Builder::new_current_thread().enable_all().build()?;
    let entered = runtime.enter();
    let mut terminate = signal(SignalKind::terminate())?;
    let mut hangup = end_of_terminal()?;
    drop(entered);
    let waiting = async move {
        tokio::select! {
            _ = terminate.recv() => {}
            () = received(hangup.as_mut()) => {}
        }
        end_now();
    };
    thread::Builder::new().name("signals".to_owned()).spawn(move || runtime.block_on(waiting))?;
    Ok(())
}

/// Listens for the end of the terminal; `None` where SIGHUP reopens the log file instead, also below `nohup`, and where this process
/// is to outlive its terminal.
fn end_of_terminal() -> io::Result<Option<Signal>> {
    let ends = !log_file::reopen_on_hangup()? && !ignores_hangup();
    ends.then(|| signal(SignalKind::hangup())).transpose()
}

/// Tells whether this process was started to outlive its terminal, as `nohup` does.
fn ignores_hangup() -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    mask & 1 != 0
}

async fn received(signal: Option<&mut Signal>) {
    match signal {
        Some(signal) => drop(signal.recv().await),
        None => std::future::pending().await,
    }
}

fn wait_for_end_of_input() {
    // Interrupted reads are tried again; any other error is an end, too.
    drop(io::copy(&mut io::stdin().lock(), &mut io::sink()));
}
