//! What an actor sends: T consecutive steps of one environment under one policy version.
//!
//! A rollout may span episode ends, and it never spans a change of policy; so one [`PolicyVersion`] (and one
//! staleness) describes it. The last observation of a rollout is the first of the next. With it travels a
//! **snapshot** of everything the environment's future depends on, taken after the last step: whoever holds the
//! newest snapshot can go on as if nothing had happened.

use std::mem;
use std::ops::Deref;

use serde::{Deserialize, Serialize};

use crate::refusal::{Refusal, RefusalCause};
use crate::{
    EnvId, EnvSpec, Iteration, Mask, PolicyVersion, RowOverlap, RowRepeats, limits, packed,
};

/// What is reported about an episode that ended inside a rollout.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EpisodeSummary {
    /// Index of the episode in its environment, from 0.
    pub episode: u64,
    /// Undiscounted sum of the raw rewards.
    pub episode_return: f64,
    /// Steps from its first observation to its end.
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
    /// The environment that was stepped.
    pub env_id: EnvId,
    /// Zero-based index of this rollout within its environment.
    pub iteration: Iteration,
    /// The version of the policy that acted.
    pub version: PolicyVersion,
    /// T, the same in every rollout of a run.
    pub n_steps: u32,
    /// Raw (not normalised) observations that were acted on. `[T, D]`, less what `repeats` leaves out.
    #[serde(with = "packed")]
    pub observations: Vec<f32>,
    /// What is left out of `observations` on the wire; nothing in a [`CheckedRollout`].
    pub repeats: RowRepeats,
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
    /// Rewards as the environment gave them, not scaled. `[T]`
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
        n_steps * (step + end) + RowRepeats::max_bytes(n_steps) + rest
    }

    /// Leaves out of each observation, of `obs_dim` numbers, what it repeats of the one before; [`Rollout::check`] puts it
    /// back. What was left out already stays so.
    pub fn leave_out_repeats(&mut self, overlap: RowOverlap, obs_dim: usize) {
        if self.repeats == RowRepeats::default() {
            self.repeats = RowRepeats::take_out(&mut self.observations, obs_dim, overlap);
        }
    }

    /// Checks shapes, ranges, finiteness and magnitudes against what the run agreed on.
    ///
    /// # Errors
    ///
    /// [`Refusal`] without a sender, for the first fault that is found: [`RefusalCause::Shape`] if a length is not what
    /// the run agreed on, [`RefusalCause::Snapshot`] if there is none or it is too large, [`RefusalCause::NonFinite`]
    /// and [`RefusalCause::Magnitude`] for numbers, [`RefusalCause::Action`] if a mask does not offer an action,
    /// [`RefusalCause::EpisodeEnd`] if ends are out of range or order.
    pub fn check(
        mut self,
        spec: &EnvSpec,
        n_steps: usize,
        recurrent_dim: usize,
    ) -> Result<CheckedRollout, Refusal> {
        if self.n_steps as usize != n_steps {
            let text = format!("rollout has {} steps, the run uses {n_steps}", self.n_steps);
            return Err(Refusal::new(RefusalCause::Shape, text));
        }
        let n_heads = spec.actions.heads.len();
        // Lengths before values: everything below indexes by them.
        let n_observed = self.repeats.n_sent(n_steps, spec.obs_dim)?;
        length("observations", self.observations.len(), n_observed)?;
        length("next_observation", self.next_observation.len(), spec.obs_dim)?;
        length("masks", self.masks.len(), n_steps)?;
        length("actions", self.actions.len(), n_steps * n_heads)?;
        length("log_probs", self.log_probs.len(), n_steps)?;
        length("values", self.values.len(), n_steps)?;
        length("rewards", self.rewards.len(), n_steps)?;
        length("recurrent", self.recurrent.len(), recurrent_dim)?;
        if !(1..=limits::MAX_SNAPSHOT_BYTES).contains(&self.snapshot.len()) {
            let (found, limit) = (self.snapshot.len(), limits::MAX_SNAPSHOT_BYTES);
            let text = format!("snapshot has {found} bytes; 1 to {limit} are possible");
            return Err(Refusal::new(RefusalCause::Snapshot, text));
        }
        // What is left out is among what was sent.
        plausible("observations", &self.observations)?;
        plausible("next_observation", &self.next_observation)?;
        within("log_probs", &self.log_probs, limits::MIN_LOG_PROB, limits::MAX_LOG_PROB)?;
        plausible("values", &self.values)?;
        plausible("next_value", &[self.next_value])?;
        plausible("rewards", &self.rewards)?;
        plausible("recurrent", &self.recurrent)?;
        let mut steps = self.actions.chunks_exact(n_heads).zip(&self.masks);
        if let Some(step) = steps.position(|(act, &mask)| !spec.actions.allows(Mask(mask), act)) {
            let text = format!("step {step} has an action that its mask does not allow");
            return Err(Refusal::new(RefusalCause::Action, text));
        }
        self.check_ends(spec, n_steps)?;
        let (repeats, sent) = (mem::take(&mut self.repeats), mem::take(&mut self.observations));
        self.observations = repeats.put_back(sent, n_steps, spec.obs_dim);
        Ok(CheckedRollout(self))
    }

    fn check_ends(&self, spec: &EnvSpec, n_steps: usize) -> Result<(), Refusal> {
        let mut earliest = 0;
        // At most one end per step, in the order of the steps: whatever computes returns or scales rewards walks steps
        // and ends together.
        for (index, end) in self.ends.iter().enumerate() {
            let step = end.step as usize;
            if step < earliest || step >= n_steps {
                let text = format!("episode end {index} is out of range or out of order");
                return Err(Refusal::new(RefusalCause::EpisodeEnd, text));
            }
            earliest = step + 1;
            length("final_observation", end.final_observation.len(), spec.obs_dim)?;
            length("metrics", end.summary.metrics.len(), spec.metrics.len())?;
            plausible("final_observation", &end.final_observation)?;
            plausible("final_value", &[end.final_value])?;
            let metrics = &end.summary.metrics;
            let odd =
                spec.metrics.iter().zip(metrics).find(|(_, x)| plausible("", &[**x]).is_err());
            if let Some((name, &value)) = odd {
                plausible(&format!("metrics.{name}"), &[value])?;
            }
            plausible("episode_return", &[end.summary.episode_return])?;
        }
        Ok(())
    }
}

