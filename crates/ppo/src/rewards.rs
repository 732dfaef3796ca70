//! Rewards as the critic sees them: scaled, and divided by the running deviation of the discounted return.

use std::collections::BTreeMap;

use leadtime_proto::{EnvId, Rollout};
use serde::{Deserialize, Serialize};

/// Normalised rewards are clipped to this range.
const CLIP: f32 = 10.0;
/// Added to the variance before its root.
const EPSILON: f64 = 1e-8;

/// Running variance of the discounted return, with each environment's return so far.
///
/// # Source
///
/// Gymnasium's `NormalizeReward`, per environment id instead of per slot of a vector.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ReturnNormalizer {
    mean: f64,
    variance: f64,
    count: f64,
    returns: BTreeMap<EnvId, f64>,
}

impl Default for ReturnNormalizer {
    fn default() -> Self {
        Self { mean: 0.0, variance: 1.0, count: 1e-4, returns: BTreeMap::new() }
    }
}

impl ReturnNormalizer {
    /// Updates the statistics with the rewards of one rollout; returns restart where episodes end.
    ///
    /// # Shapes
    ///
    /// `rewards`: `[T]`, the rollout's, scaled.
    pub(crate) fn update(&mut self, rollout: &Rollout, rewards: &[f32], gamma: f64) {
        let so_far = self.returns.entry(rollout.env_id).or_default();
        let mut ends = rollout.ends.iter().map(|end| end.step as usize).peekable();
        let mut returns = Vec::with_capacity(rewards.len());
        for (step, &reward) in rewards.iter().enumerate() {
            *so_far = *so_far * gamma + f64::from(reward);
            returns.push(*so_far);
            if ends.next_if_eq(&step).is_some() {
                *so_far = 0.0;
            }
        }
        self.merge(&returns);
    }

    /// Forgets an environment's return so far: its next rollout belongs to another episode.
    pub(crate) fn forget(&mut self, env_id: EnvId) {
        self.returns.remove(&env_id);
    }

    fn merge(&mut self, returns: &[f64]) {
        if returns.is_empty() {
            return;
        }
        let n = returns.len() as f64;
        let mean = returns.iter().sum::<f64>() / n;
        let squares: f64 = returns.iter().map(|r| (r - mean) * (r - mean)).sum();
        let (delta, total) = (mean - self.mean, self.count + n);
        let square = self.variance * self.count + squares + delta * delta * self.count * n / total;
        self.mean += delta * n / total;
        self.variance = square / total;
        self.count = total;
    }

    /// Divides rewards by the standard deviation of the return and clips them to ±10.
    ///
    /// # Shapes
    ///
    /// `rewards`: `[T]`.
    pub(crate) fn apply(&self, rewards: &mut [f32]) {
        let scale = (1.0 / (self.variance + EPSILON).sqrt()) as f32;
        for reward in rewards {
            *reward = (*reward * scale).clamp(-CLIP, CLIP);
        }
    }
}

#[cfg(test)]
mod tests {
    use leadtime_proto::{EpisodeEnd, EpisodeSummary};

    use super::*;

    fn rollout(env_id: u32, ends: &[u32]) -> Rollout {
        let end = |&step: &u32| {
            let summary =
                EpisodeSummary { episode: 0, episode_return: 0.0, length: 1, metrics: Vec::new() };
            let (truncated, final_observation, final_value) = (false, Vec::new(), 0.0);
            EpisodeEnd { step, truncated, final_observation, final_value, summary }
        };
        let (env_id, ends) = (EnvId(env_id), ends.iter().map(end).collect());
        Rollout { env_id, ends, ..Rollout::default() }
    }

    #[test]
    fn a_return_whose_end_was_never_seen_is_forgotten() {
        let mut normalizer = ReturnNormalizer { count: 0.0, ..ReturnNormalizer::default() };
        normalizer.update(&rollout(0, &[]), &[1.0, 2.0], 0.5);
        normalizer.update(&rollout(1, &[]), &[4.0], 0.5);
        for env_id in [0, 7].map(EnvId) {
            normalizer.forget(env_id);
        }
        normalizer.update(&rollout(0, &[]), &[1.0], 0.5);
        normalizer.update(&rollout(1, &[]), &[1.0], 0.5);
        let mean = (1.0 + 2.5 + 4.0 + 1.0 + 3.0) / 5.0;
        assert!((normalizer.mean - mean).abs() < 1e-12, "{}", normalizer.mean);
    }

    #[test]
    fn returns_go_on_across_rollouts_and_restart_with_episodes() {
        let mut normalizer = ReturnNormalizer { count: 0.0, ..ReturnNormalizer::default() };
        normalizer.update(&rollout(0, &[]), &[1.0, 2.0], 0.5);
        normalizer.update(&rollout(1, &[0]), &[4.0, 1.0], 0.5);
        normalizer.update(&rollout(0, &[]), &[1.0], 0.5);
        let returns = [1.0, 2.5, 4.0, 1.0, 2.25_f64];
        let mean = returns.iter().sum::<f64>() / 5.0;
        let variance = returns.iter().map(|r| (r - mean) * (r - mean)).sum::<f64>() / 5.0;
        assert!((normalizer.variance - variance).abs() < 1e-12);
        let mut rewards = [3.0, -1000.0];
        normalizer.apply(&mut rewards);
        assert!((f64::from(rewards[0]) - 3.0 / variance.sqrt()).abs() < 1e-6);
        assert_eq!(rewards[1], -10.0);
    }
}
