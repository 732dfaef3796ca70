//! Why a run cannot be watched.

use thiserror::Error;

/// Why a run cannot be watched.
#[derive(Debug, Error)]
pub enum Error {
    /// The network.
    #[error(transparent)]
    Link(#[from] leadtime_link::Error),
    /// What a learner answers is not what this release reads.
    #[error(
        "the learner's answer to the question {question} cannot be read: run the same release on both sides"
    )]
    Answer {
        /// What was asked.
        question: &'static str,
        /// What is wrong with the answer.
        source: serde_json::Error,
    },
    /// An answer that cannot be decompressed, or is far too large.
    #[error("the learner's history cannot be decompressed")]
    Compression(#[source] std::io::Error),
    /// A thread that plays episodes cannot be started.
    #[error("cannot start a thread for the playthrough")]
    Thread(#[source] std::io::Error),
}