/// A rollout that is what the run agreed on: [`Rollout::check`] made it, so nobody behind the receiver checks again.
#[derive(Clone, Debug, PartialEq)]
pub struct CheckedRollout(Rollout);

impl CheckedRollout {
    /// Moves the snapshot out: training on a rollout does not need it, handing out environments does.
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

fn length(field: &str, found: usize, expected: usize) -> Result<(), Refusal> {
    if found == expected {
        return Ok(());
    }
    let text = format!("`{field}` has length {found}, expected {expected}");
    Err(Refusal::new(RefusalCause::Shape, text))
}

fn plausible<T: Copy + Into<f64>>(field: &str, values: &[T]) -> Result<(), Refusal> {
    within(field, values, -limits::MAX_MAGNITUDE, limits::MAX_MAGNITUDE)
}

/// Checks that every number is finite and in a closed range.
fn within<T: Copy + Into<f64>>(
    field: &str,
    values: &[T],
    lowest: impl Into<f64>,
    highest: impl Into<f64>,
) -> Result<(), Refusal> {
    let (lowest, highest) = (lowest.into(), highest.into());
    let outside = |&value: &T| !(lowest..=highest).contains(&value.into());
    let Some(index) = values.iter().position(outside) else { return Ok(()) };
    let found: f64 = values[index].into();
    Err(if found.is_finite() {
        let range = format!("{lowest} to {highest} are possible");
        let text = format!("`{field}` is {found} at index {index}; {range}");
        Refusal::new(RefusalCause::Magnitude, text)
    } else {
        let text = format!("`{field}` holds a value that is not finite at index {index}");
        Refusal::new(RefusalCause::NonFinite, text)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ActionSpec, fakes};

    fn rollout() -> Rollout {
        let summary =
            EpisodeSummary { episode: 0, episode_return: 0.0, length: 1, metrics: vec![0.0] };
        let (final_observation, final_value) = (vec![0.0], 0.0);
        let end = EpisodeEnd { step: 0, truncated: true, final_observation, final_value, summary };
        Rollout {
            ends: vec![end],
            recurrent: vec![0.0],
            snapshot: vec![1],
            ..fakes::rollout(EnvId(0), Iteration(0), PolicyVersion(0))
        }
    }

    /// Checks a changed rollout, and returns why it is refused.
    fn check(change: impl FnOnce(&mut Rollout)) -> Option<(RefusalCause, String)> {
        let actions = ActionSpec::discrete("a", 2);
        let spec = EnvSpec { obs_dim: 1, actions, metrics: vec!["success".to_owned()] };
        let mut rollout = rollout();
        change(&mut rollout);
        let refusal = rollout.check(&spec, 1, 1).err()?;
        Some((refusal.cause, refusal.text.into_owned()))
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
            ("metrics.success", |r, x| r.ends[0].summary.metrics[0] = x),
            ("episode_return", |r, x| r.ends[0].summary.episode_return = x.into()),
        ];
        for (name, set) in fields {
            for at_most in [1e9, -1e9] {
                assert_eq!(check(|r| set(r, at_most)), None, "{name}");
            }
            for absurd in [1.1e9, -3e38] {
                let (cause, text) = check(|r| set(r, absurd)).unwrap();
                assert_eq!(cause, RefusalCause::Magnitude, "{text}");
                let found = f64::from(absurd);
                assert!(text.starts_with(&format!("`{name}` is {found} at index 0;")), "{text}");
            }
            for no_number in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                let text = format!("`{name}` holds a value that is not finite at index 0");
                assert_eq!(check(|r| set(r, no_number)), Some((RefusalCause::NonFinite, text)));
            }
        }
        let beyond_f32 = check(|r| r.ends[0].summary.episode_return = 1e300);
        assert_eq!(beyond_f32.unwrap().0, RefusalCause::Magnitude);
    }

    #[test]
    fn a_log_probability_is_that_of_a_sampled_action() {
        for possible in [-1e4, -40.0, 0.0, 1e-3] {
            assert_eq!(check(|r| r.log_probs[0] = possible), None);
        }
        let (_, text) = check(|r| r.log_probs[0] = 0.5).unwrap();
        assert!(text.starts_with("`log_probs` is 0.5 at index 0; -10000 to 0.001"), "{text}");
        for (impossible, cause) in
            [(-1.1e4, RefusalCause::Magnitude), (f32::NAN, RefusalCause::NonFinite)]
        {
            assert_eq!(check(|r| r.log_probs[0] = impossible).unwrap().0, cause);
        }
    }
}
