//! What can go wrong in an update.

use leadtime_proto::EnvId;
use leadtime_proto::rollout::InvalidRollout;
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
    /// A rollout that cannot be trained on.
    #[error("rollout of environment {env_id} cannot be trained on")]
    Rollout {
        /// Its environment.
        env_id: EnvId,
        /// What is wrong with it.
        #[source]
        source: InvalidRollout,
    },
    /// Rollouts out of order: results would depend on who arrived first.
    #[error("rollouts are not sorted by environment id and iteration at index {index}")]
    Unsorted {
        /// The first one that is out of order.
        index: usize,
    },
    /// Training has diverged.
    #[error("gradient norm of minibatch {minibatch} is {norm}: training has diverged")]
    Diverged {
        /// Index within the update, over all epochs.
        minibatch: usize,
        /// NaN or infinite.
        norm: f64,
    },
    /// A state that belongs to another architecture.
    #[error("state does not fit this trainer: `{what}`")]
    State {
        /// The part that does not fit.
        what: String,
    },
}
