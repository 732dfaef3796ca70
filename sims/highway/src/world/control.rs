//! Keeping to a lane and a speed, and what a command from outside changes about them.
//!
//! # Source
//!
//! highway-env 1.12.1, `vehicle/controller.py`.

use std::f64::consts::FRAC_PI_4;

use serde::{Deserialize, Serialize};

use super::constants::{HEADING_GAIN, LATERAL_GAIN, LENGTH, MAX_STEERING, PURSUIT, SPEED_GAIN};
use super::lane::wrap;
use super::road::Side;
use super::traffic::Traffic;

/// A command to a driver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DriverCommand {
    /// Steer for the next lane on a side.
    Change(Side),
    /// Keep lane and wanted speed.
    Idle,
    /// One step up the grid of speeds.
    Faster,
    /// One step down the grid of speeds.
    Slower,
}

/// Evenly spaced target speeds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SpeedGrid {
    /// The lowest, in m/s.
    pub lowest: f64,
    /// The highest, in m/s.
    pub highest: f64,
    /// How many (2 to 64).
    pub n_speeds: u32,
}

impl SpeedGrid {
    /// The original's: 20, 25, 30 m/s.
    pub const STOCK: Self = Self { lowest: 20.0, highest: 30.0, n_speeds: 3 };

    /// Finds the place of the nearest speed.
    pub fn index(&self, speed: f64) -> u32 {
        let place = (speed - self.lowest) / (self.highest - self.lowest) * self.last();
        place.round_ties_even().clamp(0.0, self.last()) as u32
    }

    fn speed(&self, index: u32) -> f64 {
        self.lowest + f64::from(index) * (self.highest - self.lowest) / self.last()
    }

    fn below(&self, speed: f64) -> f64 {
        self.speed(self.index(speed).saturating_sub(1))
    }

    fn above(&self, speed: f64) -> f64 {
        self.speed((self.index(speed) + 1).min(self.n_speeds - 1))
    }

    fn last(&self) -> f64 {
        f64::from(self.n_speeds - 1)
    }
}

/// Keeps away from zero, where a formula divides by it.
pub(super) fn not_zero(x: f64) -> f64 {
    const LEAST: f64 = 0.01;
    match x {
        x if x.abs() > LEAST => x,
        x if x >= 0.0 => LEAST,
        _ => -LEAST,
    }
}

impl Traffic {
    /// Gives a car a command; returns whether it changed what its driver wants (a lane change can be impossible).
    ///
    /// No look at other traffic is taken.
    pub fn command(&mut self, me: usize, command: DriverCommand, grid: &SpeedGrid) -> bool {
        self.follow_road(me);
        let speed = self.vehicles[me].speed;
        match command {
            DriverCommand::Idle => {}
            DriverCommand::Faster => self.vehicles[me].target_speed = grid.above(speed),
            DriverCommand::Slower => self.vehicles[me].target_speed = grid.below(speed),
            DriverCommand::Change(side) => {
                let Some(lane) = self.lane_for_change(me, side) else { return false };
                self.vehicles[me].target_lane = lane;
            }
        }
        true
    }

    /// Returns the lane on a side of a car's target lane, if the car could steer for it.
    pub fn lane_for_change(&self, me: usize, side: Side) -> Option<usize> {
        let vehicle = &self.vehicles[me];
        let lane = self.network().sides(vehicle.target_lane)[side as usize]?;
        self.network().lane(lane).is_reachable_from(vehicle.position).then_some(lane)
    }

    /// Goes on to the next lane where the target lane ends.
    pub(super) fn follow_road(&mut self, me: usize) {
        let vehicle = &mut self.vehicles[me];
        let network = &self.road.network;
        if network.lane(vehicle.target_lane).is_behind(vehicle.position) {
            vehicle.target_lane = network.next(vehicle.target_lane, vehicle.position);
        }
    }

    /// Computes the steering angle that leads to a car's target lane.
    pub(super) fn steering(&self, me: usize) -> f64 {
        let vehicle = &self.vehicles[me];
        let lane = self.network().lane(vehicle.target_lane);
        let [s, r] = lane.local(vehicle.position);
        let speed = not_zero(vehicle.speed);
        let approach = libm::asin((-LATERAL_GAIN * r / speed).clamp(-1.0, 1.0));
        let heading =
            lane.heading(s + PURSUIT * vehicle.speed) + approach.clamp(-FRAC_PI_4, FRAC_PI_4);
        let rate = HEADING_GAIN * wrap(heading - vehicle.heading);
        let slip = libm::asin((LENGTH / 2.0 / speed * rate).clamp(-1.0, 1.0));
        libm::atan(2.0 * libm::tan(slip)).clamp(-MAX_STEERING, MAX_STEERING)
    }

    /// Computes the acceleration that leads to a car's target speed.
    pub(super) fn speed_control(&self, me: usize) -> f64 {
        SPEED_GAIN * (self.vehicles[me].target_speed - self.vehicles[me].speed)
    }

    /// Decides for a driver who looks at the road only.
    pub(super) fn keep_lane_and_speed(&mut self, me: usize) {
        self.follow_road(me);
        let (steering, acceleration) = (self.steering(me), self.speed_control(me));
        let vehicle = &mut self.vehicles[me];
        (vehicle.steering, vehicle.acceleration) = (steering, acceleration);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_grid_is_climbed_from_the_actual_speed() {
        let grid = SpeedGrid { lowest: 15.0, highest: 38.0, n_speeds: 5 };
        let speeds: Vec<f64> = (0..5).map(|index| grid.speed(index)).collect();
        assert_eq!(speeds, [15.0, 20.75, 26.5, 32.25, 38.0]);
        assert_eq!((grid.below(30.0), grid.above(30.0)), (26.5, 38.0));
        assert_eq!((grid.below(10.0), grid.above(45.0)), (15.0, 38.0));
        // Halves go to the even place, as in numpy.
        assert_eq!([22.5, 27.5].map(|speed| SpeedGrid::STOCK.index(speed)), [0, 2]);
    }

    #[test]
    fn nothing_divides_by_zero() {
        assert_eq!([0.0, -0.001, -5.0, 0.02].map(not_zero), [0.01, -0.01, -5.0, 0.02]);
    }
}
