//! Proximal policy optimisation: rollouts in, better parameters out.
//!
//! ```text
//! settings   every setting of PPO            trainer   the update                      state    what a checkpoint holds
//! gae, vtrace   advantages and targets       stacks    actor and critic, both ways     adam     clip and optimiser
//! rewards    scale and normalisation         loss      PPO's loss, row by row          team     threads
//! minibatch  shuffled samples                encoder   LSTM and attention, both ways; dense, outer, network
//! checkpoints   what is saved of a run, and how often, as settings
//! ```
//!
//! An update is a pure function of the trainer's state and the rollouts: the same bits on every run, whoever acted
//! and in whichever order the rollouts arrived.
//!
//! # What it does not know
//!
//! Actors, environments, networks, files and clocks. Rollouts are trained on as they are: a
//! [`CheckedRollout`](leadtime_proto::CheckedRollout) is one whose receiver has checked it.
//!
//! # Where to start
//!
//! [`Trainer::update`].

mod adam;
mod batch;
pub mod checkpoints;
mod dense;
mod encoder;
pub mod error;
mod gae;
mod loss;
mod minibatch;
mod network;
mod outer;
#[cfg(test)]
#[path = "../benches/random_rollouts/mod.rs"]
mod random_rollouts;
mod rewards;
pub mod settings;
mod stacks;
pub mod state;
mod storage;
mod team;
#[cfg(test)]
mod test_support;
pub mod trainer;
mod vtrace;

pub use error::TrainError;
pub use settings::{LearnerSettings, Mode, SettingsError, Truncation};
pub use state::TrainerState;
pub use trainer::{Trainer, UpdateReport};
