//! What can be wrong with a script.

use leadtime_sims::TaskError;
use thiserror::Error;

/// Why a script cannot be used, or found.
#[derive(Debug, Error)]
pub enum Error {
    /// The text is no script.
    #[error("no script can be read from it")]
    Text(#[from] toml::de::Error),
    /// There are too many rules, or a number is out of range.
    #[error("rule {rule}: {sentence}")]
    Rule {
        /// Which one, from 1 on.
        rule: usize,
        /// What is wrong, and what is allowed.
        sentence: String,
    },
    /// More rules than anybody would read.
    #[error("the script has {n} rules; allowed: at most {most}")]
    TooLong {
        /// How many there are.
        n: usize,
        /// How many may be.
        most: usize,
    },
    /// No messages are sent in the task.
    #[error("no messages are sent in this task, so it has no scripts")]
    NoMessages,
    /// The task cannot be made.
    #[error(transparent)]
    Task(#[from] TaskError),
    /// An episode does not come to an end.
    #[error("episode {index} of the search did not end within {n_steps} steps")]
    Endless {
        /// The index of the episode.
        index: u64,
        /// After how many steps it was given up.
        n_steps: u64,
    },
    /// The caller stopped it.
    #[error("the search was interrupted")]
    Interrupted,
    /// A thread cannot be started.
    #[error("a thread for the search cannot be started")]
    Thread(#[source] std::io::Error),
}
