//! Which CPUs the processes of a run on this machine keep to.
//!
//! ```text
//! CPUs that we may use   0 1 2 3 4
//! learner                └─┬─┘ │ │    as many as threads share an update
//! actors                       1 2    one each
//!                              3 4    by turns
//! ```
//!
//! A process keeps to the CPUs of the thread that starts it, with its first step and with all its threads, those of the
//! network library among them; so does what it starts itself.

use std::fmt;
use std::io;

use leadtime_config::Config;
use leadtime_proto::phrase::counted;
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
use thiserror::Error;

use crate::learner_config::learner_threads;

/// The CPUs of a learner and of its actors; by default they may use all.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Placement {
    learner: Vec<usize>,
    /// An actor has one of them.
    actors: Vec<usize>,
}

/// Why learner and actors get no CPUs of their own.
#[derive(Debug, Error)]
pub enum NotPlaced {
    /// The learner would leave none to actors.
    #[error(
        "the learner trains on {}, which leaves none of {} to actors (see `learner.threads`)",
        counted(*n_threads, "thread"), counted(*n_cpus, "CPU")
    )]
    TooFew {
        /// CPUs of the learner.
        n_threads: usize,
        /// CPUs that this process may use.
        n_cpus: usize,
    },
    /// The system does not say.
    #[error("the system does not say which CPUs may be used: {0}")]
    Unknown(io::Error),
}

impl Placement {
    /// Gives a CPU to each thread that trains, and the others to actors.
    ///
    /// # Errors
    ///
    /// [`NotPlaced`] if there are too few, or the system does not say which there are.
    pub fn choose(config: &Config, n_actors: usize) -> Result<Self, NotPlaced> {
        let cpus = allowed().map_err(NotPlaced::Unknown)?;
        let n_threads = learner_threads(config, n_actors);
        Self::among(&cpus, n_threads).ok_or(NotPlaced::TooFew { n_threads, n_cpus: cpus.len() })
    }

    fn among(cpus: &[usize], n_threads: usize) -> Option<Self> {
        let (learner, actors) = cpus.split_at_checked(n_threads)?;
        (!actors.is_empty()).then(|| Self { learner: learner.to_vec(), actors: actors.to_vec() })
    }

    /// Returns the learner's CPUs; none if it may use all.
    pub(crate) fn of_learner(&self) -> &[usize] {
        &self.learner
    }

    /// Returns the CPU of an actor, the first of which is 0; none if it may use all.
    pub(crate) fn of_actor(&self, i: usize) -> &[usize] {
        self.actors.chunks(1).cycle().nth(i).unwrap_or_default()
    }

    /// Returns whether an actor runs on the CPUs of the learner.
    pub(crate) fn is_shared(&self) -> bool {
        self.learner.is_empty()
    }
}

impl fmt::Display for Placement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let list = |cpus: &[usize]| cpus.iter().map(usize::to_string).collect::<Vec<_>>().join(",");
        write!(f, "the learner to CPU {}, actors to {}", list(&self.learner), list(&self.actors))
    }
}

/// Lists the CPUs that this thread may use.
pub(crate) fn allowed() -> io::Result<Vec<usize>> {
    let set = sched_getaffinity(None)?;
    Ok((0..CpuSet::MAX_CPU).filter(|&cpu| set.is_set(cpu)).collect())
}

/// Starts a process that keeps to these CPUs, or may use all that this thread may if there are none.
pub(crate) fn start_on<T>(cpus: &[usize], start: impl FnOnce() -> io::Result<T>) -> io::Result<T> {
    let ours = sched_getaffinity(None)?;
    let mut theirs = CpuSet::new();
    // One that was taken away since the run began ends nothing.
    for &cpu in cpus.iter().filter(|&&cpu| ours.is_set(cpu)) {
        theirs.set(cpu);
    }
    if theirs.count() == 0 {
        return start();
    }
    sched_setaffinity(None, &theirs)?;
    let started = start();
    sched_setaffinity(None, &ours)?;
    started
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_learner_comes_first_and_actors_share_the_rest_by_turns() {
        let placement = Placement::among(&[0, 2, 4, 5, 7], 3).unwrap();
        assert_eq!(placement.of_learner(), [0, 2, 4]);
        assert_eq!([0, 1, 2].map(|i| placement.of_actor(i)), [[5], [7], [5]]);
        assert_eq!(placement.to_string(), "the learner to CPU 0,2,4, actors to 5,7");
        assert_eq!([2, 3].map(|n_threads| Placement::among(&[0, 1], n_threads)), [None, None]);
        let anywhere = Placement::default();
        assert!(anywhere.is_shared() && anywhere.of_actor(3).is_empty());
    }
}
