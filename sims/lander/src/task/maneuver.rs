//! How a topic is followed: which engine fires in this frame.
//!
//! The controller keeps a horizontal and a vertical target speed (in observed units) by tilting and hovering; its
//! gains were found by trying, and make a notified pilot move without tumbling. Near the ground it is gentler.
//!
//! | topic | horizontal target | vertical target |
//! |---|---|---|
//! | ascend | 0 | 0.3 |
//! | `shift_left`, `shift_right` | ∓0.5 · a | -0.05 |
//! | descend | 0 | -min(0.6, 0.1 + 0.6 y) |
//!
//! a = clip((y - 0.05) / 0.3, 0.2, 1). Angle target: clip(1.2 (vx - target), ±0.35 a).

use crate::pilot::strongest;
use crate::world::Engine;

/// Names of the topics, by id.
pub(super) const TOPICS: &[&str] = &["ascend", "shift_left", "shift_right", "descend"];
pub(super) const ASCEND: usize = 0;
pub(super) const SHIFT_LEFT: usize = 1;
pub(super) const SHIFT_RIGHT: usize = 2;
pub(super) const DESCEND: usize = 3;

/// Below this height, and with a leg on the ground, the pilot does not listen.
const LISTENS_ABOVE: f32 = 0.1;

/// Tells whether the pilot can follow anything now.
pub(super) fn listens(observation: &[f32; 8]) -> bool {
    observation[1] >= LISTENS_ABOVE && observation[6] == 0.0 && observation[7] == 0.0
}

/// Chooses the engine that follows a topic by tilting and hovering.
pub(super) fn maneuver(topic: usize, observation: &[f32; 8]) -> Engine {
    let [_, y, vx, vy, angle, spin, _, _] = observation.map(f64::from);
    let gentleness = ((y - 0.05) / 0.3).clamp(0.2, 1.0);
    let (target_vx, target_vy) = match topic {
        ASCEND => (0.0, 0.3),
        SHIFT_LEFT => (-0.5 * gentleness, -0.05),
        SHIFT_RIGHT => (0.5 * gentleness, -0.05),
        _ => (0.0, -(0.1 + 0.6 * y).min(0.6)),
    };
    let limit = 0.35 * gentleness;
    let target_angle = (1.2 * (vx - target_vx)).clamp(-limit, limit);
    let turn = 0.5 * (target_angle - angle) - spin;
    strongest(turn, 0.5 * (target_vy - vy))
}

/// Chooses the engine that stands for a topic when it is simply held.
pub(super) fn raw(topic: usize) -> Engine {
    match topic {
        ASCEND => Engine::Main,
        SHIFT_LEFT => Engine::Left,
        SHIFT_RIGHT => Engine::Right,
        _ => Engine::Idle,
    }
}

#[cfg(test)]
mod tests {
    use leadtime_numerics::Pcg64;

    use super::*;
    use crate::world::{Lander, PhysicsSettings};

    /// Flies a topic for two seconds from the start; returns the change of x and the final speeds.
    fn fly(topic: usize) -> [f32; 3] {
        let mut lander = Lander::new(&PhysicsSettings { start_impulse: 0.0, ..Default::default() });
        let before = lander.reset(Pcg64::seed_from_u64(4));
        let mut now = before;
        for _ in 0..100 {
            now = lander.step(maneuver(topic, &now)).observation;
        }
        [now[0] - before[0], now[2], now[3]]
    }

    #[test]
    fn each_topic_moves_the_lander_its_way() {
        // The tilt swings around its target, and so does the speed: not yet settled after two seconds.
        for (topic, side) in [(SHIFT_LEFT, -1.0), (SHIFT_RIGHT, 1.0)] {
            let [dx, vx, vy] = fly(topic);
            let moved = side * dx > 0.2 && (0.3..0.8).contains(&(side * vx)) && vy.abs() < 0.3;
            assert!(moved, "{topic}: {dx} {vx} {vy}");
        }
        let [drift, _, vy] = fly(ASCEND);
        assert!(drift.abs() < 0.15 && vy > 0.1, "{drift} {vy}");
        let [drift, _, vy] = fly(DESCEND);
        assert!(drift.abs() < 0.15 && (-0.8..-0.3).contains(&vy), "{drift} {vy}");
    }

    #[test]
    fn nobody_listens_near_or_on_the_ground() {
        assert!(listens(&[0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
        assert!(!listens(&[0.0, 0.05, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
        assert!(!listens(&[0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]));
    }

    #[test]
    fn a_raw_topic_is_one_engine() {
        let engines = [ASCEND, SHIFT_LEFT, SHIFT_RIGHT, DESCEND].map(raw);
        assert_eq!(engines, [Engine::Main, Engine::Left, Engine::Right, Engine::Idle]);
    }
}
