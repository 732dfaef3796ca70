//! Runs the learning: carries rollouts to the trainer ([`leadtime_ppo`]) and its policies to the actors.
//!
//! ```text
//! run      the loop                     coordinator    every decision, pure     control_outbox, training  it waits for
//! assign   who steps which environment  rollout_queue  rollouts that wait       roster, stragglers        who is here, or late
//! books    where every rollout went     checkpoint, resume  the disk            episodes, report, builds  what it reports
//! held_out what evaluates a policy       held_out_record  which one is the best  evaluation_thread   beside the training
//! ending   how a run ends          bulletin       what observers receive      saving   while the disk is full
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

mod assign;
pub mod books;
pub mod builds;
mod bulletin;
pub mod checkpoint;
pub mod config;
mod control_outbox;
pub mod coordinator;
mod ending;
pub mod episodes;
pub mod error;
mod evaluation_thread;
mod files;
pub mod held_out;
mod held_out_record;
mod phases;
pub mod report;
mod resume;
pub mod rollout_queue;
mod roster;
pub mod run;
mod saving;
mod stragglers;
mod training;

pub use books::{Books, Imbalance};
pub use builds::{Build, Builds};
pub use config::LearnerConfig;
pub use episodes::EpisodeMeans;
pub use error::Error;
pub use files::{PartialFile, lock_file, replaced_name, write_atomically};
pub use held_out::{HeldOutEpisode, HeldOutEvaluation, HeldOutMeans, PolicyEvaluator};
pub use report::{
    PhaseTimes, ProgressSink, RatedPolicy, RosterEntry, RunEnd, RunEvent, RunHealth, RunReport,
    UpdateProgress,
};
pub use roster::MembershipNumber;
pub use run::{RunStop, run};
