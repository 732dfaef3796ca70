//! Playing episodes and noting, at one step of every stage, what the policy sees and what is true.

use leadtime_episodes::{
    Decision, EnvSlot, EpisodeObserver, MakeEnvironment, Observer, PlaySettings, Player,
    episode_seed, play,
};
use leadtime_numerics::{Pcg64, Purpose};
use leadtime_sims::{End, Insight};

use crate::error::Error;

/// Number of stages: 0, 1, ... reactions begun, and in the last one as many or more.
pub(super) const N_STAGES: usize = 6;

const NO_LISTENER: &str = "this task has no listener, so there is no reaction delay to decode";
const DELAY_PER_MESSAGE: &str = "the listener draws another reaction delay for every message, so it cannot be known beforehand; ask \
     for one that stays: drawn = \"per_episode\"";

/// One step of one stage of an episode.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct ProbeSample {
    pub(super) episode: u64,
    /// Reactions begun before the step, [`N_STAGES`] - 1 at most.
    pub(super) stage: usize,
    /// The listener's reaction delay at that step.
    pub(super) delay: u32,
    /// Messages understood before it.
    pub(super) comprehended: u32,
    /// How much the sample counts: those of an episode together count 1.
    pub(super) weight: f64,
    /// Steps that the stage had in this episode.
    pub(super) n_steps: u64,
    /// What the policy was given.
    pub(super) input: Vec<f32>,
    /// What its heads saw, and its recurrent state after it had thought.
    pub(super) hidden: Vec<f32>,
}

/// Checks that there is a delay to be known: it depends on the task alone, so one episode shows it.
pub(super) fn check_listener(
    make: &MakeEnvironment<'_>,
    settings: &PlaySettings<'_>,
) -> Result<(), Error> {
    let first = EnvSlot::new(make()?, 0, episode_seed(settings.seed, settings.first));
    let insight = first.env().insight().ok_or_else(|| Error::Probe(NO_LISTENER.to_owned()))?;
    insight.reaction_delay.ok_or_else(|| Error::Probe(DELAY_PER_MESSAGE.to_owned())).map(drop)
}

/// Plays the episodes that [`crate::measure::evaluate`] plays under the same seed; in the order of episodes and stages.
///
/// # Errors
///
/// In the cases of [`play`].
pub(super) fn record(
    make: &MakeEnvironment<'_>,
    player: &Player,
    settings: &PlaySettings<'_>,
) -> Result<Vec<ProbeSample>, Error> {
    let seed = |index| episode_seed(settings.seed, index);
    let observe = |index| Stages::new(index, seed(index).stream(Purpose::Probe));
    Ok(play(make, player, settings, observe)?.into_iter().flatten().collect())
}

/// The stages of an episode so far, each with a step drawn evenly from its steps.
struct Stages {
    episode: u64,
    draws: Pcg64,
    n_begun: usize,
    samples: [Option<ProbeSample>; N_STAGES],
    /// The stage whose sample is the coming step.
    chosen: Option<usize>,
}

impl Stages {
    fn new(episode: u64, draws: Pcg64) -> Self {
        Self { episode, draws, n_begun: 0, samples: Default::default(), chosen: None }
    }

    /// Goes to the coming step and decides whether it takes the place of its stage's sample.
    fn visit(&mut self, insight: Insight) {
        self.n_begun += usize::from(insight.reaction_began);
        let stage = self.n_begun.min(N_STAGES - 1);
        let sample = self.samples[stage].get_or_insert_default();
        sample.n_steps += 1;
        // Reservoir sampling: step n takes the place of those before it with probability 1 / n.
        let takes_place = self.draws.below(sample.n_steps as usize) == 0;
        self.chosen = takes_place.then_some(stage);
        if takes_place {
            (sample.episode, sample.stage) = (self.episode, stage);
            sample.delay = insight.reaction_delay.unwrap_or_default();
            sample.comprehended = insight.comprehended;
        }
    }

    /// Returns the samples of the stages that there were.
    fn weighted(self) -> Vec<ProbeSample> {
        let mut samples: Vec<ProbeSample> = self.samples.into_iter().flatten().collect();
        let weight = 1.0 / samples.len() as f64;
        for sample in &mut samples {
            sample.weight = weight;
        }
        samples
    }
}

impl Observer for Stages {
    fn wants_hidden(&mut self, slot: &EnvSlot) -> bool {
        self.visit(slot.env().insight().unwrap_or_default());
        self.chosen.is_some()
    }

    fn on_decision(&mut self, slot: &EnvSlot, decision: &Decision<'_>) {
        if let Some(sample) = self.chosen.and_then(|stage| self.samples[stage].as_mut()) {
            sample.input = slot.observation().to_vec();
            sample.hidden = [decision.hidden.unwrap_or_default(), slot.recurrent()].concat();
        }
    }
}

impl EpisodeObserver for Stages {
    type Output = Vec<ProbeSample>;

    fn finish(self, _slot: &EnvSlot, _end: End) -> Vec<ProbeSample> {
        self.weighted()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn visit(stages: &mut Stages, delay: u32, reaction_began: bool) -> bool {
        let reaction_delay = Some(delay);
        let insight = Insight { reaction_delay, comprehended: 3, reaction_began, word: None };
        stages.visit(insight);
        stages.chosen.is_some()
    }

    #[test]
    fn a_stage_ends_when_the_next_reaction_begins() {
        let mut stages = Stages::new(7, Pcg64::seed_from_u64(1));
        // Three steps, then a reaction every other step; in the last stage all that are left.
        for began in [false; 3].into_iter().chain([true, false].repeat(7)) {
            visit(&mut stages, 2, began);
        }
        let lengths = stages.samples.each_ref().map(|s| s.as_ref().map_or(0, |s| s.n_steps));
        assert_eq!(lengths, [3, 2, 2, 2, 2, 6]);
        for (stage, sample) in stages.samples.iter().flatten().enumerate() {
            assert_eq!((sample.stage, sample.episode), (stage, 7));
            assert_eq!((sample.delay, sample.comprehended), (2, 3));
        }
        let weight: f64 = stages.weighted().iter().map(|sample| sample.weight).sum();
        assert!((weight - 1.0).abs() < 1e-12);
    }

    #[test]
    fn every_step_of_a_stage_is_as_likely() {
        let mut chosen = [0; 4];
        for seed in 0..4000 {
            let mut stages = Stages::new(0, Pcg64::seed_from_u64(seed));
            let last = (0..4).filter(|&step| visit(&mut stages, step, false)).last();
            chosen[last.unwrap() as usize] += 1;
            assert_eq!(stages.samples[0].as_ref().map(|sample| sample.delay), last);
        }
        // 1000 each, with a standard deviation of 27.
        assert!(chosen.iter().all(|n| (900..1100).contains(n)), "{chosen:?}");
    }
}
