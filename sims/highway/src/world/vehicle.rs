//! A car, its body and how it moves: a bicycle model with the slip angle at its centre.
//!
//! # Source
//!
//! highway-env 1.12.1, `vehicle/kinematics.py`.

use serde::{Deserialize, Serialize};

use super::constants::{LENGTH, MAX_ACCELERATION, MAX_SPEED};
use super::network::{LaneId, RoadNetwork};

/// Beyond any road, in metres; and more than any car turns, in radians, and waits, in seconds.
const FARTHEST: f64 = 1e9;
/// More than a frame adds to any of these: what is let in is let in after every further frame, too.
const FARTHEST_PER_FRAME: f64 = 1e5;
/// Far beyond any speed and acceleration, in m/s and m/s²; a car that is faster than it can drive is slowed down.
const LARGEST_RATE: f64 = 1e3;
/// More than a collision at such a speed moves a car, in metres.
const LARGEST_IMPACT: f64 = 1e4;

/// Who drives a car.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Driver {
    /// Nobody: the last command goes on for ever.
    Nobody,
    /// A controller that keeps to its target lane and speed, blind to other cars.
    Controller,
    /// A driver who keeps their distance (IDM) and changes lanes (MOBIL).
    Idm(Idm),
}

/// The state of an IDM driver.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Idm {
    /// Time since they last thought of changing lanes.
    pub timer: f64,
    /// Whether they change lanes by their own judgement.
    pub changes_lanes: bool,
    /// Whether they drive at the target speed by the speed controller, as far as IDM lets them.
    pub holds_speed: bool,
    /// How hard they brake for that at most, in m/s²; what they see makes them brake harder.
    pub held_braking: f64,
}

/// Who a car is to the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum CarRole {
    /// One of many on the carriageway.
    Traffic,
    /// The car of the listener.
    Ego,
    /// From a ramp, and not settled on the carriageway: it does not see the ego, and the ego trusts it to yield, unless
    /// [`Blindness`](super::Blindness) says otherwise.
    Merging,
    /// From a ramp, and settled, where it and the ego never see each other ([`Always`](super::Blindness::Always)).
    Merged,
}

/// A car on the road, with its driver.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Vehicle {
    /// Its centre, in metres.
    pub position: [f64; 2],
    /// In radians, never wrapped; positive turns to the right.
    pub heading: f64,
    /// Speed along the heading, in m/s.
    pub speed: f64,
    /// Commanded acceleration, in m/s².
    pub acceleration: f64,
    /// Commanded steering angle, in radians.
    pub steering: f64,
    /// It has touched something.
    pub crashed: bool,
    /// By how much a coming collision will move it.
    pub impact: Option<[f64; 2]>,
    /// The lane that it is on.
    pub lane: LaneId,
    /// The lane that it steers for.
    pub target_lane: LaneId,
    /// The speed that its driver wants, in m/s; 0 without a driver.
    pub target_speed: f64,
    /// What computes its commands.
    pub driver: Driver,
    /// Who it is to the others.
    pub role: CarRole,
    /// (cos, sin) of the heading.
    direction: [f64; 2],
}

impl Vehicle {
    /// Places a car on the lane closest to it, with a command of zero.
    ///
    /// A driver whose target speed is 0 wants the present one.
    pub fn new(network: &RoadNetwork, position: [f64; 2], heading: f64, speed: f64) -> Self {
        let lane = network.closest(position, heading, 0);
        let mut vehicle = Self {
            position,
            heading,
            speed,
            acceleration: 0.0,
            steering: 0.0,
            crashed: false,
            impact: None,
            lane,
            target_lane: lane,
            target_speed: 0.0,
            driver: Driver::Nobody,
            role: CarRole::Traffic,
            direction: [1.0, 0.0],
        };
        vehicle.face(heading);
        vehicle
    }

    /// Gives it a controller.
    pub fn with_controller(self, target_speed: f64) -> Self {
        let target_speed = if target_speed == 0.0 { self.speed } else { target_speed };
        Self { driver: Driver::Controller, target_speed, ..self }
    }

    /// Gives it an IDM driver; their timer starts where the original's does.
    pub fn with_idm(self, target_speed: f64) -> Self {
        let timer = ((self.position[0] + self.position[1]) * std::f64::consts::PI).rem_euclid(1.0);
        let idm =
            Idm { timer, changes_lanes: true, holds_speed: false, held_braking: MAX_ACCELERATION };
        Self { driver: Driver::Idm(idm), ..self.with_controller(target_speed) }
    }

    /// Gives it a role.
    pub fn with_role(self, role: CarRole) -> Self {
        Self { role, ..self }
    }

    /// Returns (cos, sin) of the heading.
    pub fn direction(&self) -> [f64; 2] {
        self.direction
    }

    /// Returns the velocity, without slip.
    pub fn velocity(&self) -> [f64; 2] {
        [self.speed * self.direction[0], self.speed * self.direction[1]]
    }

    /// Turns it to a heading.
    pub fn face(&mut self, heading: f64) {
        let (sine, cosine) = libm::sincos(heading);
        self.heading = heading;
        self.direction = [cosine, sine];
    }

    /// Returns whether its lanes exist and its numbers are within what any drive of so many frames comes to. If an IDM driver is at the
    /// wheel, that is so after every further frame, too.
    pub(crate) fn is_proper(&self, network: &RoadNetwork, n_frames: u32) -> bool {
        let Self { position, heading, speed, acceleration, steering, target_speed, .. } = *self;
        let (timer, held_braking) = match self.driver {
            Driver::Idm(idm) => (idm.timer, idm.held_braking),
            _ => (0.0, 0.0),
        };
        let rates = [speed, acceleration, steering, target_speed, held_braking];
        let farthest = FARTHEST + FARTHEST_PER_FRAME * f64::from(n_frames);
        let n_lanes = network.lanes().len();
        position.iter().chain([&heading, &timer]).all(|number| number.abs() <= farthest)
            && self.impact.iter().flatten().all(|moved| moved.abs() <= LARGEST_IMPACT)
            && rates.iter().all(|rate| rate.abs() <= LARGEST_RATE)
            && self.lane < n_lanes
            && self.target_lane < n_lanes
    }

    /// Moves on by `dt` seconds; its command is cut to what a crashed or too fast car can do.
    pub(super) fn integrate(&mut self, network: &RoadNetwork, dt: f64) {
        if let Driver::Idm(idm) = &mut self.driver {
            idm.timer += dt;
        }
        self.limit_command();
        let slip = libm::atan(0.5 * libm::tan(self.steering));
        let (sine, cosine) = libm::sincos(self.heading + slip);
        self.position[0] += self.speed * cosine * dt;
        self.position[1] += self.speed * sine * dt;
        if let Some(impact) = self.impact.take() {
            self.position[0] += impact[0];
            self.position[1] += impact[1];
            self.crashed = true;
        }
        if slip != 0.0 {
            self.face(self.heading + self.speed * libm::sin(slip) / (LENGTH / 2.0) * dt);
        }
        self.speed += self.acceleration * dt;
        self.lane = network.closest(self.position, self.heading, self.lane);
    }

    fn limit_command(&mut self) {
        if self.crashed {
            self.steering = 0.0;
            self.acceleration = -self.speed;
        }
        if self.speed > MAX_SPEED {
            self.acceleration = self.acceleration.min(MAX_SPEED - self.speed);
        } else if self.speed < -MAX_SPEED {
            self.acceleration = self.acceleration.max(-MAX_SPEED - self.speed);
        }
    }
}
