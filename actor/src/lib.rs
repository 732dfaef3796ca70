//! Acts: environments x behaviour policy -> rollouts.
//!
//! What this crate does not know: how a policy is trained, files, the command line. It learns everything about a
//! run (task, seed, policy's shape, schedule) from the learner's welcome.
//!
//! ```text
//!            ┌── collect thread: Worker (slots x policy) ──┐
//! network ── run: one closed enum of things that happen ───┤
//!            └── publish thread: rollouts to the network ──┘
//! ```
//!
//! # Where to start
//!
//! [`Worker::collect`] makes rollouts and needs no network; [`run()`] is the life of an actor process.

mod config;
mod error;
mod greeting;
mod metrics;
mod outbox;
mod run;
mod shelf;
mod threads;
mod worker;

pub use config::{ActorEnd, ActorReport, ActorSettings};
pub use error::Error;
pub use run::run;
pub use worker::{Phase, Stopwatch, Worker, WorkerSettings};
