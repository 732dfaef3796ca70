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
    /// No rollouts, or rollouts out of order: results would depend on who arrived first.
    #[error("{0}")]
    Rollouts(String),
    /// Gradients, weights or outputs are no numbers any more, or so large that actors would send what every learner
    /// refuses.
    #[error("{0}: training has diverged")]
    Diverged(String),
    /// The system has no thread left.
    #[error("cannot start threads: {0}")]
    Threads(String),
    /// A state that belongs to another architecture.
    #[error("state does not fit this trainer: `{what}`")]
    State {
        /// The part that does not fit.
        what: String,
    },
}
