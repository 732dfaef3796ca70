//! The scripted pilot that comes with the original environment.

use crate::world::Engine;

/// Chooses an engine by two proportional-derivative rules, one for the angle and one for the descent.
///
/// It computes in double precision from the single-precision observation, as the original does.
///
/// # Source
///
/// Gymnasium 1.4.0, `envs/box2d/lunar_lander.py`, function `heuristic`.
pub fn heuristic(observation: &[f32; 8]) -> Engine {
    let [x, y, vx, vy, angle, spin, right, left] = observation.map(f64::from);
    let wanted_angle = (x * 0.5 + vx).clamp(-0.4, 0.4);
    let wanted_height = 0.55 * x.abs();
    let on_ground = right != 0.0 || left != 0.0;
    let (turn, climb) = if on_ground {
        (0.0, -vy * 0.5)
    } else {
        ((wanted_angle - angle) * 0.5 - spin, (wanted_height - y) * 0.5 - vy * 0.5)
    };
    strongest(turn, climb)
}

/// Chooses the engine for the larger of two wishes: to turn (left is positive), and to climb.
pub(crate) fn strongest(turn: f64, climb: f64) -> Engine {
    if climb > turn.abs() && climb > 0.05 {
        Engine::Main
    } else if turn < -0.05 {
        Engine::Right
    } else if turn > 0.05 {
        Engine::Left
    } else {
        Engine::Idle
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn falling_fast_fires_the_main_engine_and_leaning_is_corrected() {
        assert_eq!(heuristic(&[0.0, 0.5, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0]), Engine::Main);
        assert_eq!(heuristic(&[0.0, 0.5, 0.0, -0.2, 0.3, 0.0, 0.0, 0.0]), Engine::Right);
        assert_eq!(heuristic(&[0.0, 0.5, 0.0, -0.2, -0.3, 0.0, 0.0, 0.0]), Engine::Left);
        assert_eq!(heuristic(&[0.0, 0.0, 0.0, 0.0, 0.3, 0.0, 1.0, 1.0]), Engine::Idle);
    }
}
