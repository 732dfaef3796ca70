//! What a learner or an actor tells about itself over HTTP: numbers, and whether it is well.
//!
//! ```text
//! the run's loop ── once per update, twice a second ──> numbers: atomics ──> scrape: /metrics
//!                                                   └─> health:  atomics ──> probe:  /live /ready /version
//! ```
//!
//! A scrape reads atomics and files, and never waits for the loop, nor the loop for a scrape. Every name is in
//! [`names`], which `docs/metrics.md` and the files under `deploy/grafana` are held against.
//!
//! # What it does not know
//!
//! Configurations, the files of a run, the command line: address, directory and names are handed to it. How HTTP is served
//! and guarded is `leadtime-web`'s.
//!
//! # Where to start
//!
//! [`StatusServer::bind`], then [`LearnerStatus::serve`] or [`ActorStatus::serve`].

mod actor;
mod health;
mod learner;
mod machine;
mod names;
mod numbers;
mod server;

pub use actor::ActorStatus;
pub use learner::{LearnerFacts, LearnerStatus};
pub use server::StatusServer;
