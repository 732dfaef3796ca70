//! What the pilot sees, and the potential whose difference is the reward.

use leadtime_sims::Quantity;

use super::body::Body;
use super::constants::{FPS, HALF_WORLD, HULL, PAD_X, REST_Y, Vec2};

/// Far beyond any flight, and far within what a rollout may hold.
const FARTHEST: f64 = 1e6;

/// Computes x, y, vx, vy, angle, angular velocity, right and left leg flag, in double precision.
///
/// Position in half worlds from the standing hull on the pad; velocity in half worlds per second, over 50 frames
/// times the frame rate as the original scales it; angle in radians, unwrapped; angular velocity times 0.4.
pub(super) fn state(bodies: &[Body; 3], angle: f64, legs: [bool; 2]) -> [f64; 8] {
    let hull = &bodies[HULL];
    let position = to_observation_units(hull.origin());
    [
        position.x,
        position.y,
        hull.velocity.x * HALF_WORLD[0] / FPS,
        hull.velocity.y * HALF_WORLD[1] / FPS,
        angle,
        20.0 * hull.spin / FPS,
        f64::from(u8::from(legs[0])),
        f64::from(u8::from(legs[1])),
    ]
}

/// Returns whether a flight can come to a state; a NaN is out of reach, too.
pub(super) fn is_possible(state: &[f64; 8]) -> bool {
    state.iter().all(|value| value.abs() <= FARTHEST)
}

/// Says what the 8 values are; the ranges are those that the original states.
pub(crate) fn quantities() -> Vec<Quantity> {
    let new = |name, meaning, bound: f32| Quantity::new(name, meaning, [-bound, bound]);
    let turn = std::f32::consts::TAU;
    vec![
        new("x", "right of the pad, in 10 m (half the view)", 2.5),
        new("y", "height above rest on the pad, in 6.67 m", 2.5),
        new("vx", "velocity to the right, in 5 m/s", 10.0),
        new("vy", "velocity upward, in 7.5 m/s", 10.0),
        new("angle", "tilt, counter-clockwise, in rad", turn),
        new("spin", "angular velocity, in 2.5 rad/s", 10.0),
        Quantity::flag("right_leg", "whether the right leg touches the ground"),
        Quantity::flag("left_leg", "whether the left leg touches the ground"),
    ]
}

/// Turns a point of the world into the units of observed positions.
pub(super) fn to_observation_units(point: Vec2) -> Vec2 {
    (point - Vec2::new(PAD_X, REST_Y)).component_div(&Vec2::from(HALF_WORLD))
}

/// Computes the shaping potential: nearer, slower, more upright and standing is better.
pub(super) fn shaping(s: &[f64; 8]) -> f64 {
    let norm = |a: f64, b: f64| (a * a + b * b).sqrt();
    -100.0 * norm(s[0], s[1]) - 100.0 * norm(s[2], s[3]) - 100.0 * s[4].abs()
        + 10.0 * s[6]
        + 10.0 * s[7]
}
