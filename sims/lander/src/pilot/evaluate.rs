//! How well a pilot flies the unmodified task, over seeded episodes.

use std::ops::Range;

use leadtime_numerics::Pcg64;
use serde::Serialize;

use super::heuristic::heuristic;
use super::network::{Pilot, engines_off};
use crate::world::{Engine, Lander, LanderOutcome, PhysicsSettings};

/// The original's time limit, in frames.
pub const MAX_FRAMES: u32 = 1000;

/// Who flies.
#[derive(Clone, Copy, Debug)]
pub enum Flyer<'a> {
    /// The original's scripted pilot.
    Heuristic,
    /// A network, greedily.
    Network {
        /// Its weights.
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
    /// Sum of rewards.
    pub total: f64,
    /// Length in frames.
    pub frames: u32,
    /// How it ended; `None`: by the time limit.
    pub outcome: Option<LanderOutcome>,
}

/// What many episodes came to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct PilotEvaluation {
    /// Number of episodes.
    pub n_episodes: u64,
    /// Mean return.
    pub mean_return: f64,
    /// Standard error of that mean.
    pub standard_error: f64,
    /// Mean length, in frames.
    pub mean_frames: f64,
    /// Share of episodes that ended at rest.
    pub landed: f64,
    /// Share that crashed.
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
///
/// # Example
///
/// ```
/// use leadtime_lander::pilot::{Flyer, evaluate};
/// use leadtime_lander::world::PhysicsSettings;
///
/// let evaluation = evaluate(Flyer::Heuristic, &PhysicsSettings::default(), 0..5);
/// assert_eq!(evaluation.n_episodes, 5);
/// assert!(evaluation.mean_return > 150.0);
/// ```
pub fn evaluate(
    flyer: Flyer<'_>,
    settings: &PhysicsSettings,
    seeds: Range<u64>,
) -> PilotEvaluation {
    let mut lander = Lander::new(settings);
    let mut tally = PilotTally::default();
    seeds.for_each(|seed| tally.add(&fly(&mut lander, flyer, seed)));
    tally.evaluation()
}

/// Sums up flown episodes one by one, in memory that does not grow with them.
///
/// # Source
///
/// The variance is accumulated as in Welford, *Technometrics* 4 (1962).
#[derive(Clone, Copy, Debug, Default)]
pub struct PilotTally {
    n_episodes: u64,
    total: f64,
    /// The mean return so far, as the variance needs it.
    mean: f64,
    /// Sum of squared deviations from the mean return.
    squares: f64,
    frames: u64,
    landed: u64,
    crashed: u64,
    out: u64,
    timed_out: u64,
}

impl PilotTally {
    /// Counts one episode.
    pub fn add(&mut self, flown: &Flown) {
        self.n_episodes += 1;
        self.total += flown.total;
        let deviation = flown.total - self.mean;
        self.mean += deviation / self.n_episodes as f64;
        self.squares += deviation * (flown.total - self.mean);
        self.frames += u64::from(flown.frames);
        *match flown.outcome {
            Some(LanderOutcome::Landed) => &mut self.landed,
            Some(LanderOutcome::Crashed) => &mut self.crashed,
            Some(LanderOutcome::Out) => &mut self.out,
            None => &mut self.timed_out,
        } += 1;
    }

    /// Returns what the episodes came to; all zero if there were none.
    pub fn evaluation(&self) -> PilotEvaluation {
        if self.n_episodes == 0 {
            return PilotEvaluation::default();
        }
        let n = self.n_episodes as f64;
        let variance = self.squares / (n - 1.0).max(1.0);
        let share = |count: u64| count as f64 / n;
        PilotEvaluation {
            n_episodes: self.n_episodes,
            mean_return: self.total / n,
            standard_error: (variance / n).sqrt(),
            mean_frames: share(self.frames),
            landed: share(self.landed),
            crashed: share(self.crashed),
            out: share(self.out),
            timed_out: share(self.timed_out),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_summary_is_that_of_a_small_sample() {
        let flown = |total, outcome| Flown { total, frames: 10, outcome };
        let mut tally = PilotTally::default();
        assert_eq!(tally.evaluation(), PilotEvaluation::default());
        for (total, outcome) in [
            (1.0, Some(LanderOutcome::Landed)),
            (2.0, Some(LanderOutcome::Crashed)),
            (3.0, None),
            (6.0, Some(LanderOutcome::Landed)),
        ] {
            tally.add(&flown(total, outcome));
        }
        let evaluation = tally.evaluation();
        assert_eq!((evaluation.mean_return, evaluation.landed), (3.0, 0.5));
        // Sample variance 14/3, over 4 episodes.
        assert!((evaluation.standard_error - (14.0_f64 / 12.0).sqrt()).abs() < 1e-12);
        assert_eq!((evaluation.crashed, evaluation.out, evaluation.timed_out), (0.25, 0.0, 0.25));
    }
}
