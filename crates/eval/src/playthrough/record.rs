//! Playing one episode and keeping what there was to see.

use leadtime_episodes::{
    EnvSlot, EpisodeObserver, MakeEnvironment, Observer, PlaySettings, Player, play,
};
use leadtime_sims::{End, Scene};

use crate::error::Error;

/// The longest episode that is recorded, in steps.
const MAX_STEPS: u64 = 20_000;

/// One episode, scene by scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Playthrough {
    /// Name that tables give the player.
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
}

impl Playthrough {
    /// Plays the episode that [`crate::measure::evaluate`] plays under the same seed and number.
    ///
    /// # Errors
    ///
    /// [`Error::NoScene`] if the task cannot be drawn; any other [`Error`] in the cases of [`play`].
    pub fn record(
        make: &MakeEnvironment<'_>,
        player: &Player,
        seed: u64,
        index: u64,
    ) -> Result<Self, Error> {
        let one = PlaySettings::new(1, seed);
        let settings = PlaySettings { first: index, max_steps: MAX_STEPS, ..one };
        Self::record_all(make, player, &settings)?.pop().ok_or(Error::NoScene)
    }

    /// Plays several episodes, in order.
    ///
    /// # Errors
    ///
    /// [`Error::NoScene`] if the task cannot be drawn; any other [`Error`] in the cases of [`play`].
    pub fn record_all(
        make: &MakeEnvironment<'_>,
        player: &Player,
        settings: &PlaySettings<'_>,
    ) -> Result<Vec<Self>, Error> {
        let observe = |index| {
            let (player, seed) = (player.name().to_owned(), settings.seed);
            let (scenes, total_reward, success) = (Vec::new(), 0.0, None);
            SceneLog(Self { player, seed, index, scenes, total_reward, success })
        };
        let recorded = play(make, player, settings, observe)?.into_iter();
        recorded.map(|played| played.ok_or(Error::NoScene)).collect()
    }

    /// Returns the episode's title: who played, and how it ended.
    pub fn title(&self) -> String {
        let outcome = self.scenes.last().map_or("", |scene| scene.outcome.as_str());
        let verdict = self.success.map_or("", |is| if is { "success" } else { "no success" });
        let parts = [outcome, verdict].into_iter().filter(|part| !part.is_empty());
        let end = parts.collect::<Vec<_>>().join(", ");
        if end.is_empty() { self.player.clone() } else { format!("{}: {end}", self.player) }
    }

    /// Returns the number of steps.
    pub fn n_steps(&self) -> usize {
        self.scenes.len().saturating_sub(1)
    }
}

/// An episode in the making.
struct SceneLog(Playthrough);

impl Observer for SceneLog {
    fn on_moment(&mut self, slot: &EnvSlot) {
        self.0.scenes.extend(slot.env().scene());
    }
}

impl EpisodeObserver for SceneLog {
    type Output = Option<Playthrough>;

    fn finish(self, slot: &EnvSlot, _end: End) -> Self::Output {
        let metrics = slot.env().spec().metrics.iter().zip(slot.metrics());
        let success =
            { metrics }.find(|(name, _)| *name == "success").map(|(_, value)| value > 0.5);
        let played = Playthrough { total_reward: slot.episode_return(), success, ..self.0 };
        (!played.scenes.is_empty()).then_some(played)
    }
}
