//! What a learner or an actor tells about itself over HTTP: numbers, and whether it is well (`--status ADDRESS`).
//!
//! ```text
//! the run's loop ── once per update, twice a second ──> numbers: atomics ──> scrape: /metrics
//!                                                   └─> health:  atomics ──> probe:  /live /ready /version
//! ```
//!
//! A scrape reads atomics and files, and never waits for the loop, nor the loop for a scrape. Every name is in
//! [`names`], which `docs/metrics.md` and the files under `deploy/grafana` are held against.

mod actor;
mod health;
mod learner;
mod machine;
pub(crate) mod names;
mod numbers;
mod server;

pub(crate) use actor::ActorStatus;
pub(crate) use learner::{LearnerFacts, LearnerStatus};
pub(crate) use server::StatusServer;
