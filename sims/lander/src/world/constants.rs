//! The numbers of `LunarLander-v3`, in metres, kilograms and seconds (world frame: x right, y up).
//!
//! # Source
//!
//! Gymnasium 1.4.0, `envs/box2d/lunar_lander.py`, and Box2D 2.3.10, measured where Box2D computes them (masses,
//! inertias, and the leg limits, which its Python binding shifts by the legs' start angle).

use nalgebra::Vector2;

/// A point or vector of the world.
pub(super) type Vec2 = Vector2<f64>;

/// Duration of one frame.
pub(super) const DT: f64 = 0.02;
/// Gravity, downwards.
pub(super) const GRAVITY: f64 = 10.0;
/// Pixels per metre: the original states its shapes in pixels.
pub(super) const SCALE: f64 = 30.0;
/// Height of the world; its width is 20.
pub(super) const HEIGHT: f64 = 400.0 / SCALE;
/// The pad's middle.
pub(super) const PAD_X: f64 = 10.0;
/// Where y is 0 in an observation: a hull at this height stands on the pad.
pub(super) const REST_Y: f64 = HEIGHT / 4.0 + 18.0 / SCALE;
/// Half the world's width and height: the unit of observed positions.
pub(super) const HALF_WORLD: [f64; 2] = [10.0, HEIGHT / 2.0];
/// Frames per second, the divisor of observed velocities.
pub(super) const FPS: f64 = 50.0;

/// Index of the hull among the bodies; the legs follow.
pub(super) const HULL: usize = 0;
/// Masses of hull and legs.
pub(super) const MASS: [f64; 3] = [4.816_666_6, 0.071_111_12, 0.071_111_12];
/// Inertias about the centres of mass of hull and legs.
pub(super) const INERTIA: [f64; 3] = [0.783_880_74, 0.001_790_947, 0.001_790_947];
/// Mass of the whole lander.
pub(super) const TOTAL_MASS: f64 = MASS[0] + MASS[1] + MASS[2];
/// Height of the hull's centre of mass above its origin, in its own frame.
pub(super) const HULL_COM: f64 = 0.101_307_19;

/// The hull's corners relative to its centre of mass, counter-clockwise from the top left.
pub(super) const HULL_CORNERS: [[f64; 2]; 6] = [
    [-14.0 / SCALE, 17.0 / SCALE - HULL_COM],
    [-17.0 / SCALE, 0.0 - HULL_COM],
    [-17.0 / SCALE, -10.0 / SCALE - HULL_COM],
    [17.0 / SCALE, -10.0 / SCALE - HULL_COM],
    [17.0 / SCALE, 0.0 - HULL_COM],
    [14.0 / SCALE, 17.0 / SCALE - HULL_COM],
];
/// Half extents of a leg.
pub(super) const LEG_HALF: [f64; 2] = [2.0 / SCALE, 8.0 / SCALE];
/// A leg's corners relative to its centre, counter-clockwise.
pub(super) const LEG_CORNERS: [[f64; 2]; 4] = [
    [-LEG_HALF[0], -LEG_HALF[1]],
    [LEG_HALF[0], -LEG_HALF[1]],
    [LEG_HALF[0], LEG_HALF[1]],
    [-LEG_HALF[0], LEG_HALF[1]],
];

/// Signs of the legs: the first one is on the right, as in the original.
pub(super) const LEG_SIGN: [f64; 2] = [-1.0, 1.0];
/// The hinge seen from a leg's centre, in the leg's frame, for sign +1; x flips with the sign.
pub(super) const LEG_ANCHOR: [f64; 2] = [20.0 / SCALE, 18.0 / SCALE];
/// Speed at which the motors drive the legs to their lower stop.
pub(super) const LEG_SPEED: f64 = 0.3;
/// Largest torque of a leg's motor: the shock absorber.
pub(super) const LEG_TORQUE: f64 = 40.0;
/// The lower stop: the smallest angle between leg and hull.
pub(super) const LEG_LOWER: f64 = 0.35;
/// The upper stop.
pub(super) const LEG_UPPER: f64 = 0.85;

/// Friction of the ground and of the hull.
pub(super) const FRICTION: f64 = 0.1;
/// Friction of the legs.
pub(super) const LEG_FRICTION: f64 = 0.2;
/// Two shapes touch when their gap is at most this: Box2D's two polygon radii.
pub(super) const TOUCH_GAP: f64 = 0.02;
