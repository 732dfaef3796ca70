//! What a player's episodes gave, as numbers.

use leadtime_episodes::{
    EnvSlot, EpisodeObserver, MakeEnvironment, Observer, PlaySettings, Player, play,
};
use leadtime_sims::End;
use serde::{Deserialize, Serialize};

use crate::error::Error;

/// What one episode gave.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EpisodeResult {
    /// Sum of raw rewards.
    pub total_reward: f64,
    /// Number of steps until the end.
    pub n_steps: u64,
    /// A time limit ended it.
    pub truncated: bool,
    /// The task's metrics, in the order of [`Evaluation::metrics`].
    pub metrics: Vec<f32>,
}

/// What a player did in a number of episodes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Name that tables give the player.
    pub player: String,
    /// Seed of the evaluation.
    pub seed: u64,
    /// Names of the task's metrics.
    pub metrics: Vec<String>,
    /// The episodes in order.
    pub episodes: Vec<EpisodeResult>,
}

impl Evaluation {
    /// Returns one of the task's metrics for every episode; `None` if there is no such metric.
    pub fn column(&self, name: &str) -> Option<Vec<f64>> {
        let place = self.metrics.iter().position(|metric| metric == name)?;
        Some(self.episodes.iter().map(|episode| f64::from(episode.metrics[place])).collect())
    }

    /// Puts the episodes of several evaluations of one player in one task together, under the first one's seed; `None` of
    /// none.
    pub fn joined(evaluations: Vec<Self>) -> Option<Self> {
        let mut all = evaluations.into_iter();
        let mut first = all.next()?;
        all.for_each(|other| first.episodes.extend(other.episodes));
        Some(first)
    }

    /// Adds a metric that is computed from the episodes afterwards; a value that is no number is undefined.
    ///
    /// # Shapes
    ///
    /// `values`: one per episode; an episode without one has none.
    pub fn with_column(mut self, name: &str, values: &[f32]) -> Self {
        self.metrics.push(name.to_owned());
        for (i, episode) in self.episodes.iter_mut().enumerate() {
            episode.metrics.push(values.get(i).copied().unwrap_or(f32::NAN));
        }
        self
    }
}

#[cfg(test)]
impl Evaluation {
    /// Makes an evaluation of episodes, each with its steps and its values of the metrics, for tests.
    pub(crate) fn of<const N: usize>(metrics: [&str; N], episodes: &[(u64, [f32; N])]) -> Self {
        let episode = |&(n_steps, metrics): &(u64, [f32; N])| EpisodeResult {
            total_reward: 100.0 * f64::from(metrics[0]),
            n_steps,
            truncated: false,
            metrics: metrics.to_vec(),
        };
        Self {
            player: "p".to_owned(),
            seed: 1,
            metrics: metrics.map(str::to_owned).to_vec(),
            episodes: episodes.iter().map(episode).collect(),
        }
    }
}

/// Observes what one episode gave.
struct Measuring;

impl Observer for Measuring {}

impl EpisodeObserver for Measuring {
    type Output = EpisodeResult;

    fn finish(self, slot: &EnvSlot, end: End) -> EpisodeResult {
        EpisodeResult {
            total_reward: slot.episode_return(),
            n_steps: u64::from(slot.n_steps()),
            truncated: end == End::Truncated,
            metrics: slot.metrics(),
        }
    }
}

/// Plays episodes and returns what each gave.
///
/// # Errors
///
/// [`Error`] in the cases of [`play`]: the task cannot be built, the player does not fit it, or an episode does not
/// end.
pub fn evaluate(
    make: &MakeEnvironment<'_>,
    player: &Player,
    settings: &PlaySettings<'_>,
) -> Result<Evaluation, Error> {
    Ok(evaluate_with(make, player, settings, |_| ())?.0)
}

/// Plays episodes and returns what each gave, and what an observer of one's own made of it.
///
/// # Errors
///
/// [`Error`] in the cases of [`play`]: the task cannot be built, the player does not fit it, or an episode does not
/// end.
pub fn evaluate_with<O: EpisodeObserver>(
    make: &MakeEnvironment<'_>,
    player: &Player,
    settings: &PlaySettings<'_>,
    observe: impl Fn(u64) -> O + Sync,
) -> Result<(Evaluation, Vec<O::Output>), Error> {
    let metrics = make()?.spec().metrics.clone();
    let both = play(make, player, settings, |index| (Measuring, observe(index)))?;
    let (episodes, observed) = both.into_iter().unzip();
    let player = player.name().to_owned();
    Ok((Evaluation { player, seed: settings.seed, metrics, episodes }, observed))
}

#[cfg(test)]
#[path = "evaluation_tests.rs"]
mod tests;
