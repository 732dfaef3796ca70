//! The threads that share an update.
//!
//! Work is cut where its parts do not depend on each other, so who does which part changes no bit.

use std::sync::{Mutex, PoisonError};

use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::TrainError;

/// The training thread, and the threads that help it.
#[derive(Debug, Default)]
pub(crate) struct Team {
    helpers: Option<ThreadPool>,
}

impl Team {
    /// Starts all threads but the one that trains; an error if the system has none left.
    pub(crate) fn new(n_threads: usize) -> Result<Self, TrainError> {
        let n_helpers = n_threads.saturating_sub(1);
        if n_helpers == 0 {
            return Ok(Self::default());
        }
        let name = |i| format!("learner-train-{}", i + 1);
        let pool = ThreadPoolBuilder::new().num_threads(n_helpers).thread_name(name).build();
        Ok(Self { helpers: Some(pool.map_err(|error| TrainError::Threads(error.to_string()))?) })
    }

    /// Returns the number of threads.
    pub(crate) fn n_threads(&self) -> usize {
        1 + self.helpers.as_ref().map_or(0, ThreadPool::current_num_threads)
    }

    /// Does every task, each by one thread; they are begun in their order.
    pub(crate) fn for_each<T: Send>(
        &self,
        tasks: impl ExactSizeIterator<Item = T> + Send,
        work: impl Fn(T) + Sync,
    ) {
        let n_tasks = tasks.len();
        let Some(helpers) = self.helpers.as_ref().filter(|_| n_tasks > 1) else {
            return tasks.for_each(work);
        };
        // One queue: a helper that wakes late takes less.
        let queue = Mutex::new(tasks);
        let next = || queue.lock().unwrap_or_else(PoisonError::into_inner).next();
        let take_part = || {
            while let Some(task) = next() {
                work(task);
            }
        };
        helpers.in_place_scope(|scope| {
            for _ in 1..n_tasks.min(self.n_threads()) {
                scope.spawn(|_scope| take_part());
            }
            take_part();
        });
    }
}
