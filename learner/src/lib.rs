//! Runs the learning: carries rollouts to the trainer ([`leadtime_ppo`]) and its policies to the actors.
//!
//! ```text
//! run        the loop                        coordinator  every decision, pure  orders, training  what it waits for
//! assign     who steps which environment     collect      rollouts that wait    roster            who is here
//! books      where every rollout went        checkpoint, resume  the disk       episodes, report  what it reports
//! ```
//!
//! # What it does not know
//!
//! How an update is computed: tensors, losses and optimisers are the trainer's. How a world moves, and how messages
//! travel.
//!
//! # Where to start
//!
//! [`run()`] is the life of a learner process, [`coordinator::Coordinator`] its decisions.

pub mod assign;
pub mod books;
pub mod checkpoint;
pub mod collect;
pub mod config;
pub mod coordinator;
pub mod episodes;
pub mod error;
mod files;
mod orders;
pub mod report;
mod resume;
pub mod roster;
pub mod run;
mod training;

pub use books::{Books, Imbalance};
pub use config::{CheckpointInterval, LearnerConfig};
pub use episodes::EpisodeMeans;
pub use error::Error;
pub use files::write_atomically;
pub use report::{
    PhaseTimes, ProgressSink, RatedPolicy, RunEnd, RunEvent, RunReport, UpdateProgress,
};
pub use run::{BEST_POLICY, run};
