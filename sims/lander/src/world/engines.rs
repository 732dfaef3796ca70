//! What pushes the lander: its engines with their dispersion, and the wind.

use leadtime_numerics::Pcg64;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::body::Body;
use super::constants::{SCALE, Vec2};
use super::settings::PhysicsSettings;

const MAIN_POWER: f64 = 13.0;
const SIDE_POWER: f64 = 0.6;
const MAIN_OFFSET: f64 = 4.0 / SCALE;
const SIDE_OFFSET: f64 = 12.0 / SCALE;
/// The original places the side engines' push with 17 along x and 14 along y: a mismatch that is part of the task.
const SIDE_MOUNT: [f64; 2] = [17.0 / SCALE, 14.0 / SCALE];

/// What the pilot does in a frame; the numbers are the original's actions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[repr(u8)]
pub enum Engine {
    /// All engines off.
    #[default]
    Idle = 0,
    /// The orientation engine that pushes and tilts to the left.
    Left = 1,
    /// The main engine.
    Main = 2,
    /// The orientation engine that pushes and tilts to the right.
    Right = 3,
}

/// A number that is no engine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("{0} is no engine; there are 0 (idle), 1 (left), 2 (main), 3 (right)")]
pub struct NoSuchEngine(pub u8);

impl TryFrom<u8> for Engine {
    type Error = NoSuchEngine;

    fn try_from(index: u8) -> Result<Self, NoSuchEngine> {
        Self::ALL.get(usize::from(index)).copied().ok_or(NoSuchEngine(index))
    }
}

impl Engine {
    /// Every engine, by its number.
    pub const ALL: [Self; 4] = [Self::Idle, Self::Left, Self::Main, Self::Right];

    /// Returns what a frame of this engine costs in reward.
    pub(crate) fn fuel(self) -> f64 {
        match self {
            Self::Idle => 0.0,
            Self::Main => 0.3,
            Self::Left | Self::Right => 0.03,
        }
    }

    /// Computes the push on the hull, given this frame's dispersion.
    pub(super) fn push(self, hull: &Body, [d0, d1]: Dispersion) -> Option<Push> {
        let tip = Vec2::new(hull.sin, hull.cos);
        let side = Vec2::new(-hull.cos, hull.sin);
        // The original mirrors the y component of every offset; so do we.
        let mirrored = |v: Vec2| Vec2::new(v.x, -v.y);
        match self {
            Self::Idle => None,
            Self::Main => {
                let offset = mirrored(tip * (MAIN_OFFSET + 2.0 * d0) + side * d1);
                Some(Push { impulse: -MAIN_POWER * offset, point: hull.origin() + offset })
            }
            Self::Left | Self::Right => {
                let direction = if self == Self::Left { -1.0 } else { 1.0 };
                let offset = mirrored(tip * d0 + side * (3.0 * d1 + direction * SIDE_OFFSET));
                let mount = Vec2::new(-tip.x * SIDE_MOUNT[0], tip.y * SIDE_MOUNT[1]);
                Some(Push { impulse: -SIDE_POWER * offset, point: hull.origin() + offset + mount })
            }
        }
    }
}

/// The random part of an engine's direction in one frame.
pub(super) type Dispersion = [f64; 2];

/// Draws a dispersion; every frame does, whether an engine fires or not.
pub(super) fn draw_dispersion(rng: &mut Pcg64) -> Dispersion {
    std::array::from_fn(|_| rng.uniform(-1.0, 1.0) / SCALE)
}

/// An impulse at a point of the world.
#[derive(Clone, Copy, Debug)]
pub(super) struct Push {
    pub(super) impulse: Vec2,
    pub(super) point: Vec2,
}

/// A horizontal force on the hull's centre of mass, and a torque.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Gust {
    pub(super) force: f64,
    pub(super) torque: f64,
}

/// Everything that acts on the lander in one frame, apart from gravity and ground.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Load {
    pub(super) engine: Option<Push>,
    pub(super) wind: Option<Gust>,
}

/// Where wind and turbulence stand in their aperiodic course.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct WindClock {
    force: i64,
    torque: i64,
}

impl WindClock {
    pub(super) fn draw(rng: &mut Pcg64) -> Self {
        Self { force: rng.integers(-9999, 9999), torque: rng.integers(-9999, 9999) }
    }

    /// Returns the wind of this frame and moves on.
    pub(super) fn blow(&mut self, settings: &PhysicsSettings) -> Gust {
        let force = course(self.force) * settings.wind_power;
        let gust = Gust { force, torque: course(self.torque) * settings.turbulence_power };
        // It may come from a snapshot that somebody made up.
        self.force = self.force.wrapping_add(1);
        self.torque = self.torque.wrapping_add(1);
        gust
    }
}

/// tanh(sin(2 k n) + sin(pi k n)) with k = 0.01: never periodic, between -1 and 1.
fn course(n: i64) -> f64 {
    let n = n as f64;
    libm::tanh(libm::sin(0.02 * n) + libm::sin(std::f64::consts::PI * 0.01 * n))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_main_engine_pushes_up_and_the_side_engines_to_their_sides() {
        let upright = Body::at_rest(Vec2::new(10.0, 8.0), 1.0, 0.0);
        let push = |engine: Engine| engine.push(&upright, [0.0; 2]).map(|push| push.impulse);
        assert!(push(Engine::Main).is_some_and(|impulse| impulse.y > 1.7 && impulse.x == 0.0));
        assert!(push(Engine::Left).is_some_and(|impulse| impulse.x < 0.0));
        assert!(push(Engine::Right).is_some_and(|impulse| impulse.x > 0.0));
        assert_eq!(push(Engine::Idle), None);
    }

    #[test]
    fn only_four_numbers_are_engines() {
        for (index, engine) in (0_u8..).zip(Engine::ALL) {
            assert_eq!(Engine::try_from(index), Ok(engine));
            assert_eq!(engine as u8, index);
        }
        assert_eq!(Engine::try_from(4), Err(NoSuchEngine(4)));
    }

    #[test]
    fn the_wind_stays_below_its_power_and_changes() {
        let settings = PhysicsSettings::default();
        let mut clock = WindClock::draw(&mut Pcg64::seed_from_u64(1));
        let gusts: Vec<Gust> = (0..500).map(|_| clock.blow(&settings)).collect();
        assert!(gusts.iter().all(|gust| gust.force.abs() <= 15.0 && gust.torque.abs() <= 1.5));
        assert!(gusts.iter().any(|gust| gust.force.abs() > 5.0));
    }
}
