//! What can be wrong with a script.

use leadtime_sims::TaskError;
use thiserror::Error;

/// Why a script cannot be used, or found.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the sentence of each variant names its fields")]
pub enum Error {
    #[error("line {line} of the script: {reason}")]
    Text { line: usize, reason: String },
    #[error("rule {rule}: {sentence}")]
    Rule { rule: usize, sentence: String },
    #[error("the script has {n} rules; allowed: at most {most}")]
    TooLong { n: usize, most: usize },
    #[error("no messages are sent in this task, so it has no scripts")]
    NoMessages,
    #[error(transparent)]
    Task(#[from] TaskError),
    #[error("episode {index} of the search did not end within {n_steps} steps")]
    Endless { index: u64, n_steps: u64 },
    #[error("the search was interrupted")]
    Interrupted,
    #[error("a thread for the search cannot be started")]
    Thread(#[source] std::io::Error),
}
