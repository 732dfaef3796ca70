//! Why something around a process's work cannot be had.

use std::io;
use std::path::PathBuf;

use thiserror::Error;

/// Why something around a process's work cannot be had.
#[derive(Debug, Error)]
pub enum Error {
    /// What is to be logged is said in a way that cannot be read.
    #[error("{variable} {reason}; write a level (`debug`) or `module=level,...`")]
    Filter {
        /// Where it is said.
        variable: &'static str,
        /// What is wrong with it.
        reason: String,
    },
    /// The file of a trace cannot be made.
    #[error("cannot write a trace to {}", path.display())]
    Trace {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
}
