//! From rollouts to the samples of an update: normalised inputs, advantages, targets.

use leadtime_policy::{ActionDistribution, FrozenNormalizer, Policy};
use leadtime_proto::{CheckedRollout, Mask, Rollout};

use crate::encoder::Sequences;
use crate::gae::{Cut, TrajectorySegment, gae};
use crate::loss::Samples;
use crate::settings::{LearnerSettings, Truncation};
use crate::team::Team;
use crate::vtrace::vtrace;

/// All samples of an update, one environment after the other.
#[derive(Clone, Debug, Default)]
pub(crate) struct UpdateBatch {
    /// Normalised observations. `[N, D]`
    pub(crate) features: Vec<f32>,
    pub(crate) samples: Samples,
    /// What a recurrent policy starts from in each rollout, and where episodes start.
    pub(crate) sequences: Sequences,
    /// The staleness of every sample's rollout, where they may differ. `[N]`, or empty
    pub(crate) staleness: Vec<u64>,
}

impl UpdateBatch {
    pub(crate) fn n_samples(&self) -> usize {
        self.samples.masks.len()
    }

    /// Lays out the inputs, actions and behaviour of rollouts; targets follow from one of the two below.
    pub(crate) fn of(
        rollouts: &[CheckedRollout],
        normalizer: Option<&FrozenNormalizer>,
        team: &Team,
    ) -> Self {
        let mut batch = Self::default();
        let n_floats = |rollout: &CheckedRollout| rollout.observations.len();
        batch.features = vec![0.0; rollouts.iter().map(n_floats).sum()];
        let parts = parts(rollouts, &mut batch.features, n_floats);
        team.for_each(parts.into_iter(), |(rollout, features)| match normalizer {
            Some(normalizer) => normalizer.apply(&rollout.observations, features),
            None => features.copy_from_slice(&rollout.observations),
        });
        for rollout in rollouts {
            batch.push(rollout);
        }
        batch
    }

    /// Appends a rollout's actions and behaviour.
    fn push(&mut self, rollout: &Rollout) {
        self.samples.masks.extend_from_slice(&rollout.masks);
        self.samples.actions.extend_from_slice(&rollout.actions);
        self.samples.log_probs.extend_from_slice(&rollout.log_probs);
        let Sequences { n_steps, states, resets } = &mut self.sequences;
        *n_steps = rollout.masks.len();
        states.extend_from_slice(&rollout.recurrent);
        resets.extend(episode_starts(rollout));
    }

    /// Sets the targets of all rollouts from the stored behaviour values by generalised advantage estimation.
    pub(crate) fn set_gae(
        &mut self,
        rollouts: &[CheckedRollout],
        rewards: &[Vec<f32>],
        settings: &LearnerSettings,
        team: &Team,
    ) {
        let Samples { advantages, returns, values, .. } = &mut self.samples;
        for rollout in rollouts {
            values.extend_from_slice(&rollout.values);
        }
        *advantages = vec![0.0; values.len()];
        let parts = parts(rollouts, advantages, |rollout| rollout.values.len());
        team.for_each(parts.into_iter().zip(rewards), |((rollout, advantages), rewards)| {
            let cuts = cuts(rollout, settings.truncation, |end| rollout.ends[end].final_value);
            let (values, next_value) = (rollout.values.as_slice(), rollout.next_value);
            let segment = TrajectorySegment { rewards, values, next_value, cuts: &cuts };
            gae(&segment, settings.gamma as f32, settings.gae_lambda as f32, advantages);
        });
        returns.extend(advantages.iter().zip(values.iter()).map(|(a, v)| a + v));
    }

    /// Appends targets under the policy at the start of the update, by V-trace.
    pub(crate) fn push_vtrace(
        &mut self,
        rollout: &Rollout,
        rewards: &[f32],
        settings: &LearnerSettings,
        policy: &mut Policy,
        distribution: &ActionDistribution,
    ) {
        let current = Reevaluation::of(rollout, policy, distribution);
        let cuts = cuts(rollout, settings.truncation, |end| current.final_values[end]);
        let segment = TrajectorySegment {
            rewards,
            values: &current.values,
            next_value: current.next_value,
            cuts: &cuts,
        };
        let targets = vtrace(&segment, &current.log_rhos, settings.gamma as f32);
        self.samples.advantages.extend_from_slice(&targets.advantages);
        self.samples.returns.extend_from_slice(&targets.value_targets);
        self.samples.values.extend_from_slice(&current.values);
    }

    /// Copies what the sequences start from that `indices` (whole rollouts) consist of.
    pub(crate) fn gather_sequences(&self, indices: &[usize]) -> Sequences {
        let Sequences { n_steps, states, resets } = &self.sequences;
        let state_dim = states.len() / (self.n_samples() / n_steps);
        let first = indices.iter().step_by(*n_steps).map(|&sample| sample / n_steps);
        Sequences {
            n_steps: *n_steps,
            states: first
                .flat_map(|i| &states[i * state_dim..(i + 1) * state_dim])
                .copied()
                .collect(),
            resets: indices.iter().map(|&sample| resets[sample]).collect(),
        }
    }

