//! How well a pilot flies the unmodified task, over seeded episodes.

use std::ops::Range;

use leadtime_numerics::Pcg64;
use serde::Serialize;

use super::heuristic::heuristic;
use super::network::{Pilot, engines_off};
use crate::world::{Engine, Lander, LanderOutcome, PhysicsSettings};

/// The original's time limit, in frames.
pub const MAX_FRAMES: u32 = 1000;

/// What chooses the lander's engine.
#[derive(Clone, Copy, Debug)]
pub enum Flyer<'a> {
    /// The original's scripted pilot.
    Heuristic,
    /// A trained network, whose likeliest action is taken.
    Network {
        /// The network with its weights.
        pilot: &'a Pilot,
        /// Whether its engines rest once it [stands](engines_off).
        rests: bool,
    },
}

impl Flyer<'_> {
    /// Chooses the engine of the coming frame.
    pub fn engine(&self, observation: &[f32; 8]) -> Engine {
        match self {
            Self::Heuristic => heuristic(observation),
            Self::Network { rests: true, .. } if engines_off(observation) => Engine::Idle,
            Self::Network { pilot, .. } => pilot.engine(observation),
        }
    }
}

/// What one episode came to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Flown {
    /// Sum of the rewards, not discounted.
    pub total: f64,
    /// Length of the episode, in frames.
    pub frames: u32,
    /// How it ended; `None`: by the time limit.
    pub outcome: Option<LanderOutcome>,
}

/// What many episodes came to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct PilotEvaluation {
    /// Number of episodes that were played.
    #[serde(rename = "episodes")]
    pub n_episodes: u64,
    /// Mean return over the episodes.
    pub mean_return: f64,
    /// Standard error of that mean.
    pub standard_error: f64,
    /// Mean length, in frames.
    pub mean_frames: f64,
    /// Share of episodes that ended at rest.
    pub landed: f64,
    /// Share of episodes that ended in a crash.
    pub crashed: f64,
    /// Share that left the view.
    pub out: f64,
    /// Share that met the time limit.
    pub timed_out: f64,
}

/// Flies one episode with Gymnasium's seeding.
pub fn fly(lander: &mut Lander, flyer: Flyer<'_>, seed: u64) -> Flown {
    let mut observation = lander.reset(Pcg64::seed_from_u64(seed));
    let mut flown = Flown { total: 0.0, frames: 0, outcome: None };
    while flown.frames < MAX_FRAMES && flown.outcome.is_none() {
        let frame = lander.step(flyer.engine(&observation));
        observation = frame.observation;
        flown.total += frame.reward;
        flown.outcome = frame.outcome;
        flown.frames += 1;
    }
    flown
}

/// Flies the episodes of a half-open range of Gymnasium's seeds.
pub fn evaluate(
    flyer: Flyer<'_>,
    settings: &PhysicsSettings,
    seeds: Range<u64>,
) -> PilotEvaluation {
    let mut lander = Lander::new(settings);
    sum_up(seeds.map(|seed| fly(&mut lander, flyer, seed)))
}

/// Sums up flown episodes one by one; all zero if there are none.
///
/// The variance is accumulated as in Welford, *Technometrics* 4 (1962).
fn sum_up(episodes: impl Iterator<Item = Flown>) -> PilotEvaluation {
    let mut sums = PilotEvaluation::default();
    let (mut mean, mut squares) = (0.0, 0.0);
    for flown in episodes {
        sums.n_episodes += 1;
        let deviation = flown.total - mean;
        mean += deviation / sums.n_episodes as f64;
        squares += deviation * (flown.total - mean);
        sums.mean_return += flown.total;
        sums.mean_frames += f64::from(flown.frames);
        *match flown.outcome {
            Some(LanderOutcome::Landed) => &mut sums.landed,
            Some(LanderOutcome::Crashed) => &mut sums.crashed,
            Some(LanderOutcome::Out) => &mut sums.out,
            None => &mut sums.timed_out,
        } += 1.0;
    }
    let n = sums.n_episodes.max(1) as f64;
    PilotEvaluation {
        n_episodes: sums.n_episodes,
        mean_return: sums.mean_return / n,
        standard_error: (squares / (n - 1.0).max(1.0) / n).sqrt(),
        mean_frames: sums.mean_frames / n,
        landed: sums.landed / n,
        crashed: sums.crashed / n,
        out: sums.out / n,
        timed_out: sums.timed_out / n,
    }
}

#[cfg(test)]
mod tests {
    use super::LanderOutcome::{Crashed, Landed};
    use super::*;

    #[test]
    fn the_summary_is_that_of_a_small_sample() {
        assert_eq!(sum_up(std::iter::empty()), PilotEvaluation::default());
        let flown = |(total, outcome)| Flown { total, frames: 10, outcome };
        let sample = [(1.0, Some(Landed)), (2.0, Some(Crashed)), (3.0, None), (6.0, Some(Landed))];
        let evaluation = sum_up(sample.into_iter().map(flown));
        assert_eq!((evaluation.mean_return, evaluation.landed), (3.0, 0.5));
        // Sample variance 14/3, over 4 episodes.
        assert!((evaluation.standard_error - (14.0_f64 / 12.0).sqrt()).abs() < 1e-12);
        assert_eq!((evaluation.crashed, evaluation.out, evaluation.timed_out), (0.25, 0.0, 0.25));
    }
}
