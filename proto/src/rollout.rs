//! What an actor sends: T consecutive steps of one environment under one policy version.
//!
//! A rollout may span episode ends, and it never spans a change of policy; so one [`PolicyVersion`] (and one
//! staleness) describes it. The last observation of a rollout is the first of the next. With it travels a
//! **snapshot** of everything the environment's future depends on, taken after the last step: whoever holds the
//! newest snapshot can go on as if nothing had happened.

use std::ops::Deref;

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
    /// Zero-based index of this rollout within its environment.
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

/// Room for what has no length of its own: ids, counts, the lengths of arrays.
const FRAME_BYTES: usize = 256;
/// The same for the end of an episode.
const END_BYTES: usize = 64;

impl Rollout {
    /// Returns an upper bound on the encoded size of a rollout, in bytes; S is the policy's recurrent width.
    pub fn max_bytes(env: &EnvSpec, recurrent_dim: usize, n_steps: usize) -> usize {
        let observation = 4 * env.obs_dim;
        // Observation, mask, choices, log-probability, value, reward.
        let step = observation + 8 + env.actions.heads.len() + 12;
        // An episode may end in every step.
        let end = observation + 4 * env.metrics.len() + END_BYTES;
        let rest = observation + 4 * recurrent_dim + limits::MAX_SNAPSHOT_BYTES + FRAME_BYTES;
        n_steps * (step + end) + rest
    }
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
    /// A number that no environment and no policy comes to.
    #[error("`{field}` is {found} at index {index}; {lowest} to {highest} are possible")]
    Magnitude {
        /// The field.
        field: &'static str,
        /// The first offending index.
        index: usize,
        /// As sent.
        found: f64,
        /// The lowest number that is possible.
        lowest: f64,
        /// The highest one.
        highest: f64,
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
    /// Checks shapes, ranges, finiteness and magnitudes against what the run agreed on.
    ///
    /// # Errors
    ///
    /// [`InvalidRollout`] names the first field that is wrong.
    pub fn check(
        self,
        spec: &EnvSpec,
        n_steps: usize,
        recurrent_dim: usize,
    ) -> Result<CheckedRollout, InvalidRollout> {
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
        plausible("observations", &self.observations)?;
        plausible("next_observation", &self.next_observation)?;
        within("log_probs", &self.log_probs, (limits::MIN_LOG_PROB, limits::MAX_LOG_PROB))?;
        plausible("values", &self.values)?;
        plausible("next_value", &[self.next_value])?;
        plausible("rewards", &self.rewards)?;
        plausible("recurrent", &self.recurrent)?;
        self.check_actions(spec)?;
        self.check_ends(spec, n_steps)?;
        Ok(CheckedRollout(self))
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
            plausible("final_observation", &end.final_observation)?;
            plausible("final_value", &[end.final_value])?;
            plausible("metrics", &end.summary.metrics)?;
            plausible("episode_return", &[end.summary.episode_return])?;
        }
        Ok(())
    }
}

/// A rollout that is what the run agreed on: [`Rollout::check`] made it, so nobody behind the receiver checks again.
#[derive(Clone, Debug, PartialEq)]
pub struct CheckedRollout(Rollout);

impl CheckedRollout {
    /// Moves the snapshot out: who trains on a rollout does not need it, and who hands out environments does.
    pub fn take_snapshot(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.0.snapshot)
    }
}

impl Deref for CheckedRollout {
    type Target = Rollout;

    fn deref(&self) -> &Rollout {
        &self.0
    }
}

fn length(field: &'static str, found: usize, expected: usize) -> Result<(), InvalidRollout> {
    if found == expected { Ok(()) } else { Err(InvalidRollout::Length { field, found, expected }) }
}

fn plausible<T: Copy + Into<f64>>(field: &'static str, values: &[T]) -> Result<(), InvalidRollout> {
    within(field, values, (-limits::MAX_MAGNITUDE, limits::MAX_MAGNITUDE))
}

