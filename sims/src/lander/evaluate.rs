//! How well a pilot flies the unmodified task, over seeded episodes.

use std::ops::Range;

use leadtime_numerics::Pcg64;
use serde::Serialize;

use super::engines::Engine;
use super::heuristic::heuristic;
use super::pilot::{Pilot, engines_off};
use super::settings::LanderSettings;
use super::world::{Lander, Outcome};

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
    pub outcome: Option<Outcome>,
}

/// What many episodes came to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Evaluation {
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
/// use leadtime_sims::lander::{Flyer, LanderSettings, evaluate};
///
/// let evaluation = evaluate(Flyer::Heuristic, &LanderSettings::default(), 0..5);
/// assert_eq!(evaluation.n_episodes, 5);
/// assert!(evaluation.mean_return > 150.0);
/// ```
pub fn evaluate(flyer: Flyer<'_>, settings: &LanderSettings, seeds: Range<u64>) -> Evaluation {
    let mut lander = Lander::new(settings);
    let flown: Vec<Flown> = seeds.map(|seed| fly(&mut lander, flyer, seed)).collect();
    summarize(&flown)
}

/// Sums up flown episodes; all zero if there are none.
pub fn summarize(flown: &[Flown]) -> Evaluation {
    let n = flown.len() as f64;
    if flown.is_empty() {
        return Evaluation::default();
    }
    let mean = |value: &dyn Fn(&Flown) -> f64| flown.iter().map(value).sum::<f64>() / n;
    let share = |outcome| mean(&|flown| f64::from(u8::from(flown.outcome == outcome)));
    let mean_return = mean(&|flown| flown.total);
    let variance = mean(&|flown| (flown.total - mean_return).powi(2)) * n / (n - 1.0).max(1.0);
    Evaluation {
        n_episodes: flown.len() as u64,
        mean_return,
        standard_error: (variance / n).sqrt(),
        mean_frames: mean(&|flown| f64::from(flown.frames)),
        landed: share(Some(Outcome::Landed)),
        crashed: share(Some(Outcome::Crashed)),
        out: share(Some(Outcome::Out)),
        timed_out: share(None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_summary_is_that_of_a_small_sample() {
        let flown = |total, outcome| Flown { total, frames: 10, outcome };
        let evaluation = summarize(&[
            flown(1.0, Some(Outcome::Landed)),
            flown(2.0, Some(Outcome::Crashed)),
            flown(3.0, None),
            flown(6.0, Some(Outcome::Landed)),
        ]);
        assert_eq!((evaluation.mean_return, evaluation.landed), (3.0, 0.5));
        // Sample variance 14/3, over 4 episodes.
        assert!((evaluation.standard_error - (14.0_f64 / 12.0).sqrt()).abs() < 1e-12);
        assert_eq!((evaluation.crashed, evaluation.out, evaluation.timed_out), (0.25, 0.0, 0.25));
        assert_eq!(summarize(&[]), Evaluation::default());
    }
}
