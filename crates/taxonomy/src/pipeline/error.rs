//! Why a run stops: one sentence, with what a person needs to go on.

use std::path::{Path, PathBuf};

use thiserror::Error;

/// Why a database could not be made.
#[derive(Debug, Error)]
pub enum PipelineError {
    /// A file cannot be read or written.
    #[error("{}: {reason}", path.display())]
    File {
        /// The file that the system complained about.
        path: PathBuf,
        /// What the system says.
        reason: std::io::Error,
    },
    /// A plan, a template or a log that cannot be used, or a model that answers nonsense.
    #[error("{0}")]
    Unusable(String),
    /// A backend cannot answer.
    #[error(transparent)]
    Backend(#[from] BackendError),
    /// The number of calls that a run may make is spent; its log keeps what was paid.
    #[error("stopped after {calls} calls, as asked; run it again to go on")]
    BudgetSpent {
        /// Calls that were made in this run.
        calls: u64,
    },
}

impl PipelineError {
    /// Says which file the system complained about.
    pub(crate) fn file(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |reason| Self::File { path, reason }
    }

    /// Says which key is impossible, what was given and what would do.
    pub(crate) fn plan(key: &str, given: impl std::fmt::Display, allowed: &str) -> Self {
        Self::Unusable(format!("`{key}` of the plan is {given}; allowed: {allowed}"))
    }
}

/// Why a model or an embedder cannot answer.
#[derive(Debug, Error)]
pub enum BackendError {
    /// No server is there, or none that answers in time.
    #[error("the server at {url} cannot be reached after {tries} {}: {message}", if *tries == 1 { "try" } else { "tries" })]
    Unreachable {
        /// The address that was asked.
        url: String,
        /// How often it was tried.
        tries: u32,
        /// What the last try said.
        message: String,
    },
    /// The server refuses: waiting would not help.
    #[error("the server at {url} refuses with status {status}: {message}")]
    Refused {
        /// The address that was asked.
        url: String,
        /// HTTP status of its answer.
        status: u16,
        /// The start of its answer.
        message: String,
    },
    /// What answers in this process lacks something: weights, an annotation, the permission to ask.
    #[error("{0}")]
    Local(String),
}
