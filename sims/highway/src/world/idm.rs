//! The driver: keeping distance by the Intelligent Driver Model, changing lanes by MOBIL.
//!
//! The polite part of MOBIL is left out, as the original's politeness is 0: those behind count only by how hard they
//! would have to brake. With that, nobody on the carriageway makes room for a ramp.
//!
//! # Source
//!
//! Treiber, Hennecke, Helbing, *Congested traffic states in empirical observations and microscopic simulations*
//! (2000); Kesting, Treiber, Helbing, *General lane-changing model MOBIL* (2007); as built in highway-env 1.12.1,
//! `vehicle/behavior.py`.

use super::constants::{
    BRAKING_IMPOSED, COMFORT_ACCELERATION, COMFORT_BRAKING, JAM_DISTANCE, LANE_CHANGE_DELAY,
    LANE_CHANGE_GAIN, MAX_ACCELERATION, TIME_GAP,
};
use super::control::not_zero;
use super::network::LaneId;
use super::traffic::Traffic;
use super::vehicle::{Driver, Idm};

/// Slower than this nobody thinks of changing lanes, in m/s.
const SLOWEST_CHANGE: f64 = 1.0;

impl Traffic {
    /// Computes the acceleration of a car behind a body, in m/s².
    ///
    /// `who` may be any body: nobody and obstacles do not accelerate. Distances are along the lane that `who` is on,
    /// and its speed limit counts.
    pub fn acceleration(&self, who: Option<usize>, front: Option<usize>) -> f64 {
        let Some(who) = who.filter(|&who| who < self.vehicles.len()) else { return 0.0 };
        self.free_acceleration(who) - self.pressure(who, front)
    }

    /// Computes the acceleration of a car on an empty road, in m/s².
    fn free_acceleration(&self, who: usize) -> f64 {
        let vehicle = &self.vehicles[who];
        let limit = self.network().lane(vehicle.lane).speed_limit;
        let wanted = not_zero(vehicle.target_speed.clamp(0.0, limit)).abs();
        let ratio = vehicle.speed.max(0.0) / wanted;
        COMFORT_ACCELERATION * (1.0 - (ratio * ratio) * (ratio * ratio))
    }

    /// Computes what a body ahead takes off a car's acceleration, in m/s².
    fn pressure(&self, who: usize, front: Option<usize>) -> f64 {
        let Some(front) = front else { return 0.0 };
        let distance = not_zero(self.gap(who, front, self.vehicles[who].lane));
        let pressure = self.desired_gap(who, front) / distance;
        COMFORT_ACCELERATION * (pressure * pressure)
    }

    /// Computes the distance that a car wants behind a body, in metres; a leader that draws away makes it negative.
    pub fn desired_gap(&self, who: usize, front: usize) -> f64 {
        let vehicle = &self.vehicles[who];
        let [vx, vy] = vehicle.velocity();
        let [fx, fy] = self.velocity_of(front);
        let [cosine, sine] = vehicle.direction();
        let closing = (vx - fx) * cosine + (vy - fy) * sine;
        let braking = 2.0 * libm::sqrt(COMFORT_ACCELERATION * COMFORT_BRAKING);
        JAM_DISTANCE + vehicle.speed * TIME_GAP + vehicle.speed * closing / braking
    }

    /// Decides for an IDM driver; a crashed one decides nothing.
    pub(super) fn drive(&mut self, me: usize) {
        let Driver::Idm(Idm { changes_lanes, holds_speed, held_braking, .. }) =
            self.vehicles[me].driver
        else {
            return;
        };
        if self.vehicles[me].crashed {
            return;
        }
        self.follow_road(me);
        if changes_lanes {
            self.consider_lanes(me);
        }
        let steering = self.steering(me);
        let vehicle = &self.vehicles[me];
        let (lane, target_lane) = (vehicle.lane, vehicle.target_lane);
        let mut pressure = self.pressure(me, self.neighbours(me, lane)[0]);
        if lane != target_lane {
            pressure = pressure.max(self.pressure(me, self.neighbours(me, target_lane)[0]));
        }
        let mut free = self.free_acceleration(me);
        if holds_speed {
            free = free.max(-held_braking);
        }
        let mut acceleration = free - pressure;
        if holds_speed {
            // IDM towards a lower target brakes softly at first; the controller does what was asked for.
            acceleration = acceleration.min(self.speed_control(me).max(-held_braking));
        }
        let vehicle = &mut self.vehicles[me];
        vehicle.steering = steering;
        vehicle.acceleration = acceleration.clamp(-MAX_ACCELERATION, MAX_ACCELERATION);
    }

    /// Starts, aborts or leaves a change of lanes.
    fn consider_lanes(&mut self, me: usize) {
        let vehicle = &self.vehicles[me];
        let (lane, target_lane) = (vehicle.lane, vehicle.target_lane);
        if lane != target_lane {
            if self.network().same_road(lane, target_lane) && self.is_anticipated(me) {
                self.vehicles[me].target_lane = lane;
            }
            return;
        }
        let Driver::Idm(idm) = &mut self.vehicles[me].driver else { return };
        if idm.timer <= LANE_CHANGE_DELAY {
            return;
        }
        idm.timer = 0.0;
        if self.vehicles[me].speed.abs() < SLOWEST_CHANGE {
            return;
        }
        // Both sides are asked, and the right one has the last word.
        for beside in self.network().sides(lane).into_iter().flatten() {
            let reachable =
                self.network().lane(beside).is_reachable_from(self.vehicles[me].position);
            if reachable && self.gains(me, beside) {
                self.vehicles[me].target_lane = beside;
            }
        }
    }

    /// Returns whether somebody close ahead is changing into the same lane.
    fn is_anticipated(&self, me: usize) -> bool {
        let vehicle = &self.vehicles[me];
        (0..self.vehicles.len()).any(|other| {
            let rival = &self.vehicles[other];
            let competes = rival.driver != Driver::Nobody
                && rival.lane != vehicle.target_lane
                && rival.target_lane == vehicle.target_lane;
            if other == me || !competes || !self.sees(me, other) {
                return false;
            }
            let distance = self.gap(me, other, vehicle.lane);
            0.0 < distance && distance < self.desired_gap(me, other)
        })
    }

    /// Returns whether a lane change makes nobody behind brake too hard.
    pub fn is_safe_change(&self, me: usize, lane: LaneId) -> bool {
        let [_, behind] = self.neighbours(me, lane);
        self.acceleration(behind, Some(me)) >= -BRAKING_IMPOSED
    }

    /// Returns whether MOBIL wants to change into a lane.
    fn gains(&self, me: usize, lane: LaneId) -> bool {
        let [ahead_there, behind_there] = self.neighbours(me, lane);
        if self.acceleration(behind_there, Some(me)) < -BRAKING_IMPOSED {
            return false;
        }
        let [ahead_here, _] = self.neighbours(me, self.vehicles[me].lane);
        let gain =
            self.acceleration(Some(me), ahead_there) - self.acceleration(Some(me), ahead_here);
        gain >= LANE_CHANGE_GAIN
    }
}
