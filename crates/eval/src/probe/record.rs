//! Playing episodes and noting, at one step of every stage, what the policy sees and what is true.

use std::sync::atomic::{AtomicU64, Ordering};

use leadtime_numerics::{Pcg64, Purpose};
use leadtime_sims::{Environment, Insight};

use crate::error::Error;
use crate::measure::{Acting, EvaluateSettings, MakeEnvironment, Player, episode_seed, in_threads};

/// Stages that are told apart: 0, 1, ... reactions begun, and in the last one as many or more.
pub(super) const N_STAGES: usize = 6;

/// One step of one stage of an episode.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Sample {
    /// The episode's number.
    pub(super) episode: u64,
    /// Reactions begun before the step, [`N_STAGES`] - 1 at most.
    pub(super) stage: usize,
    /// The person's reaction delay at that step.
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

/// Plays the episodes that [`crate::measure::evaluate`] plays under the same seed; in the order of episodes and stages.
///
/// # Errors
///
/// [`Error::NoListener`] or [`Error::DelayPerMessage`] if there is no delay to be known; [`Error::Endless`].
pub(super) fn record(
    make: &MakeEnvironment<'_>,
    player: &Player,
    settings: &EvaluateSettings,
) -> Result<Vec<Sample>, Error> {
    let next = AtomicU64::new(0);
    let work = || {
        let mut recorder = Recorder::new(make()?, player, settings);
        let mut samples = Vec::new();
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if index >= settings.n_episodes {
                return Ok(samples);
            }
            samples.push((index, recorder.episode(index)?));
        }
    };
    Ok(in_threads(settings.n_threads, &work)?.into_iter().flatten().collect())
}

/// Plays one episode after the other.
struct Recorder<'a> {
    settings: &'a EvaluateSettings,
    environment: Box<dyn Environment>,
    acting: Acting,
    observation: Vec<f32>,
    hidden: Vec<f32>,
    recurrent: Vec<f32>,
    action: Vec<u8>,
}

impl<'a> Recorder<'a> {
    fn new(
        environment: Box<dyn Environment>,
        player: &Player,
        settings: &'a EvaluateSettings,
    ) -> Self {
        Self {
            settings,
            acting: Acting::new(player),
            observation: vec![0.0; environment.spec().obs_dim],
            hidden: vec![0.0; player.hidden_dim()],
            recurrent: vec![0.0; player.recurrent_dim()],
            action: vec![0; environment.spec().actions.heads.len()],
            environment,
        }
    }

    fn episode(&mut self, index: u64) -> Result<Vec<Sample>, Error> {
        let streams = episode_seed(self.settings.seed, index);
        let mut acts = streams.stream(Purpose::Act);
        let mut stages = Stages::new(index, streams.stream(Purpose::Probe));
        self.environment.reset(streams, &mut self.observation);
        self.recurrent.fill(0.0);
        for _ in 0..self.settings.max_steps {
            let insight = self.environment.insight().ok_or(Error::NoListener)?;
            let sample = stages.visit(insight)?;
            let (observation, recurrent) = (&self.observation, &mut self.recurrent);
            if sample.is_some() {
                self.acting.hidden(observation, recurrent, &mut self.hidden);
            }
            self.acting.think(observation, recurrent, 1);
            if let Some(sample) = sample {
                sample.input.clone_from(&self.observation);
                sample.hidden = [&self.hidden[..], &self.recurrent].concat();
            }
            self.acting.choose(0, self.environment.as_ref(), &mut acts, &mut self.action);
            let outcome = self.environment.step(&self.action, &mut self.observation);
            if outcome.end.is_some() {
                return Ok(stages.weighted());
            }
        }
        Err(Error::Endless { index, n_steps: self.settings.max_steps })
    }
}

/// The stages of an episode so far, each with a step drawn evenly from its steps.
struct Stages {
    episode: u64,
    draws: Pcg64,
    n_begun: usize,
    samples: [Option<Sample>; N_STAGES],
}

impl Stages {
    fn new(episode: u64, draws: Pcg64) -> Self {
        Self { episode, draws, n_begun: 0, samples: Default::default() }
    }

    /// Goes to the coming step; returns the stage's sample, to be filled in, if it is to be this step.
    fn visit(&mut self, insight: Insight) -> Result<Option<&mut Sample>, Error> {
        let delay = insight.reaction_delay.ok_or(Error::DelayPerMessage)?;
        self.n_begun += usize::from(insight.reaction_began);
        let stage = self.n_begun.min(N_STAGES - 1);
        let sample = self.samples[stage].get_or_insert_default();
        sample.n_steps += 1;
        // Reservoir sampling: step n takes the place of those before it with probability 1 / n.
        if self.draws.below(sample.n_steps as usize) > 0 {
            return Ok(None);
        }
        (sample.episode, sample.stage) = (self.episode, stage);
        (sample.delay, sample.comprehended) = (delay, insight.comprehended);
        Ok(Some(sample))
    }

    /// Returns the samples of the stages that there were.
    fn weighted(self) -> Vec<Sample> {
        let samples: Vec<Sample> = self.samples.into_iter().flatten().collect();
        let weight = 1.0 / samples.len() as f64;
        samples.into_iter().map(|sample| Sample { weight, ..sample }).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn visit(stages: &mut Stages, delay: u32, reaction_began: bool) -> bool {
        let insight = Insight { reaction_delay: Some(delay), comprehended: 3, reaction_began };
        stages.visit(insight).unwrap().is_some()
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

    #[test]
    fn a_delay_that_no_one_has_drawn_yet_cannot_be_known() {
        let mut stages = Stages::new(0, Pcg64::seed_from_u64(1));
        let error = stages.visit(Insight::default()).unwrap_err();
        assert!(matches!(error, Error::DelayPerMessage));
    }
}
