//! Acts: environments x behaviour policy -> rollouts.
//!
//! What this crate does not know: how a policy is trained, files, the command line. It learns everything about a
//! run (task, seed, policy's shape, schedule) from the learner's welcome.
//!
//! ```text
//!            ┌── collect: Worker (environments x policy)
//! network ── run ── Actor decides what to do about each thing that happens
//!            └── outbox, weight cache: what waits to be sent, and what acts
//! ```
//!
//! # Where to start
//!
//! [`Worker::collect`] makes rollouts and needs no network; [`Actor`] holds all decisions and can be driven without a
//! network, too; [`run()`] is the life of an actor process.

mod collect;
mod config;
mod error;
mod job_thread;
mod metrics;
mod outbox;
mod phases;
mod run;
mod sink;
mod state;
mod weight_cache;
mod worker;

pub use config::{ActorEnd, ActorProgress, ActorReport, ActorSettings};
pub use error::Error;
pub use outbox::EncodedRollout;
pub use run::{run, run_watched};
pub use sink::ActorSink;
pub use state::{Actor, ActorInput, ActorOutput, PUBLISHING};
pub use worker::{Phase, Stopwatch, Worker};
