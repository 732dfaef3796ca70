//! Why a worker cannot be started, or was lost.

use std::io;

use leadtime_sims::TaskError;
use thiserror::Error;

/// Why environments cannot be stepped by a worker.
#[derive(Debug, Error)]
pub enum Error {
    /// The command came from somebody else.
    #[error(
        "this world is stepped by the command `{command}`, which came with the configuration of somebody else and is not \
         executed: give your own with --worker COMMAND, or allow this one with --trust-worker"
    )]
    NotTrusted {
        /// The command line of the worker.
        command: String,
    },
    /// Pickles of others would be read.
    #[error(
        "this run's environments move as pickles (world.snapshot = \"pickle\"), and reading somebody else's pickle may execute \
         anything: allow it with --trust-worker"
    )]
    PickleNotTrusted,
    /// The worker did not begin: it is not there, cannot import the environment, or says nothing.
    #[error("the worker `{command}` cannot be used: {reason}")]
    Start {
        /// The command line of the worker.
        command: String,
        /// The worker's own words, or what was missing.
        reason: String,
    },
    /// The worker steps other environments than those that the run is about.
    #[error(
        "the worker `{command}` steps other environments than this run: {what}; have the same code and packages everywhere, \
         or begin a new run"
    )]
    OtherWorld {
        /// The command line of the worker.
        command: String,
        /// What differs, with both values.
        what: String,
    },
    /// It died again and again.
    #[error("the worker `{command}` died {n_deaths} times {over}: {reason}")]
    Lost {
        /// The command line of the worker.
        command: String,
        /// How often it died.
        n_deaths: usize,
        /// Within which time, or without what in between.
        over: &'static str,
        /// How it died the last time, and its last words.
        reason: String,
    },
    /// It died, and its environments cannot be put back.
    #[error(
        "the worker `{command}` died: {reason}; with world.snapshot = \"none\" its environments cannot go on"
    )]
    NotPutBack {
        /// The command line of the worker.
        command: String,
        /// How it died, and its last words.
        reason: String,
    },
    /// The system refuses what a worker needs.
    #[error("no worker can be started here")]
    System(#[from] io::Error),
}

impl From<Error> for TaskError {
    fn from(error: Error) -> Self {
        Self::Outside(Box::new(error))
    }
}
