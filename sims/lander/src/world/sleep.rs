//! When the lander counts as at rest: Box2D's rule, with its own timers.

use serde::{Deserialize, Serialize};

use super::body::Body;

const SPEED_TOLERANCE: f32 = 0.01;
const SPIN_TOLERANCE: f32 = 2.0 / 180.0 * std::f32::consts::PI;
const TIME_TO_SLEEP: f32 = 0.5;

/// How long each body has been still, in seconds; Box2D's single precision decides the last frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Sleep([f32; 3]);

impl Sleep {
    /// Returns whether every time is a number.
    pub(super) fn is_finite(&self) -> bool {
        self.0.iter().all(|still| still.is_finite())
    }

    /// Takes in the velocities at the end of a frame, and tells whether all bodies have come to rest.
    pub(super) fn update(&mut self, bodies: &[Body; 3]) -> bool {
        for (still, body) in self.0.iter_mut().zip(bodies) {
            let speed_squared = body.velocity.norm_squared() as f32;
            let spin = body.spin as f32;
            let moves = speed_squared > SPEED_TOLERANCE * SPEED_TOLERANCE
                || spin * spin > SPIN_TOLERANCE * SPIN_TOLERANCE;
            *still = if moves { 0.0 } else { *still + super::constants::DT as f32 };
        }
        self.0.iter().all(|&still| still >= TIME_TO_SLEEP)
    }
}

#[cfg(test)]
mod tests {
    use super::super::constants::Vec2;
    use super::*;

    #[test]
    fn half_a_second_of_stillness_is_sleep_and_one_twitch_starts_over() {
        let resting = Body::at_rest(Vec2::zeros(), 1.0, 0.0);
        let still = Body { velocity: Vec2::new(0.009, 0.0), spin: 0.03, ..resting };
        let twitching = Body { spin: 0.04, ..still };
        let mut sleep = Sleep::default();
        let frames = (1..100).find(|_| sleep.update(&[still; 3])).unwrap();
        assert!((25..=26).contains(&frames), "{frames}");
        assert!(!sleep.update(&[still, still, twitching]));
        assert!(!sleep.update(&[still; 3]));
    }
}
