//! Why a run stops: one sentence, with what a person needs to go on.

use std::path::{Path, PathBuf};

use thiserror::Error;

/// Why a database could not be made.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the sentence of each variant names its fields")]
pub enum PipelineError {
    #[error("{}: {reason}", path.display())]
    File { path: PathBuf, reason: std::io::Error },
    /// A plan, a template or a log that cannot be used, or a model that answers nonsense.
    #[error("{0}")]
    Unusable(String),
    #[error(transparent)]
    Backend(#[from] BackendError),
    /// The log keeps what was paid.
    #[error("stopped after {calls} calls, as asked; run it again to go on")]
    BudgetSpent { calls: u64 },
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
#[expect(missing_docs, reason = "the sentence of each variant names its fields")]
pub enum BackendError {
    #[error("the server at {url} cannot be reached after {tries} {}: {message}", if *tries == 1 { "try" } else { "tries" })]
    Unreachable { url: String, tries: u32, message: String },
    /// Waiting would not help.
    #[error("the server at {url} refuses with status {status}: {message}")]
    Refused { url: String, status: u16, message: String },
    /// What answers in this process lacks something: weights, an annotation, the permission to ask.
    #[error("{0}")]
    Local(String),
}
