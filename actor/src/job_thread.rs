//! A thread beside the actor's loop that does one kind of job.
//!
//! The loop gives it at most a known number of jobs at once, so handing one over never waits. The thread ends when its
//! end of the loop is dropped, which waits a moment for it: what the thread owns, environments among it, is closed by
//! the thread, and a process that has ended closes nothing. Several threads are told first and waited for together.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use tokio::sync::mpsc;

use crate::Error;

/// How long a thread that is no longer needed may take to end: a little longer than environments may take to close.
pub(crate) const ENDING: Duration = Duration::from_millis(2_500);

/// The loop's end of the thread.
#[derive(Debug)]
pub(crate) struct JobThread<J, R> {
    name: &'static str,
    /// `None` once the thread is to end.
    jobs: Option<SyncSender<J>>,
    results: mpsc::Receiver<R>,
    /// Closed when the thread has given up all that it had.
    ended: Receiver<()>,
    /// Until when dropping this waits for it; `None` until the thread is told to end.
    deadline: Option<Instant>,
}

impl<J, R> JobThread<J, R> {
    /// Tells the thread to end after the job that it has, and waits for nothing: dropping this waits, until the deadline at
    /// the latest. Returns the deadline that counts, which is the first.
    pub(crate) fn end_by(&mut self, deadline: Instant) -> Instant {
        self.jobs = None;
        self.results.close();
        *self.deadline.get_or_insert(deadline)
    }
}

impl<J, R> Drop for JobThread<J, R> {
    fn drop(&mut self) {
        let now = Instant::now();
        let left = self.end_by(now + ENDING).saturating_duration_since(now);
        // Nothing is ever sent: this ends with the thread, or with the time.
        let (Ok(()) | Err(_)) = self.ended.recv_timeout(left);
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
        Ok(Self { name, jobs: Some(jobs), results, ended, deadline: None })
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

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Barrier};

    use super::*;

    /// Takes until all of its kind are closed at once.
    struct ClosedWithOthers(Arc<Barrier>);

    impl Drop for ClosedWithOthers {
        fn drop(&mut self) {
            self.0.wait();
        }
    }

    #[test]
    fn threads_are_all_told_to_end_before_the_first_is_waited_for() {
        let barrier = Arc::new(Barrier::new(3));
        let start = |_| {
            let owned = ClosedWithOthers(Arc::clone(&barrier));
            let work = move |(): ()| drop(Arc::clone(&owned.0));
            JobThread::start("test", 1, work).unwrap()
        };
        let mut threads: Vec<_> = (0..3).map(start).collect();
        let deadline = Instant::now() + ENDING;
        for thread in &mut threads {
            thread.end_by(deadline);
        }
        drop(threads);
        assert!(Instant::now() < deadline, "the first closes only together with the others");
    }

    #[test]
    fn several_threads_that_do_not_end_are_waited_for_no_longer_than_one() {
        let start = |_| {
            let (release, gate) = sync_channel::<()>(0);
            let thread = JobThread::start("test", 1, move |(): ()| gate.recv().is_ok()).unwrap();
            thread.begin(()).unwrap();
            (thread, release)
        };
        let mut busy: Vec<_> = (0..3).map(start).collect();
        let started = Instant::now();
        for (thread, _) in &mut busy {
            thread.end_by(started + ENDING / 10);
        }
        let releases: Vec<_> = busy.into_iter().map(|(_thread, release)| release).collect();
        assert!(started.elapsed() < ENDING, "{:?}", started.elapsed());
        drop(releases);
    }
}
