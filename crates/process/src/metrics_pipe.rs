//! A command that gets every update's metrics on its standard input, to hand them on to a tracker of experiments.
//!
//! The command is another's program, so nothing waits for it: lines that it does not read in time are dropped and
//! counted, and one that ends or hangs costs the run nothing but its lines.

use std::io::{self, Write as _};
use std::process::{Command, Stdio};
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use leadtime_proto::phrase::counted;
use process_wrap::std::{ChildWrapper, CommandWrap, ProcessGroup};
use tracing::warn;

/// The most lines that wait to be read.
const MAX_LINES: usize = 1_024;
/// How long the command may take to end once it has all lines: a learner ends within five seconds.
const PATIENCE: Duration = Duration::from_secs(2);
/// Pause between two looks whether it has ended.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// A started command, and the thread that writes to it.
#[derive(Debug)]
pub struct MetricsPipe {
    lines: Option<SyncSender<String>>,
    writer: Option<JoinHandle<()>>,
    child: Box<dyn ChildWrapper>,
    n_dropped: u64,
    /// The command reads no more.
    is_over: bool,
}

impl MetricsPipe {
    /// Starts a command of the shell.
    ///
    /// # Errors
    ///
    /// If no shell, or no thread, can be started.
    ///
    /// # Panics
    ///
    /// Never: the pipe is asked for.
    pub fn start(command: &str) -> io::Result<Self> {
        let mut shell = Command::new("sh");
        // A learner's standard output has its results.
        shell.args(["-c", command]).stdin(Stdio::piped()).stdout(Stdio::null());
        // In a group of its own: Ctrl-C is for the learner, whose last lines the command is still to get.
        let mut child = CommandWrap::from(shell).wrap(ProcessGroup::leader()).spawn()?;
        let mut input = child.stdin().take().expect("the pipe was asked for");
        let (lines, waiting) = sync_channel::<String>(MAX_LINES);
        let writer = thread::Builder::new().name("metrics-pipe".to_owned()).spawn(move || {
            for line in waiting {
                if input.write_all(line.as_bytes()).is_err() {
                    return;
                }
            }
        })?;
        Ok(Self { lines: Some(lines), writer: Some(writer), child, n_dropped: 0, is_over: false })
    }

    /// Hands on a line, which ends with a line break.
    pub fn line(&mut self, line: String) {
        let Some(lines) = &self.lines else { return };
        match lines.try_send(line) {
            Ok(()) => {}
            Err(TrySendError::Full(_)) => {
                self.n_dropped += 1;
                if self.n_dropped == 1 {
                    warn!("the command of --metrics-to does not keep up: lines are dropped");
                }
            }
            Err(TrySendError::Disconnected(_)) => {
                if !std::mem::replace(&mut self.is_over, true) {
                    warn!("the command of --metrics-to reads no more: the run goes on without it");
                }
            }
        }
    }

    fn has_ended(&mut self) -> bool {
        !matches!(self.child.try_wait(), Ok(None))
    }
}

impl Drop for MetricsPipe {
    fn drop(&mut self) {
        // The thread writes what waits, and closes the command's input.
        drop(self.lines.take());
        let asked = Instant::now();
        while !self.has_ended() && asked.elapsed() < PATIENCE {
            thread::sleep(LOOK_EVERY);
        }
        if !self.has_ended() {
            warn!("the command of --metrics-to did not end in {PATIENCE:?} and is killed");
            drop(self.child.kill());
            drop(self.child.wait());
        }
        if self.n_dropped > 0 {
            let lines = counted(self.n_dropped, "line");
            warn!("{lines} for the command of --metrics-to were dropped");
        }
        // What it has started itself may hold the pipe on: its writer is waited for only where it is done.
        if let Some(writer) = self.writer.take()
            && writer.is_finished()
        {
            drop(writer.join());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wait_until(mut holds: impl FnMut() -> bool) {
        let started = Instant::now();
        while !holds() {
            assert!(started.elapsed() < Duration::from_mins(1), "it does not come to that");
            thread::sleep(LOOK_EVERY);
        }
    }

    #[test]
    fn a_command_gets_every_line_and_the_end() {
        let place = tempfile::tempdir().unwrap();
        let file = place.path().join("lines");
        let mut pipe = MetricsPipe::start(&format!("cat > '{}'", file.display())).unwrap();
        (0..100).for_each(|i| pipe.line(format!("{i}\n")));
        drop(pipe);
        let text = std::fs::read_to_string(file).unwrap();
        assert!(text.lines().eq((0..100).map(|i| i.to_string())), "{text}");
    }

    #[test]
    fn what_a_command_has_started_ends_with_it() {
        let place = tempfile::tempdir().unwrap();
        let file = place.path().join("id");
        let command = format!("sleep 600 & echo $! > '{}'; exec sleep 600", file.display());
        let pipe = MetricsPipe::start(&command).unwrap();
        let written = || std::fs::read_to_string(&file).unwrap_or_default();
        wait_until(|| written().ends_with('\n'));
        let stat = format!("/proc/{}/stat", written().trim());
        drop(pipe);
        // It was killed, and is gone as soon as the system has seen to it.
        wait_until(|| {
            let state = std::fs::read_to_string(&stat).unwrap_or_default();
            state.is_empty() || state.contains(") Z ")
        });
    }

    #[test]
    fn a_command_that_ends_or_never_reads_costs_nothing_but_its_lines() {
        let mut gone = MetricsPipe::start("exit 3").unwrap();
        let mut deaf = MetricsPipe::start("exec sleep 600").unwrap();
        // More than the pipe and the queue hold.
        let line = format!("{}\n", "x".repeat(1_000));
        for _ in 0..MAX_LINES + 200 {
            gone.line(line.clone());
            deaf.line(line.clone());
        }
        assert!(deaf.n_dropped > 0);
        let id = deaf.child.id();
        drop((gone, deaf));
        assert!(!std::path::Path::new(&format!("/proc/{id}")).exists(), "it is still there");
    }
}
