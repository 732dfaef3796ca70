//! A thread beside the actor's loop that does one kind of job.
//!
//! The loop gives it at most a known number of jobs at once, so handing one over never waits. The thread ends when its
//! end of the loop is dropped.

use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread;

use tokio::sync::mpsc;

use crate::Error;

/// The loop's end of the thread.
#[derive(Debug)]
pub(crate) struct JobThread<J, R> {
    name: &'static str,
    jobs: SyncSender<J>,
    results: mpsc::Receiver<R>,
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
        let run = move || {
            while let Ok(job) = inbox.recv() {
                if outbox.blocking_send(work(job)).is_err() {
                    return; // The actor is leaving and nobody waits for the result.
                }
            }
        };
        thread::Builder::new().name(name.to_owned()).spawn(run).map_err(Error::Thread)?;
        Ok(Self { name, jobs, results })
    }

    /// Hands a job over.
    pub(crate) fn begin(&self, job: J) -> Result<(), Error> {
        self.jobs.try_send(job).map_err(|_gone| Error::ThreadGone(self.name))
    }

    /// Waits for the next result.
    pub(crate) async fn result(&mut self) -> Result<R, Error> {
        self.results.recv().await.ok_or(Error::ThreadGone(self.name))
    }
}
