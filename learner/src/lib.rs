//! Learns: rollouts in, better policies out.
//!
//! The numeric half is a pure function of state and rollouts:
//!
//! ```text
//! settings   every setting of PPO            trainer   the update          state    what a checkpoint holds
//! gae, vtrace   returns and advantages       loss      PPO's loss, fused   adam     clip and optimiser
//! rewards    scale and normalisation         minibatch shuffled samples    network, dense_op   the graph
//! ```
//!
//! The runtime half carries rollouts to it and its policies to the actors:
//!
//! ```text
//! run        the loop                        coordinator  every decision, pure  orders, training  what it waits for
//! assign     who steps which environment     collect      rollouts that wait    roster            who is here
//! books      where every rollout went        checkpoint, resume  the disk       episodes, report  what it tells
//! ```
//!
//! # Where to start
//!
//! [`Trainer::update`] learns; [`run()`] is the life of a learner process.

pub mod adam;
pub mod assign;
mod attention_op;
mod batch;
pub mod books;
pub mod checkpoint;
pub mod collect;
pub mod config;
pub mod coordinator;
mod dense_op;
mod encoder;
pub mod episodes;
pub mod error;
mod files;
pub mod gae;
mod loss;
mod lstm_op;
pub mod minibatch;
mod network;
mod orders;
pub mod refusal;
pub mod report;
mod resume;
pub mod rewards;
pub mod roster;
pub mod run;
pub mod settings;
pub mod state;
mod storage;
#[cfg(test)]
mod test_support;
pub mod train_error;
pub mod trainer;
mod training;
pub mod vtrace;

pub use books::{Books, Imbalance};
pub use config::{CheckpointInterval, LearnerConfig};
pub use episodes::EpisodeMeans;
pub use error::Error;
pub use files::write_atomically;
pub use report::{
    PhaseTimes, ProgressSink, RatedPolicy, RunEnd, RunEvent, RunReport, UpdateProgress,
};
pub use run::{BEST_POLICY, run};
pub use settings::{LearnerSettings, Mode, SettingsError, Truncation};
pub use state::TrainerState;
pub use train_error::TrainError;
pub use trainer::{Trainer, UpdateReport};
