//! Why a run stops: one sentence, with what a person needs to go on.

use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::error::TaxonomyError;

/// Why a database could not be made.
#[derive(Debug, Error)]
pub enum PipelineError {
    /// A file cannot be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The plan is no TOML of its form.
    #[error("line {line} of the plan: {message}")]
    PlanForm {
        /// Line, from 1.
        line: usize,
        /// What the reader says.
        message: String,
    },
    /// A key of the plan is impossible.
    #[error("`{key}` of the plan is {given}; allowed: {allowed}")]
    Plan {
        /// The key.
        key: String,
        /// What was given.
        given: String,
        /// What would do.
        allowed: String,
    },
    /// A prompt asks for something that nobody provides.
    #[error("prompt template `{template}` has the unknown variable `{variable}`; known: {known}")]
    UnknownVariable {
        /// The template.
        template: String,
        /// The variable.
        variable: String,
        /// What there is.
        known: String,
    },
    /// A prompt with an opening that never closes.
    #[error("prompt template `{template}` opens a variable on line {line} and never closes it")]
    OpenVariable {
        /// The template.
        template: String,
        /// Line, from 1.
        line: usize,
    },
    /// A line in the middle of a log that cannot be read.
    #[error("line {line} of the call log {} is damaged: {message}; only a torn last line is forgiven", path.display())]
    DamagedLog {
        /// The log.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What the reader says.
        message: String,
    },
    /// A log that was made by others.
    #[error("the call log {} was made for {found}, not for {expected}; give another log", path.display())]
    OtherLog {
        /// The log.
        path: PathBuf,
        /// What its first line says.
        found: String,
        /// What this run is.
        expected: String,
    },
    /// The log does not hold a reply, and nobody may be asked.
    #[error("the call log lacks the reply to {what}; the plan, a prompt or the log has changed")]
    NotInLog {
        /// Which call.
        what: String,
    },
    /// A backend cannot answer.
    #[error(transparent)]
    Backend(#[from] BackendError),
    /// Too many replies in a row are useless.
    #[error(
        "{malformed} of the last {window} replies of {model} are malformed: its template or the model is wrong"
    )]
    Malformed {
        /// Useless replies.
        malformed: usize,
        /// Out of how many.
        window: usize,
        /// Whose.
        model: String,
    },
    /// The number of calls that a run may make is spent; its log keeps what was paid.
    #[error("stopped after {calls} calls, as asked; run it again to go on")]
    BudgetSpent {
        /// Calls made.
        calls: u64,
    },
    /// What came out is no database.
    #[error("what came out cannot be used: {0}")]
    Output(#[from] TaxonomyError),
}

impl PipelineError {
    /// Says which file the system complained about.
    pub(crate) fn file(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::File { path, source }
    }
}

/// Why a model or an embedder cannot answer.
#[derive(Debug, Error)]
pub enum BackendError {
    /// Nobody there, or nobody who answers in time.
    #[error("the server at {url} cannot be reached after {tries} {}: {message}", if *tries == 1 { "try" } else { "tries" })]
    Unreachable {
        /// Where.
        url: String,
        /// How often it was tried.
        tries: u32,
        /// What the last try said.
        message: String,
    },
    /// The server refuses: waiting would not help.
    #[error("the server at {url} refuses with status {status}: {message}")]
    Refused {
        /// Where.
        url: String,
        /// HTTP status.
        status: u16,
        /// The start of its answer.
        message: String,
    },
    /// A file of weights that is not the one that was named.
    #[error("{} has sha256 {found}; expected {expected}", path.display())]
    WrongHash {
        /// The file.
        path: PathBuf,
        /// As computed.
        found: String,
        /// As named.
        expected: String,
    },
    /// The embedder cannot be loaded or run, or what it said cannot be read from the log.
    #[error("the embedder cannot be used: {message}")]
    Local {
        /// Why.
        message: String,
    },
    /// A log of annotations that lacks what was asked.
    #[error("the annotations lack {what}")]
    NotAnnotated {
        /// What.
        what: String,
    },
    /// A file of annotations that cannot be read.
    #[error("line {line} of the annotations: {message}")]
    Annotations {
        /// Line, from 1.
        line: usize,
        /// What is wrong.
        message: String,
    },
    /// Replay asks nobody.
    #[error("a replay asks nobody")]
    Replay,
}
