//! A thread beside the actor's loop that does one kind of job.
//!
//! The loop gives it at most a known number of jobs at once, so handing one over never waits. The thread ends when its
//! end of the loop is dropped, which waits a moment for it: what the thread owns, environments among it, is closed by
//! the thread, and a process that has ended closes nothing.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;

use tokio::sync::mpsc;

use crate::Error;

/// How long a thread that is no longer needed may take to end: a little longer than environments may take to close.
const ENDING: Duration = Duration::from_millis(2_500);

/// The loop's end of the thread.
#[derive(Debug)]
pub(crate) struct JobThread<J, R> {
    name: &'static str,
    /// `None` once the thread is to end.
    jobs: Option<SyncSender<J>>,
    results: mpsc::Receiver<R>,
    /// Closed when the thread has given up all that it had.
    ended: Receiver<()>,
}

impl<J, R> Drop for JobThread<J, R> {
    fn drop(&mut self) {
        self.jobs = None;
        self.results.close();
        // Nothing is ever sent: this ends with the thread, or with the time.
        let (Ok(()) | Err(_)) = self.ended.recv_timeout(ENDING);
    }
}

impl<J: Send + 'static, R: Send + 'static> JobThread<J, R> {
    /// Starts the thread, which can have `depth` jobs at once.
    pub(crate) fn start(
        name: &'static str,
        depth: usize,
        mut work: impl FnMut(J) -> R + Send + 'static,
    ) -> Result<Self, Error> {
        let (jobs, inbox) = sync_channel(depth);
        let (outbox, results) = mpsc::channel(depth);
        let (ends, ended) = sync_channel::<()>(0);
        let run = move || {
            while let Ok(job) = inbox.recv() {
                if outbox.blocking_send(work(job)).is_err() {
                    break; // The actor is leaving and nobody waits for the result.
                }
            }
            drop(work);
            drop(ends);
        };
        thread::Builder::new().name(name.to_owned()).spawn(run).map_err(Error::Thread)?;
        Ok(Self { name, jobs: Some(jobs), results, ended })
    }

    /// Hands a job over.
    pub(crate) fn begin(&self, job: J) -> Result<(), Error> {
        let sent = self.jobs.as_ref().is_some_and(|jobs| jobs.try_send(job).is_ok());
        if sent { Ok(()) } else { Err(Error::ThreadGone(self.name)) }
    }

    /// Waits for the next result.
    pub(crate) async fn result(&mut self) -> Result<R, Error> {
        self.results.recv().await.ok_or(Error::ThreadGone(self.name))
    }
}
