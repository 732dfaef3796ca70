//! Why a run cannot be watched.

use leadtime_link::Error as LinkError;
use leadtime_proto::RunName;
use thiserror::Error;

/// Why a run cannot be watched.
#[derive(Debug, Error)]
pub enum Error {
    /// The network cannot be used.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The learner was there, and answers no longer.
    #[error(
        "run `{run}` has no learner any more: it has just ended, or was cut off; on its host, `leadtime watch DIRECTORY` shows \
         what it left"
    )]
    LearnerGone {
        /// The run whose learner is gone.
        run: RunName,
        /// What was not answered.
        source: LinkError,
    },
    /// What a learner answers is not what this release reads.
    #[error(
        "the learner's answer to the question {question} cannot be read: run the same release on both sides"
    )]
    Answer {
        /// The question, as it is named in the sentence.
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
