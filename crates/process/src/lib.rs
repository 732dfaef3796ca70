//! What a process of Leadtime has around its work, whichever command it carries out.
//!
//! ```text
//! log    logging: what is logged, and how ──> log_line: as JSON ──> log_file, or a writer of the caller's
//!        refused: who is refused at the door, from the network library's warnings
//! end    shutdown: signals, supervisor, deadline ──> one token
//! files  new_file: nothing of the user's is overwritten                 trace_file: the file of a trace
//! out    metrics_pipe: every update's metrics, for a command of the user's own
//! ```
//!
//! # What it does not know
//!
//! Arguments, variables that a person sets, standard output, exit codes: the caller reads and writes them. It neither prints
//! nor exits: the caller says who writes lines of the log, and how the process ends. It does not know what the work is.
//!
//! # Where to start
//!
//! [`logging::start`], then [`shutdown::watch`].

mod error;
pub mod log_file;
pub mod log_line;
pub mod logging;
mod metrics_pipe;
mod new_file;
mod refused;
pub mod shutdown;
mod trace_file;

pub use error::Error;
pub use metrics_pipe::MetricsPipe;
pub use new_file::NewFile;
pub use trace_file::{ProcessTrace, TraceFile};
