//! The numbers of the drivers and their cars, in metres, seconds and radians.
//!
//! # Source
//!
//! highway-env 1.12.1: `vehicle/kinematics.py`, `vehicle/controller.py`, `vehicle/behavior.py`, `road/lane.py`.

/// Length of a car.
pub const LENGTH: f64 = 5.0;
/// Width of a car.
pub const WIDTH: f64 = 2.0;
/// Length and width of an obstacle.
pub const OBSTACLE: f64 = 2.0;
/// Beyond this speed, forwards or backwards, a car is slowed down.
pub const MAX_SPEED: f64 = 40.0;

/// Gain of the speed controller, per second.
pub(super) const SPEED_GAIN: f64 = 1.0 / 0.6;
/// Gain of the heading controller, per second.
pub(super) const HEADING_GAIN: f64 = 1.0 / 0.2;
/// Gain of the lateral controller, per second.
pub(super) const LATERAL_GAIN: f64 = 1.0 / 0.6;
/// How far ahead the controller looks along the lane, in seconds.
pub(super) const PURSUIT: f64 = 0.1;
/// Largest steering angle, in radians, to either side.
pub(super) const MAX_STEERING: f64 = std::f64::consts::FRAC_PI_3;

/// Hardest acceleration and braking of an IDM driver, in m/s².
pub const MAX_ACCELERATION: f64 = 6.0;
/// Comfortable acceleration of an IDM driver, in m/s².
pub(super) const COMFORT_ACCELERATION: f64 = 3.0;
/// Comfortable braking of an IDM driver, in m/s².
pub(super) const COMFORT_BRAKING: f64 = 5.0;
/// Distance kept at rest, centre to centre.
pub(super) const JAM_DISTANCE: f64 = 5.0 + LENGTH;
/// Time gap kept behind the car in front.
pub(super) const TIME_GAP: f64 = 1.5;

/// Least gain in acceleration that makes MOBIL change lanes.
pub(super) const LANE_CHANGE_GAIN: f64 = 0.2;
/// Hardest braking that MOBIL imposes on the car behind.
pub(super) const BRAKING_IMPOSED: f64 = 2.0;
/// Time between two thoughts of changing lanes.
pub(super) const LANE_CHANGE_DELAY: f64 = 1.0;
