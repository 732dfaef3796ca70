//! Episodes that training never sees, and what a policy does in them.

use std::error::Error;
use std::fmt;

use leadtime_proto::PolicyVersion;
use serde::{Deserialize, Serialize};

/// Evaluates policies in worlds that the learner does not know.
pub trait PolicyEvaluator: Send {
    /// Plays the first `n_episodes` held-out episodes; what comes out depends on nothing but the weights (safetensors).
    ///
    /// Returns `None` if `is_stopped` became true before it was done; it asks often.
    ///
    /// # Errors
    ///
    /// What kept an episode from being played; the run goes on without this evaluation.
    fn evaluate(
        &mut self,
        weights: &[u8],
        n_episodes: u64,
        is_stopped: &(dyn Fn() -> bool + Sync),
    ) -> Result<Option<Vec<HeldOutEpisode>>, Box<dyn Error + Send + Sync>>;
}

/// How a run's policies are evaluated while it trains.
pub struct HeldOutEvaluation {
    /// How many evaluations there are over the run, at least 1.
    pub n_evaluations: u64,
    /// The most episodes of each, at least 1.
    pub max_episodes: u64,
    /// The mean score at which the run ends with the policy that has it; `None`: with its last update.
    pub stop_at: Option<f64>,
    /// Digest of what decides the episodes and the choices in them. Only policies that met the same ones are compared.
    pub episodes: [u8; 32],
    /// What plays the episodes.
    pub evaluator: Box<dyn PolicyEvaluator>,
}

impl fmt::Debug for HeldOutEvaluation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { n_evaluations, max_episodes, .. } = self;
        write!(f, "HeldOutEvaluation({n_evaluations} of up to {max_episodes} episodes)")
    }
}

/// What one held-out episode gave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldOutEpisode {
    /// Sum of the rewards.
    pub total_reward: f64,
    /// Steps until the end of the episode.
    pub length: u64,
    /// Whether the task was done; `None` where it knows no success.
    pub success: Option<f64>,
}

/// How a policy did on held-out episodes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeldOutMeans {
    /// The version of the policy that played.
    pub version: PolicyVersion,
    /// Episodes played, of which the others are means.
    pub n_episodes: u64,
    /// Mean success; `None` where the task knows none.
    pub success: Option<f64>,
    /// Mean undiscounted return, in the task's reward.
    pub episode_return: f64,
    /// Mean length in steps.
    pub length: f64,
    /// Standard error of the mean success, or of the mean return where there is no success.
    pub error: f64,
}

impl HeldOutMeans {
    /// Returns what makes a policy better than another: its success, or its return where the task knows none.
    pub fn score(&self) -> f64 {
        self.success.unwrap_or(self.episode_return)
    }
}

/// A mean with its standard error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// The mean of the values.
    pub mean: f64,
    /// The standard error of the mean.
    pub error: f64,
}

/// Returns by how much one policy's scores are ahead of another's in the same episodes; one may have played more of them.
/// `None` where fewer than two are shared.
pub fn lead(ours: &[f32], theirs: &[f32]) -> Option<Spread> {
    spread(ours.iter().zip(theirs).map(|(&a, &b)| f64::from(a) - f64::from(b)))
}

/// Returns what makes an episode better than another: success, or its return where the task knows none.
pub fn score(episode: &HeldOutEpisode) -> f64 {
    episode.success.unwrap_or(episode.total_reward)
}

/// Sums up the episodes of a policy's version; `None` of none.
pub(crate) fn means(version: PolicyVersion, episodes: &[HeldOutEpisode]) -> Option<HeldOutMeans> {
    let n = episodes.len() as f64;
    let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / n;
    let success: Option<Vec<f64>> = episodes.iter().map(|episode| episode.success).collect();
    (n > 0.0).then(|| HeldOutMeans {
        version,
        n_episodes: episodes.len() as u64,
        success: success.map(|values| mean(&mut values.into_iter())),
        episode_return: mean(&mut episodes.iter().map(|episode| episode.total_reward)),
        length: mean(&mut episodes.iter().map(|episode| episode.length as f64)),
        error: spread(episodes.iter().map(score)).map_or(0.0, |spread| spread.error),
    })
}

/// Computes mean and standard error; `None` of fewer than two values.
pub fn spread(values: impl Iterator<Item = f64> + Clone) -> Option<Spread> {
    let n = values.clone().count() as f64;
    if n < 2.0 {
        return None;
    }
    let mean = values.clone().sum::<f64>() / n;
    let squares: f64 = values.map(|value| (value - mean).powi(2)).sum();
    Some(Spread { mean, error: (squares / (n - 1.0) / n).sqrt() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_success_the_return_decides_and_the_error_is_its_own() {
        let paid = |reward: f64| HeldOutEpisode { total_reward: reward, length: 2, success: None };
        let found = means(PolicyVersion(7), &[paid(3.0), paid(5.0)]).unwrap();
        let HeldOutMeans { success, episode_return, length, error, .. } = found;
        assert_eq!((success, episode_return, length, error), (None, 4.0, 2.0, 1.0));
        assert_eq!(means(PolicyVersion(7), &[]), None);
    }

    #[test]
    fn policies_are_compared_in_the_episodes_that_both_have_played() {
        let found = lead(&[1.0, 1.0, 0.0, 1.0], &[0.0, 1.0, 1.0]).unwrap();
        assert_eq!((found.mean, found.error), (0.0, (1.0_f64 / 3.0).sqrt()));
        assert_eq!(lead(&[1.0], &[0.0, 1.0]), None);
    }
}
