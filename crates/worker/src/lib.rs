//! Worlds in Python: worker processes that step environments for a process of Leadtime, and the domain `python`.
//!
//! What this crate does not know: actors, learners, the wire between them, how a policy learns, which command may run what.
//!
//! ```text
//! Lockstep ── announce, step ──► PythonEnvironment ─┐
//! Lockstep ── announce, step ──► PythonEnvironment ─┼─► WorkerLink ══ unix socket ══► worker process: many environments
//! Lockstep ── announce, step ──► PythonEnvironment ─┘        one frame for the steps of a batch, one back
//! ```
//!
//! A [`PythonEnvironment`](environment) is an [`Environment`](leadtime_sims::Environment) like any other. Its step is announced
//! before it is taken, so those of a batch travel together. A worker that dies is started again, and its environments are put
//! back where they were: from their seeds and actions, or from a pickle. So nothing above notices.
//!
//! # Where to start
//!
//! [`entry()`] makes the domain; [`Workers`] holds the processes and says what may be executed; the protocol is
//! [`protocol`]'s, and its other side is `python/leadtime/worker.py`.

mod check;
mod deaths;
mod entry;
mod environment;
mod error;
mod launch;
mod link;
mod pickle;
mod pool;
mod process;
pub mod protocol;
mod settings;
mod slot;
mod trial;

pub use check::{WorkerReport, check_worker};
pub use entry::entry;
pub use error::Error;
pub use pool::{Permission, WorkerRules, Workers};
pub use settings::{DOMAIN, PythonSettings, SnapshotKind, SpecSetting, WorldSpec};
