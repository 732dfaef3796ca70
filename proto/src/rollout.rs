//! What an actor sends: T consecutive steps of one environment under one policy version.
//!
//! A rollout may span episode ends, and it never spans a change of policy; so one [`PolicyVersion`] (and one
//! staleness) describes it. The last observation of a rollout is the first of the next. With it travels a
//! **snapshot** of everything the environment's future depends on, taken after the last step: whoever holds the
//! newest snapshot can go on as if nothing had happened.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::limits;
use crate::{EnvId, EnvSpec, Iteration, Mask, PolicyVersion, packed};

/// What is told about an episode that ended inside a rollout.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EpisodeSummary {
    /// Index of the episode in its environment, from 0.
    pub episode: u64,
    /// Undiscounted sum of the raw rewards.
    pub episode_return: f64,
    /// Steps.
    pub length: u32,
    /// The environment's metrics, in the order of [`EnvSpec::metrics`].
    pub metrics: Vec<f32>,
}

/// The end of an episode at one step of a rollout.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EpisodeEnd {
    /// The step whose transition ended the episode, `0..n_steps`.
    pub step: u32,
    /// A time limit (bootstrap from `final_value`) and not a true end (discount 0).
    pub truncated: bool,
    /// The last observation of the episode, before the reset. Shape `[obs_dim]`.
    #[serde(with = "packed")]
    pub final_observation: Vec<f32>,
    /// The behaviour policy's value of `final_observation`; 0 at a true end.
    pub final_value: f32,
    /// What happened in the episode.
    pub summary: EpisodeSummary,
}

/// T consecutive steps of one environment, all acted by one policy version.
///
/// # Shapes
///
/// T = `n_steps`, D = `obs_dim`, H = number of heads, S = the policy's recurrent width (0 if there is none).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Rollout {
    /// The environment.
    pub env_id: EnvId,
    /// The how-manieth rollout of this environment, from 0.
    pub iteration: Iteration,
    /// The version of the policy that acted.
    pub version: PolicyVersion,
    /// T.
    pub n_steps: u32,
    /// Raw (not normalised) observations that were acted on. `[T, D]`
    #[serde(with = "packed")]
    pub observations: Vec<f32>,
    /// The observation after the last step (after a reset, if the last step ended an episode). `[D]`
    #[serde(with = "packed")]
    pub next_observation: Vec<f32>,
    /// Offered choices, one [`Mask`] word per step. `[T]`
    #[serde(with = "packed")]
    pub masks: Vec<u64>,
    /// Sampled choices. `[T, H]`
    #[serde(with = "packed")]
    pub actions: Vec<u8>,
    /// Behaviour log-probabilities of the actions under the policy's head credit. `[T]`
    #[serde(with = "packed")]
    pub log_probs: Vec<f32>,
    /// Behaviour values of the observations. `[T]`
    #[serde(with = "packed")]
    pub values: Vec<f32>,
    /// Behaviour value of `next_observation`.
    pub next_value: f32,
    /// Raw rewards. `[T]`
    #[serde(with = "packed")]
    pub rewards: Vec<f32>,
    /// Episodes that ended, in order of their steps.
    pub ends: Vec<EpisodeEnd>,
    /// Recurrent state before the first step. `[S]`
    #[serde(with = "packed")]
    pub recurrent: Vec<f32>,
    /// The environment after the last step: opaque to everyone but the actor.
    #[serde(with = "serde_bytes")]
    pub snapshot: Vec<u8>,
}

