//! What happened in an episode so far.

use serde::{Deserialize, Serialize};

use crate::world::Vehicle;

/// A tenth of what a rollout may hold as a metric.
const LARGEST_SUM: f64 = 1e8;
/// More than a step or a frame adds to a sum: what is let in here is let in after every further step, too.
const LARGEST_ADDED: f64 = 1e3;
/// More than a frame adds to the sum of squared jerks.
const LARGEST_JERK_SQUARE: f64 = 1e14;
/// More frames than a step has.
const FRAMES_PER_STEP: u32 = 1 << 10;
/// Far beyond any acceleration, in m/s².
const LARGEST_RATE: f64 = 1e4;

/// How an episode stands once it is decided.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum DriveOutcome {
    /// The ego has hit something.
    Crashed,
    /// It has passed the goal.
    Arrived,
    /// It took too long.
    OutOfTime,
}

/// Counts and sums of an episode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct DriveProgress {
    pub(super) n_steps: u32,
    /// Steps until the ego arrived or crashed; after its arrival it stands.
    pub(super) n_driven: u32,
    pub(super) outcome: Option<DriveOutcome>,
    /// Number of the merge at which the ego crashed.
    pub(super) crash_ramp: Option<usize>,
    /// The commanded lane change of the running reaction was impossible.
    pub(super) refused: bool,
    pub(super) n_refused: u32,
    /// Which cars of the traffic started ahead of the ego, a bit each.
    ahead: u64,
    pub(super) n_frames: u32,
    speed_sum: f64,
    /// The hardest braking so far, in m/s².
    pub(super) hardest_braking: f64,
    jerk_square_sum: f64,
    n_jerks: u32,
    acceleration: Option<f64>,
    /// Sums of the weighted terms of the reward.
    pub(super) pieces: [f64; 5],
    /// What was paid for being late, and for braking too hard.
    pub(super) penalties: [f64; 2],
}

impl DriveProgress {
    /// Begins with the cars at their start.
    pub(super) fn begin(vehicles: &[Vehicle]) -> Self {
        let [ego, traffic @ ..] = vehicles else { return Self::default() };
        let is_ahead = |car: &Vehicle| u64::from(car.position[0] > ego.position[0]);
        let bits = traffic.iter().enumerate().map(|(i, car)| is_ahead(car) << i);
        Self { ahead: bits.fold(0, |ahead, bit| ahead | bit), ..Self::default() }
    }

    /// Takes in a frame of `dt` seconds in which the ego went from one speed to another.
    pub(super) fn record_frame(&mut self, from: f64, ego: &Vehicle, dt: f64) {
        self.n_frames += 1;
        self.speed_sum += ego.speed;
        // What a wreck does is no one's driving.
        if ego.crashed {
            return;
        }
        let acceleration = (ego.speed - from) / dt;
        self.hardest_braking = self.hardest_braking.max(-acceleration);
        if let Some(before) = self.acceleration.replace(acceleration) {
            let jerk = (acceleration - before) / dt;
            self.jerk_square_sum += jerk * jerk;
            self.n_jerks += 1;
        }
    }

    /// Returns the ego's mean speed, in m/s.
    pub(super) fn mean_speed(&self) -> f64 {
        self.speed_sum / f64::from(self.n_frames.max(1))
    }

    /// Returns the root mean square of the jerk, in m/s³.
    pub(super) fn jerk(&self) -> f64 {
        libm::sqrt(self.jerk_square_sum / f64::from(self.n_jerks.max(1)))
    }

    /// Counts the cars that the ego has overtaken.
    pub(super) fn overtaken(&self, vehicles: &[Vehicle]) -> u32 {
        let [ego, cars @ ..] = vehicles else { return 0 };
        let passed = |(i, car): &(usize, &Vehicle)| {
            *i < 64 && self.ahead >> i & 1 == 1 && car.position[0] < ego.position[0]
        };
        cars.iter().enumerate().filter(passed).count() as u32
    }

    pub(super) fn is(&self, outcome: DriveOutcome) -> bool {
        self.outcome == Some(outcome)
    }

    /// Returns whether an episode could have come to these numbers, with room to count on.
    pub(super) fn is_plausible(&self, max_steps: u32, n_ramps: usize) -> bool {
        let [of_steps, of_frames] =
            [self.n_steps, self.n_frames].map(|n| LARGEST_SUM + LARGEST_ADDED * f64::from(n));
        let jerks = LARGEST_SUM * LARGEST_SUM + LARGEST_JERK_SQUARE * f64::from(self.n_jerks);
        let mut sums = self.pieces.iter().chain(&self.penalties);
        let mut rates = self.acceleration.iter().chain([&self.hardest_braking]);
        sums.all(|sum| sum.abs() <= of_steps)
            && self.speed_sum.abs() <= of_frames
            && rates.all(|rate| rate.abs() <= LARGEST_RATE)
            && (0.0..=jerks).contains(&self.jerk_square_sum)
            && self.n_steps <= max_steps
            && self.n_driven <= self.n_steps
            && self.n_refused <= max_steps
            && self.n_jerks <= self.n_frames
            && self.n_frames <= self.n_steps.saturating_mul(FRAMES_PER_STEP)
            && self.crash_ramp.is_none_or(|ramp| ramp < n_ramps)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_that_are_let_in_are_let_in_after_a_step_and_larger_ones_are_not() {
        let mut progress = DriveProgress {
            n_steps: 1,
            n_frames: FRAMES_PER_STEP,
            speed_sum: LARGEST_SUM + LARGEST_ADDED * f64::from(FRAMES_PER_STEP),
            jerk_square_sum: LARGEST_SUM * LARGEST_SUM,
            pieces: [LARGEST_SUM + LARGEST_ADDED; 5],
            ..DriveProgress::default()
        };
        assert!(progress.is_plausible(9, 3));
        progress.n_steps += 1;
        progress.n_frames += 5;
        progress.speed_sum += 5.0 * 40.0;
        progress.n_jerks += 5;
        progress.jerk_square_sum += 5.0 * 1e5;
        progress.pieces.iter_mut().for_each(|piece| *piece += 1.0);
        assert!(progress.is_plausible(9, 3));
        assert!(!DriveProgress { speed_sum: 5e8, ..progress }.is_plausible(9, 3));
        assert!(!DriveProgress { penalties: [f64::NAN; 2], ..progress }.is_plausible(9, 3));
    }
}
