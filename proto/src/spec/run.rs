//! What a run is about: the task, what it looks like, who plays it, and in which order acting and learning go.

use serde::{Deserialize, Serialize};

use super::action::EnvSpec;
use super::error::SpecError;
use super::policy::PolicySpec;
use crate::{Schedule, limits};

/// Which task, with which settings; only the crate that builds the task understands the settings.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskSpec {
    /// The domain's name: `lander`, `pilot`, `cartpole` or one of the user's own; part of keys and file names.
    pub domain: String,
    /// The checked settings as JSON.
    pub settings: String,
}

/// Everything that learner and actors of one run agree on: equal specifications and equal weights give equal rollouts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunSpec {
    /// Seed of every random stream.
    pub seed: u64,
    /// What to simulate: the domain and its settings.
    pub task: TaskSpec,
    /// What the simulation must look like; an actor whose task differs says so and leaves.
    pub env: EnvSpec,
    /// What the weights are for.
    pub policy: PolicySpec,
    /// T, the steps in every rollout.
    pub n_steps: u32,
    /// Who waits for whom.
    pub schedule: Schedule,
}

impl RunSpec {
    /// Checks what is used without further checks from here on: whoever acts or trains by it relies on this.
    ///
    /// # Errors
    ///
    /// [`SpecError`] if the action space or the encoder is impossible, the policy is for another environment, or a
    /// rollout would be empty or too long.
    pub fn check(&self) -> Result<(), SpecError> {
        self.policy.check()?;
        if self.policy.obs_dim != self.env.obs_dim || self.policy.actions != self.env.actions {
            return Err(SpecError::Policy);
        }
        if !(1..=limits::MAX_ROLLOUT_STEPS).contains(&(self.n_steps as usize)) {
            return Err(SpecError::Steps(self.n_steps));
        }
        Ok(())
    }
}