/// Why a decoded rollout cannot be used.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum InvalidRollout {
    /// Another number of steps than the run uses.
    #[error("rollout has {found} steps, the run uses {expected}")]
    Steps {
        /// As sent.
        found: usize,
        /// As agreed.
        expected: usize,
    },
    /// A field of the wrong length.
    #[error("`{field}` has length {found}, expected {expected}")]
    Length {
        /// The field.
        field: &'static str,
        /// As sent.
        found: usize,
        /// As the specification demands.
        expected: usize,
    },
    /// A NaN or an infinity.
    #[error("`{field}` holds a value that is not finite at index {index}")]
    NonFinite {
        /// The field.
        field: &'static str,
        /// The first offending index.
        index: usize,
    },
    /// A choice that could not have been sampled.
    #[error("step {step} has an action that its mask does not allow")]
    Action {
        /// The step.
        step: usize,
    },
    /// Episode ends out of range or out of order.
    #[error("episode end {index} is out of range or out of order")]
    End {
        /// Index into the ends.
        index: usize,
    },
    /// A snapshot over the limit, or none.
    #[error("snapshot has {found} bytes; 1 to {limit} are possible", limit = limits::MAX_SNAPSHOT_BYTES)]
    Snapshot {
        /// As sent.
        found: usize,
    },
}

impl Rollout {
    /// Checks shapes, ranges and finiteness against what the run agreed on.
    ///
    /// # Errors
    ///
    /// [`InvalidRollout`] naming the first field that is wrong.
    pub fn check(
        &self,
        spec: &EnvSpec,
        n_steps: usize,
        recurrent_dim: usize,
    ) -> Result<(), InvalidRollout> {
        if self.n_steps as usize != n_steps {
            return Err(InvalidRollout::Steps { found: self.n_steps as usize, expected: n_steps });
        }
        let n_heads = spec.actions.heads.len();
        length("observations", self.observations.len(), n_steps * spec.obs_dim)?;
        length("next_observation", self.next_observation.len(), spec.obs_dim)?;
        length("masks", self.masks.len(), n_steps)?;
        length("actions", self.actions.len(), n_steps * n_heads)?;
        length("log_probs", self.log_probs.len(), n_steps)?;
        length("values", self.values.len(), n_steps)?;
        length("rewards", self.rewards.len(), n_steps)?;
        length("recurrent", self.recurrent.len(), recurrent_dim)?;
        if !(1..=limits::MAX_SNAPSHOT_BYTES).contains(&self.snapshot.len()) {
            return Err(InvalidRollout::Snapshot { found: self.snapshot.len() });
        }
        finite("observations", &self.observations)?;
        finite("next_observation", &self.next_observation)?;
        finite("log_probs", &self.log_probs)?;
        finite("values", &self.values)?;
        finite("next_value", &[self.next_value])?;
        finite("rewards", &self.rewards)?;
        finite("recurrent", &self.recurrent)?;
        self.check_actions(spec)?;
        self.check_ends(spec, n_steps)
    }

    fn check_actions(&self, spec: &EnvSpec) -> Result<(), InvalidRollout> {
        let n_heads = spec.actions.heads.len();
        let steps = self.actions.chunks_exact(n_heads).zip(&self.masks).enumerate();
        for (step, (action, &mask)) in steps {
            if !spec.actions.allows(Mask(mask), action) {
                return Err(InvalidRollout::Action { step });
            }
        }
        Ok(())
    }

    fn check_ends(&self, spec: &EnvSpec, n_steps: usize) -> Result<(), InvalidRollout> {
        let mut earliest = 0;
        for (index, end) in self.ends.iter().enumerate() {
            let step = end.step as usize;
            if step < earliest || step >= n_steps {
                return Err(InvalidRollout::End { index });
            }
            earliest = step + 1;
            length("final_observation", end.final_observation.len(), spec.obs_dim)?;
            length("metrics", end.summary.metrics.len(), spec.metrics.len())?;
            finite("final_observation", &end.final_observation)?;
            finite("final_value", &[end.final_value])?;
            finite("metrics", &end.summary.metrics)?;
            finite("episode_return", &[end.summary.episode_return as f32])?;
        }
        Ok(())
    }
}

fn length(field: &'static str, found: usize, expected: usize) -> Result<(), InvalidRollout> {
    if found == expected { Ok(()) } else { Err(InvalidRollout::Length { field, found, expected }) }
}

fn finite(field: &'static str, values: &[f32]) -> Result<(), InvalidRollout> {
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(index) => Err(InvalidRollout::NonFinite { field, index }),
    }
}
