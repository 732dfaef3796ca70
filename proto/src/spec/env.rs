//! What an environment looks like from outside.

use serde::{Deserialize, Serialize};

use super::action::ActionSpec;

/// What an environment asks of a policy and tells about itself.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EnvSpec {
    /// Length of an observation vector.
    pub obs_dim: usize,
    /// The action space.
    pub actions: ActionSpec,
    /// Names of the metrics in an episode's summary, in order; `success` first where there is such a thing.
    pub metrics: Vec<String>,
}
