//! How the last training episodes went.

use std::collections::VecDeque;

use leadtime_proto::{EnvSpec, EpisodeSummary};
use serde::{Deserialize, Serialize};

/// How many episodes the means are over.
pub const WINDOW: usize = 100;
/// The metric that says whether an episode went well.
const SUCCESS: &str = "success";

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct FinishedEpisode {
    total_reward: f64,
    length: u32,
    success: Option<f32>,
}

/// Means over the last episodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EpisodeMeans {
    /// Episodes finished since the run began.
    pub n_finished: u64,
    /// Episodes that the means are over, at most [`WINDOW`].
    pub n_averaged: u64,
    /// Mean undiscounted return; `None` before the first episode.
    pub episode_return: Option<f64>,
    /// Mean share of successes; `None` where the task knows no success.
    pub success: Option<f64>,
    /// Mean length in steps.
    pub length: Option<f64>,
}

/// The last training episodes, in the order in which they were trained on.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct EpisodeWindow {
    n_finished: u64,
    last: VecDeque<FinishedEpisode>,
}

impl EpisodeWindow {
    /// Adds the episodes that ended in an update's rollouts, in their order.
    pub fn extend<'a>(
        &mut self,
        spec: &EnvSpec,
        summaries: impl IntoIterator<Item = &'a EpisodeSummary>,
    ) {
        let success = spec.metrics.iter().position(|name| name == SUCCESS);
        for summary in summaries {
            if self.last.len() == WINDOW {
                self.last.pop_front();
            }
            self.last.push_back(FinishedEpisode {
                total_reward: summary.episode_return,
                length: summary.length,
                success: success.and_then(|index| summary.metrics.get(index).copied()),
            });
            self.n_finished += 1;
        }
    }

    /// Computes the means over the last finished episodes.
    pub fn means(&self) -> EpisodeMeans {
        let mean = |value: fn(&FinishedEpisode) -> Option<f64>| {
            let values: Option<Vec<f64>> = self.last.iter().map(value).collect();
            let values = values.filter(|values| !values.is_empty())?;
            Some(values.iter().sum::<f64>() / values.len() as f64)
        };
        EpisodeMeans {
            n_finished: self.n_finished,
            n_averaged: self.last.len() as u64,
            episode_return: mean(|episode| Some(episode.total_reward)),
            success: mean(|episode| episode.success.map(f64::from)),
            length: mean(|episode| Some(f64::from(episode.length))),
        }
    }

    /// Returns what makes one policy better than another: mean success, or mean return where there is none.
    ///
    /// `None` until the window is full: a handful of lucky episodes is not the best policy.
    pub fn score(&self) -> Option<f64> {
        let means = self.means();
        let score = means.success.or(means.episode_return);
        score.filter(|_| self.last.len() == WINDOW)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use leadtime_proto::ActionSpec;

    fn spec(metric: &str) -> EnvSpec {
        let actions = ActionSpec::discrete("a", 2);
        EnvSpec { obs_dim: 1, actions, metrics: vec![metric.to_owned()] }
    }

    fn ended(episode_return: f64, metric: f32) -> EpisodeSummary {
        EpisodeSummary { episode: 0, episode_return, length: 2, metrics: vec![metric] }
    }

    #[test]
    fn only_the_last_hundred_episodes_count() {
        let mut episodes = EpisodeWindow::default();
        episodes.extend(&spec("success"), &[ended(1000.0, 1.0)]);
        assert_eq!(episodes.score(), None);
        let (bad, good) = (vec![ended(1.0, 0.0); 50], vec![ended(3.0, 1.0); 50]);
        episodes.extend(&spec("success"), bad.iter().chain(&good));
        let [episode_return, success, length] = [2.0, 0.5, 2.0].map(Some);
        let means =
            EpisodeMeans { n_finished: 101, n_averaged: 100, episode_return, success, length };
        assert_eq!(episodes.means(), means);
        assert_eq!(episodes.score(), Some(0.5));
    }

    #[test]
    fn a_task_without_success_is_scored_by_its_return() {
        let mut episodes = EpisodeWindow::default();
        episodes.extend(&spec("speed"), &vec![ended(5.0, 1.0); 100]);
        assert_eq!((episodes.means().success, episodes.score()), (None, Some(5.0)));
    }
}
