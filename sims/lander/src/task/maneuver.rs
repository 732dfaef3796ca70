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

/// What a topic asks for. A topic that lacks its maneuver, or how that is flown, does not compile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Maneuver {
    Ascend,
    ShiftLeft,
    ShiftRight,
    Descend,
}

impl Maneuver {
    /// The maneuvers of the topics, by id.
    const OF_TOPICS: [Self; TOPICS.len()] =
        [Self::Ascend, Self::ShiftLeft, Self::ShiftRight, Self::Descend];

    /// Returns what a topic asks for.
    ///
    /// # Panics
    ///
    /// If there is no such topic.
    pub(super) fn of(topic: usize) -> Self {
        Self::OF_TOPICS[topic]
    }

    pub(super) fn topic(self) -> usize {
        self as usize
    }
}

/// Below this height, and with a leg on the ground, the pilot does not listen.
const LISTENS_ABOVE: f32 = 0.1;

/// Returns whether the pilot can follow anything now.
pub(super) fn listens(observation: &[f32; 8]) -> bool {
    observation[1] >= LISTENS_ABOVE && observation[6] == 0.0 && observation[7] == 0.0
}

/// Chooses the engine that follows a topic by tilting and hovering.
pub(super) fn maneuver(asked: Maneuver, observation: &[f32; 8]) -> Engine {
    let [_, y, vx, vy, angle, spin, _, _] = observation.map(f64::from);
    let gentleness = ((y - 0.05) / 0.3).clamp(0.2, 1.0);
    let (target_vx, target_vy) = match asked {
        Maneuver::Ascend => (0.0, 0.3),
        Maneuver::ShiftLeft => (-0.5 * gentleness, -0.05),
        Maneuver::ShiftRight => (0.5 * gentleness, -0.05),
        Maneuver::Descend => (0.0, -(0.1 + 0.6 * y).min(0.6)),
    };
    let limit = 0.35 * gentleness;
    let target_angle = (1.2 * (vx - target_vx)).clamp(-limit, limit);
    let turn = 0.5 * (target_angle - angle) - spin;
    strongest(turn, 0.5 * (target_vy - vy))
}

/// Chooses the engine that stands for a topic when it is simply held.
pub(super) fn raw(asked: Maneuver) -> Engine {
    match asked {
        Maneuver::Ascend => Engine::Main,
        Maneuver::ShiftLeft => Engine::Left,
        Maneuver::ShiftRight => Engine::Right,
        Maneuver::Descend => Engine::Idle,
    }
}

#[cfg(test)]
mod tests {
    use leadtime_numerics::Pcg64;

    use super::*;
    use crate::world::{Lander, PhysicsSettings};

    /// Flies a topic for two seconds from the start; returns the change of x and the final speeds.
    fn fly(asked: Maneuver) -> [f32; 3] {
        let mut lander = Lander::new(&PhysicsSettings { start_impulse: 0.0, ..Default::default() });
        let before = lander.reset(Pcg64::seed_from_u64(4));
        let mut now = before;
        for _ in 0..100 {
            now = lander.step(maneuver(asked, &now)).observation;
        }
        [now[0] - before[0], now[2], now[3]]
    }

    #[test]
    fn each_topic_moves_the_lander_its_way() {
        // The tilt swings around its target, and so does the speed: not yet settled after two seconds.
        for (asked, side) in [(Maneuver::ShiftLeft, -1.0), (Maneuver::ShiftRight, 1.0)] {
            let [dx, vx, vy] = fly(asked);
            let moved = side * dx > 0.2 && (0.3..0.8).contains(&(side * vx)) && vy.abs() < 0.3;
            assert!(moved, "{asked:?}: {dx} {vx} {vy}");
        }
        let [drift, _, vy] = fly(Maneuver::Ascend);
        assert!(drift.abs() < 0.15 && vy > 0.1, "{drift} {vy}");
        let [drift, _, vy] = fly(Maneuver::Descend);
        assert!(drift.abs() < 0.15 && (-0.8..-0.3).contains(&vy), "{drift} {vy}");
    }

    #[test]
    fn the_listener_does_not_react_near_or_on_the_ground() {
        assert!(listens(&[0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
        assert!(!listens(&[0.0, 0.05, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
        assert!(!listens(&[0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]));
    }

    #[test]
    fn every_topic_has_its_own_maneuver() {
        for (topic, name) in TOPICS.iter().enumerate() {
            assert_eq!(Maneuver::of(topic).topic(), topic, "{name}");
        }
    }

    #[test]
    fn a_raw_topic_is_one_engine() {
        let engines = Maneuver::OF_TOPICS.map(raw);
        assert_eq!(engines, [Engine::Main, Engine::Left, Engine::Right, Engine::Idle]);
    }
}
