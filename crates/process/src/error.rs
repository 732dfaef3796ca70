//! Why something around a process's work cannot be had.

use std::io;
use std::path::PathBuf;

use thiserror::Error;

/// Why something around a process's work cannot be had.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the sentence of each variant names its fields")]
pub enum Error {
    /// The variable that says what is logged, and what is wrong with it.
    #[error("{0}; write a level (`debug`) or `module=level,...`")]
    Filter(String),
    #[error("cannot write a trace to {}", path.display())]
    Trace { path: PathBuf, source: io::Error },
}
