//! What can go wrong in an update.

use thiserror::Error;

use crate::settings::SettingsError;

/// Why a trainer cannot be made, restored, or make an update.
#[derive(Debug, Error)]
pub enum TrainError {
    /// A setting is out of range.
    #[error("settings cannot be used")]
    Settings(#[from] SettingsError),
    /// Parameters and architecture do not fit together.
    #[error("policy cannot be used")]
    Policy(#[from] leadtime_policy::Error),
    /// The tensor engine refused.
    #[error("tensor operation failed")]
    Tensor(#[from] candle_core::Error),
    /// An update without a rollout.
    #[error("an update needs at least one rollout")]
    NoRollouts,
    /// Rollouts out of order: results would depend on who arrived first.
    #[error("rollouts are not sorted by environment id and iteration at index {index}")]
    Unsorted {
        /// The first one that is out of order.
        index: usize,
    },
    /// A gradient is no number any more.
    #[error("gradient norm of minibatch {minibatch} is {norm}: training has diverged")]
    DivergedGradient {
        /// Index within the update, over all epochs.
        minibatch: usize,
        /// The norm over all gradients: NaN or infinite.
        norm: f64,
    },
    /// Weights are so large that actors would send numbers which every learner refuses.
    #[error("magnitudes of tensor `{name}` sum up to {sum:e}: training has diverged")]
    DivergedWeights {
        /// The first such tensor.
        name: String,
        /// NaN, infinite, or far beyond any weights that learn.
        sum: f64,
    },
    /// The policy computes numbers that no rollout may hold.
    #[error("the policy's outputs reach {largest:e}: training has diverged")]
    DivergedOutputs {
        /// The largest magnitude of a logit or value; infinite where one is no number.
        largest: f64,
    },
    /// A state that belongs to another architecture.
    #[error("state does not fit this trainer: `{what}`")]
    State {
        /// The part that does not fit.
        what: String,
    },
}