/// Checks that every number is finite and in a closed range.
fn within<T: Copy + Into<f64>>(
    field: &'static str,
    values: &[T],
    (lowest, highest): (impl Into<f64>, impl Into<f64>),
) -> Result<(), InvalidRollout> {
    let (lowest, highest) = (lowest.into(), highest.into());
    let outside = |&value: &T| !(lowest..=highest).contains(&value.into());
    let Some(index) = values.iter().position(outside) else { return Ok(()) };
    let found: f64 = values[index].into();
    Err(if found.is_finite() {
        InvalidRollout::Magnitude { field, index, found, lowest, highest }
    } else {
        InvalidRollout::NonFinite { field, index }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ActionSpec;

    fn rollout() -> Rollout {
        let summary =
            EpisodeSummary { episode: 0, episode_return: 0.0, length: 1, metrics: vec![0.0] };
        let end = EpisodeEnd {
            step: 0,
            truncated: true,
            final_observation: vec![0.0],
            final_value: 0.0,
            summary,
        };
        Rollout {
            n_steps: 1,
            observations: vec![0.0],
            next_observation: vec![0.0],
            masks: vec![u64::MAX],
            actions: vec![0],
            log_probs: vec![0.0],
            values: vec![0.0],
            rewards: vec![0.0],
            ends: vec![end],
            recurrent: vec![0.0],
            snapshot: vec![1],
            ..Rollout::default()
        }
    }

    fn check(change: impl FnOnce(&mut Rollout)) -> Result<(), InvalidRollout> {
        let actions = ActionSpec::discrete("a", 2);
        let spec = EnvSpec { obs_dim: 1, actions, metrics: vec!["success".to_owned()] };
        let mut rollout = rollout();
        change(&mut rollout);
        rollout.check(&spec, 1, 1).map(drop)
    }

    /// A field's name, and how to set a number of it.
    type Field = (&'static str, fn(&mut Rollout, f32));

    #[test]
    fn no_number_may_be_absurd() {
        let fields: [Field; 10] = [
            ("observations", |r, x| r.observations[0] = x),
            ("next_observation", |r, x| r.next_observation[0] = x),
            ("values", |r, x| r.values[0] = x),
            ("next_value", |r, x| r.next_value = x),
            ("rewards", |r, x| r.rewards[0] = x),
            ("recurrent", |r, x| r.recurrent[0] = x),
            ("final_observation", |r, x| r.ends[0].final_observation[0] = x),
            ("final_value", |r, x| r.ends[0].final_value = x),
            ("metrics", |r, x| r.ends[0].summary.metrics[0] = x),
            ("episode_return", |r, x| r.ends[0].summary.episode_return = x.into()),
        ];
        for (name, set) in fields {
            for at_most in [1e9, -1e9] {
                assert_eq!(check(|r| set(r, at_most)), Ok(()), "{name}");
            }
            for absurd in [1.1e9, -3e38] {
                let found = check(|r| set(r, absurd));
                assert!(
                    matches!(found, Err(InvalidRollout::Magnitude { field, index: 0, .. }) if field == name),
                    "{name}: {found:?}"
                );
            }
            for no_number in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                let found = check(|r| set(r, no_number));
                let expected = Err(InvalidRollout::NonFinite { field: name, index: 0 });
                assert_eq!(found, expected);
            }
        }
        let beyond_f32 = check(|r| r.ends[0].summary.episode_return = 1e300);
        assert!(matches!(beyond_f32, Err(InvalidRollout::Magnitude { .. })), "{beyond_f32:?}");
    }

    #[test]
    fn a_log_probability_is_that_of_a_sampled_action() {
        for possible in [-1e4, -40.0, 0.0, 1e-3] {
            assert_eq!(check(|r| r.log_probs[0] = possible), Ok(()));
        }
        let error = check(|r| r.log_probs[0] = 0.5).unwrap_err().to_string();
        assert!(error.starts_with("`log_probs` is 0.5 at index 0; -10000 to 0.001"), "{error}");
        assert!(check(|r| r.log_probs[0] = -1.1e4).is_err());
        let nan = check(|r| r.log_probs[0] = f32::NAN);
        assert_eq!(nan, Err(InvalidRollout::NonFinite { field: "log_probs", index: 0 }));
    }
}
