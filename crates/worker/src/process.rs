//! One worker process: started, spoken to, listened to, and killed with everything that it has started.
//!
//! Its standard output and error go to the log, a few lines a second; what it said last is kept to
//! explain why it died. Its standard input closes when this process ends, and then it ends too.

use std::collections::VecDeque;
use std::io::{self, BufRead as _, BufReader, PipeReader, Read as _, Write as _};
use std::net::Shutdown;
use std::ops::Range;
use std::os::unix::net::{UnixListener, UnixStream};
use std::os::unix::process::ExitStatusExt as _;
use std::process::{ChildStdin, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use leadtime_proto::text::printable;
use process_wrap::std::{ChildWrapper, CommandWrap, ProcessGroup};
use tracing::{debug, info, warn};

use crate::launch::WorkerLaunch;
use crate::protocol::{
    Aside, FrameKind, FrameReader, MAX_HELLO_BYTES, MAX_TEXT_BYTES, ProtocolError, WorkerHello,
    read_hello,
};

/// How the worker learns where to connect.
const SOCKET_VARIABLE: &str = "LEADTIME_WORKER_SOCKET";
/// How it learns what to make.
const CONFIG_VARIABLE: &str = "LEADTIME_WORKER_CONFIG";
/// The name under which the log has what workers say.
const LOG_TARGET: &str = "leadtime::worker";
/// How often time-outs are looked at while nothing comes.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// Pause between two looks whether a worker has connected.
const ACCEPT_PAUSE: Duration = Duration::from_millis(5);
const KEPT_LINES: usize = 20;
/// Lines that are logged in a second: a program that prints in every step is not to fill a disk, and one that fails is to be
/// quoted whole.
const LINES_PER_SECOND: u32 = 40;
/// How long a dead worker's last words are waited for.
const LAST_WORDS: Duration = Duration::from_millis(500);
/// How long a worker that is no longer needed may close its environments.
const CLOSING: Duration = Duration::from_secs(2);
/// The longest temporary directory that leaves room for a socket's name.
const MAX_BASE_BYTES: usize = 60;

/// Lets a few lines a second pass.
#[derive(Debug)]
pub(crate) struct LineLimit {
    since: Instant,
    n_lines: u32,
}

impl LineLimit {
    pub(crate) fn new() -> Self {
        Self { since: Instant::now(), n_lines: 0 }
    }

    /// Returns whether one more line may be logged.
    pub(crate) fn admits(&mut self) -> bool {
        if self.since.elapsed() >= Duration::from_secs(1) {
            *self = Self::new();
        }
        self.n_lines += 1;
        self.n_lines <= LINES_PER_SECOND
    }
}

/// A running worker; dropping it lets it close its environments, and kills its group.
#[derive(Debug)]
pub(crate) struct WorkerProcess {
    child: Box<dyn ChildWrapper>,
    /// The worker ends when this closes.
    lifeline: Option<ChildStdin>,
    reader: FrameReader<UnixStream>,
    writer: UnixStream,
    words: Words,
    limit: LineLimit,
    /// Until when it may close its environments, once it was told that nothing more is asked.
    closes_by: Option<Instant>,
    /// It was killed; its number may be another's by now.
    is_over: bool,
}

/// Why a worker did not begin.
#[derive(Debug)]
pub(crate) struct NotBegun {
    /// What it said, or what was missing.
    pub(crate) how: String,
    /// Whether somebody killed it, so that it may well begin the next time.
    pub(crate) was_killed: bool,
}

/// What a worker prints.
#[derive(Debug)]
struct Words {
    lines: Arc<Mutex<VecDeque<String>>>,
    listener: JoinHandle<()>,
}

impl WorkerProcess {
    /// Starts a worker and waits for its hello.
    pub(crate) fn start(
        launch: &WorkerLaunch,
    ) -> io::Result<Result<(Self, WorkerHello), NotBegun>> {
        let preferred = std::env::temp_dir();
        let fits = preferred.as_os_str().len() <= MAX_BASE_BYTES;
        let base = if fits { preferred } else { "/tmp".into() };
        // Only this user can look into it; it is gone as soon as the worker has connected.
        let place = tempfile::Builder::new().prefix("leadtime-worker-").tempdir_in(base)?;
        let socket = place.path().join("socket");
        let listener = UnixListener::bind(&socket)?;
        listener.set_nonblocking(true)?;
        let (printed, output) = io::pipe()?;
        let mut command = Command::new("sh");
        command.args(["-c", &launch.command]);
        command.env(SOCKET_VARIABLE, &socket).env(CONFIG_VARIABLE, &launch.config);
        command.stdin(Stdio::piped()).stdout(output.try_clone()?).stderr(output);
        let mut wrapped = CommandWrap::from(command);
        let mut child = wrapped.wrap(ProcessGroup::leader()).spawn()?;
        // Or the pipe would never end: it holds the other end too.
        drop(wrapped);
        let lifeline = child.stdin().take();
        let words = Words::listen(printed)?;
        let deadline = Instant::now() + launch.start_timeout();
        let stream = match accept(&listener, child.as_mut(), deadline) {
            Ok(stream) => stream,
            Err(not_begun) => {
                kill(child.as_mut());
                return Ok(Err(NotBegun { how: words.explain(not_begun.how), ..not_begun }));
            }
        };
        stream.set_nonblocking(false)?;
        stream.set_read_timeout(Some(LOOK_EVERY))?;
        stream.set_write_timeout(Some(launch.step_timeout))?;
        let writer = stream.try_clone()?;
        let reader = FrameReader::new(stream);
        let limit = LineLimit::new();
        let (closes_by, is_over) = (None, false);
        let mut worker = Self { child, lifeline, reader, writer, words, limit, closes_by, is_over };
        let (kind, patience) = (FrameKind::Hello, launch.start_timeout());
        let hello = worker.answer(kind, MAX_HELLO_BYTES, patience, patience, |_, _| {});
        Ok(match hello.and_then(|body| read_hello(&body)) {
            Ok(hello) => Ok((worker, hello)),
            // Its own sentence needs no further words.
            Err(ProtocolError::GaveUp(how)) => Err(NotBegun { how, was_killed: false }),
            Err(error) => {
                let status = worker.ended(&error);
                Err(NotBegun {
                    was_killed: status.is_some_and(was_killed),
                    how: worker.explain(status, &error),
                })
            }
        })
    }

    /// Sends a frame to the worker.
    ///
    /// # Errors
    ///
    /// [`ProtocolError::Closed`] if the worker has ended, another one if its pipe cannot be written to.
    pub(crate) fn send(&mut self, frame: &[u8]) -> Result<(), ProtocolError> {
        self.writer.write_all(frame).map_err(|error| match error.kind() {
            io::ErrorKind::BrokenPipe | io::ErrorKind::ConnectionReset => ProtocolError::Closed,
            _ => error.into(),
        })
    }

    /// Waits for an answer and logs what is said besides it; failures are handed to `failed`.
    pub(crate) fn answer(
        &mut self,
        kind: FrameKind,
        most: usize,
        timeout: Duration,
        patience: Duration,
        mut failed: impl FnMut(u16, String),
    ) -> Result<Vec<u8>, ProtocolError> {
        let (limit, id) = (&mut self.limit, self.child.id());
        let aside = |aside| match aside {
            Aside::Log { level, text } if limit.admits() => match level {
                0 => debug!(target: LOG_TARGET, worker = id, "{text}"),
                1 => info!(target: LOG_TARGET, worker = id, "{text}"),
                _ => warn!(target: LOG_TARGET, worker = id, "{text}"),
            },
            Aside::Log { .. } => {}
            Aside::Failed { slot, text } => failed(slot, text),
        };
        self.reader.answer(kind, most, timeout, patience, aside).map(<[u8]>::to_vec)
    }

    /// Tells the worker that nothing more is asked: it closes its environments and ends. Returns until when it may do so.
    pub(crate) fn let_go(&mut self) -> Instant {
        if let Some(told) = self.closes_by {
            return told;
        }
        if let Err(error) = self.writer.shutdown(Shutdown::Write) {
            debug!(%error, "a worker's connection was closed already");
        }
        *self.closes_by.insert(Instant::now() + CLOSING)
    }

    /// Kills the worker and says how it ended: what was noticed, and its last words.
    pub(crate) fn end(mut self, noticed: &ProtocolError) -> String {
        let status = self.ended(noticed);
        self.explain(status, noticed)
    }

    /// Kills the worker; returns how it ended, if it did by itself.
    fn ended(&mut self, noticed: &ProtocolError) -> Option<ExitStatus> {
        let status = match noticed {
            // It takes a moment from closing the connection to being gone.
            ProtocolError::Closed => wait_for_end(self.child.as_mut(), Instant::now() + LAST_WORDS),
            _ => None,
        };
        kill(self.child.as_mut());
        self.is_over = true;
        status
    }

    fn explain(&self, status: Option<ExitStatus>, noticed: &ProtocolError) -> String {
        let ended = status.map(|status| format!("it ended ({status})"));
        self.words.explain(ended.unwrap_or_else(|| noticed.to_string()))
    }
}

impl Drop for WorkerProcess {
    fn drop(&mut self) {
        if !self.is_over {
            let closes_by = self.let_go();
            let _ = wait_for_end(self.child.as_mut(), closes_by);
            self.lifeline = None;
            kill(self.child.as_mut());
        }
    }
}

/// Kills a process group and waits for its leader.
fn kill(child: &mut dyn ChildWrapper) {
    // Also where the leader is gone: others of the group may not be.
    drop(child.start_kill());
    if let Err(error) = child.wait() {
        debug!(%error, "a worker could not be waited for");
    }
}

/// Returns whether a signal ended a process, or what the shell had started for it.
fn was_killed(status: ExitStatus) -> bool {
    const SHELL_SAYS_SIGNAL: Range<i32> = 129..193;
    status.signal().is_some() || status.code().is_some_and(|code| SHELL_SAYS_SIGNAL.contains(&code))
}

/// Waits for the end of a process, and returns how it ended; `None` if it has not by then.
fn wait_for_end(child: &mut dyn ChildWrapper, deadline: Instant) -> Option<ExitStatus> {
    loop {
        match child.try_wait() {
            Ok(Some(status)) => return Some(status),
            Ok(None) if Instant::now() < deadline => thread::sleep(ACCEPT_PAUSE),
            _ => return None,
        }
    }
}

/// Waits until the worker connects; an error says why it never will.
fn accept(
    listener: &UnixListener,
    child: &mut dyn ChildWrapper,
    deadline: Instant,
) -> Result<UnixStream, NotBegun> {
    let not_begun = |how| NotBegun { how, was_killed: false };
    loop {
        match listener.accept() {
            Ok((stream, _)) => return Ok(stream),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            Err(error) => return Err(not_begun(error.to_string())),
        }
        if let Ok(Some(status)) = child.try_wait() {
            let how = format!("it ended before it said hello ({status})");
            return Err(NotBegun { how, was_killed: was_killed(status) });
        }
        if Instant::now() >= deadline {
            return Err(not_begun("it did not say hello in time".to_owned()));
        }
        thread::sleep(ACCEPT_PAUSE);
    }
}

impl Words {
    fn listen(printed: PipeReader) -> io::Result<Self> {
        let lines = Arc::new(Mutex::new(VecDeque::new()));
        let kept = Arc::clone(&lines);
        let listen = move || {
            let (mut printed, mut line) = (BufReader::new(printed), Vec::new());
            let mut limit = LineLimit::new();
            loop {
                line.clear();
                // A line without an end is cut.
                let most = MAX_TEXT_BYTES as u64;
                match printed.by_ref().take(most).read_until(b'\n', &mut line) {
                    Ok(0) | Err(_) => return,
                    Ok(_) => {}
                }
                let text = printable(String::from_utf8_lossy(&line).trim_end());
                if text.trim().is_empty() {
                    continue;
                }
                if limit.admits() {
                    info!(target: LOG_TARGET, "{text}");
                }
                let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
                if kept.len() == KEPT_LINES {
                    kept.pop_front();
                }
                kept.push_back(text);
            }
        };
        let listener = thread::Builder::new().name("worker-words".to_owned()).spawn(listen)?;
        Ok(Self { lines, listener })
    }

    /// Adds the last words of a worker that is dead to how it ended.
    fn explain(&self, how: String) -> String {
        let deadline = Instant::now() + LAST_WORDS;
        while !self.listener.is_finished() && Instant::now() < deadline {
            thread::sleep(ACCEPT_PAUSE);
        }
        let lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        match lines.back() {
            Some(last) => format!("{how}; its last words: {last}"),
            None => how,
        }
    }
}