    /// Returns how much of the targets' variance the values explain: 1 all, 0 none (also where there is no variance).
    pub(crate) fn explained_variance(&self) -> f64 {
        let (returns, values) = (&self.samples.returns, &self.samples.values);
        let total = variance(returns.iter().map(|&r| f64::from(r)));
        let left = variance(returns.iter().zip(values).map(|(r, v)| f64::from(r - v)));
        if total > 0.0 { 1.0 - left / total } else { 0.0 }
    }
}

/// Cuts numbers into those of each rollout, so that threads can write them side by side.
fn parts<'a>(
    rollouts: &'a [CheckedRollout],
    mut rest: &'a mut [f32],
    len: impl Fn(&CheckedRollout) -> usize,
) -> Vec<(&'a CheckedRollout, &'a mut [f32])> {
    let part = |rollout: &'a CheckedRollout| {
        let (part, behind) = std::mem::take(&mut rest).split_at_mut(len(rollout));
        rest = behind;
        (rollout, part)
    };
    rollouts.iter().map(part).collect()
}

fn variance(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let n = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / n;
    values.map(|x| (x - mean) * (x - mean)).sum::<f64>() / n
}

/// Returns a rollout's episode ends with what stands for the future behind each.
fn cuts(rollout: &Rollout, truncation: Truncation, final_value: impl Fn(usize) -> f32) -> Vec<Cut> {
    let bootstraps = truncation == Truncation::Bootstrap;
    let cut = |(i, end): (usize, &leadtime_proto::EpisodeEnd)| {
        let bootstrap = if end.truncated && bootstraps { final_value(i) } else { 0.0 };
        Cut { step: end.step as usize, bootstrap }
    };
    rollout.ends.iter().enumerate().map(cut).collect()
}

/// Lists for each step whether an episode starts there; the first step's state is the stored one, whichever it is.
fn episode_starts(rollout: &Rollout) -> impl Iterator<Item = bool> {
    let mut ends = rollout.ends.iter().map(|end| end.step as usize + 1).peekable();
    (0..rollout.masks.len()).map(move |step| ends.next_if_eq(&step).is_some())
}

/// A rollout that an older policy acted, evaluated by the current one.
#[derive(Default)]
struct Reevaluation {
    logits: Vec<f32>,
    values: Vec<f32>,
    next_value: f32,
    /// One value for each end of an episode.
    final_values: Vec<f32>,
    log_rhos: Vec<f32>,
}

impl Reevaluation {
    fn of(rollout: &Rollout, policy: &mut Policy, distribution: &ActionDistribution) -> Self {
        let n = rollout.masks.len();
        let (n_choices, n_heads) = (distribution.n_choices(), distribution.n_heads());
        let mut current = Self::evaluate(rollout, policy, n_choices);
        let log_rho = |i: usize| {
            let action = &rollout.actions[i * n_heads..(i + 1) * n_heads];
            let logits = &current.logits[i * n_choices..(i + 1) * n_choices];
            let log_prob = distribution.log_prob(logits, Mask(rollout.masks[i]), action);
            log_prob - rollout.log_probs[i]
        };
        current.log_rhos = (0..n).map(log_rho).collect();
        current
    }

    /// Runs the policy over a rollout, episode by episode, from the stored state on.
    fn evaluate(rollout: &Rollout, policy: &mut Policy, n_choices: usize) -> Self {
        let n = rollout.masks.len();
        let obs_dim = policy.obs_dim();
        let mut current =
            Self { logits: vec![0.0; n * n_choices], values: vec![0.0; n], ..Self::default() };
        let mut state = rollout.recurrent.clone();
        // Rows of a policy without memory do not depend on each other: the whole rollout is one batch.
        let stride = if state.is_empty() { n } else { 1 };
        let mut ends = rollout.ends.iter().peekable();
        for first in (0..n).step_by(stride) {
            let after = first + stride;
            policy.evaluate(
                &rollout.observations[first * obs_dim..after * obs_dim],
                &mut state,
                &mut current.logits[first * n_choices..after * n_choices],
                &mut current.values[first..after],
            );
            while let Some(end) = ends.next_if(|end| (end.step as usize) < after) {
                current.final_values.push(value(policy, &end.final_observation, &state));
                state.fill(0.0);
            }
        }
        current.next_value = value(policy, &rollout.next_observation, &state);
        current
    }
}

fn value(policy: &mut Policy, observation: &[f32], state: &[f32]) -> f32 {
    let mut value = [0.0];
    policy.values_only(observation, state, &mut value);
    value[0]
}
