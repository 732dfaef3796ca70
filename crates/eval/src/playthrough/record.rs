//! Playing one episode and keeping what there was to see.

use leadtime_numerics::Purpose;
use leadtime_sims::{Environment, Scene};

use super::voice::Sentence;
use crate::error::Error;
use crate::measure::{Acting, Player, episode_seed};

/// The longest episode that is recorded, in steps.
const MAX_STEPS: u64 = 20_000;

/// One episode, scene by scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Playthrough {
    /// The player's name.
    pub player: String,
    /// Seed of the evaluation that the episode belongs to.
    pub seed: u64,
    /// The episode's number in that evaluation.
    pub index: u64,
    /// What there was to see: at the start, and after every step.
    pub scenes: Vec<Scene>,
    /// Sum of raw rewards.
    pub total_reward: f64,
    /// Whether the task counts the episode as a success; `None` if it knows no such thing.
    pub success: Option<bool>,
    /// What was said, in the order of [`Story::utterances`](super::Story); empty until a [`Voice`](super::Voice) has
    /// spoken.
    pub sentences: Vec<Sentence>,
}

impl Playthrough {
    /// Plays the episode that [`crate::measure::evaluate`] plays under the same seed and number.
    ///
    /// # Errors
    ///
    /// [`Error::NoScene`] if the task cannot be drawn; as `evaluate` if the player does not fit or the episode does
    /// not end.
    pub fn record(
        environment: &mut dyn Environment,
        player: &Player,
        seed: u64,
        index: u64,
    ) -> Result<Self, Error> {
        player.check(environment)?;
        let streams = episode_seed(seed, index);
        let mut observation = vec![0.0; environment.spec().obs_dim];
        let mut recurrent = vec![0.0; player.recurrent_dim()];
        let mut action = vec![0; environment.spec().actions.heads.len()];
        let mut acting = Acting::new(player);
        let mut generator = streams.stream(Purpose::Act);
        environment.reset(streams, &mut observation);
        let mut scenes = vec![environment.scene().ok_or(Error::NoScene)?];
        let mut total_reward = 0.0;
        for _ in 0..MAX_STEPS {
            acting.think(&observation, &mut recurrent, 1);
            acting.choose(0, environment, &mut generator, &mut action);
            let outcome = environment.step(&action, &mut observation);
            total_reward += f64::from(outcome.reward);
            scenes.push(environment.scene().ok_or(Error::NoScene)?);
            if outcome.end.is_some() {
                let success = success(environment);
                let player = player.name().to_owned();
                let sentences = Vec::new();
                return Ok(Self { player, seed, index, scenes, total_reward, success, sentences });
            }
        }
        Err(Error::Endless { index, n_steps: MAX_STEPS })
    }

    /// Returns the number of steps.
    pub fn n_steps(&self) -> usize {
        self.scenes.len().saturating_sub(1)
    }
}

fn success(environment: &dyn Environment) -> Option<bool> {
    let names = &environment.spec().metrics;
    let place = names.iter().position(|name| name == "success")?;
    let mut metrics = vec![0.0; names.len()];
    environment.metrics(&mut metrics);
    Some(metrics[place] > 0.5)
}
