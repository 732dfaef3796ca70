//! The demonstration in the steakhouse: one message that first makes the cook move, and then makes them know.

use leadtime_proto::EnvId;
use leadtime_sims::human::SpeechAct;
use leadtime_sims::{Environment as _, EpisodeSeed};
use leadtime_steakhouse::task::{DEMONSTRATION, demonstration};
use leadtime_taxonomy::Cell;

use super::record::Playthrough;
use super::voice::{Sentence, Spoken};
use crate::error::Error;

/// The message, in the words of the paper.
const TEXT: &str = "Go down, all stations occupied";

impl Spoken {
    /// Plays the paper's demonstration in the steakhouse: "Go down, all stations occupied", begun at t = 0. By t = 2 the
    /// cook has acted on the first words; at t = 5 they know what the stations hold, and plan anew.
    ///
    /// # Errors
    ///
    /// None in fact: [`Error::Task`] would need settings that are impossible, and these are fixed.
    ///
    /// # Source
    ///
    /// Hsu et al. (arXiv:2509.07438), the figure on cooking.
    pub fn demonstration() -> Result<Self, Error> {
        let mut env = demonstration().build()?;
        let mut observation = vec![0.0; env.spec().obs_dim];
        let seed = EpisodeSeed { run_seed: 0, env_id: EnvId(0), episode: 0 };
        env.reset(seed, &mut observation);
        let mut scenes: Vec<_> = env.scene().into_iter().collect();
        let (mut act, mut total_reward, mut end) = (SpeechAct::Start(DEMONSTRATION), 0.0, None);
        while end.is_none() {
            let (outcome, _) = env.step_with(act, &mut observation);
            (act, end) = (SpeechAct::Continue, outcome.end);
            total_reward += f64::from(outcome.reward);
            scenes.extend(env.scene());
        }
        let cell = Cell::new(DEMONSTRATION.comprehension, DEMONSTRATION.conveyance);
        let sentence = Sentence { text: TEXT.to_owned(), cell, fallback: false };
        let player = sentence.to_string();
        let played = Playthrough { player, seed: 0, index: 0, scenes, total_reward, success: None };
        Ok(Self::new(played, vec![sentence]))
    }
}
