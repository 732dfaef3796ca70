//! Cars and obstacles on a road, and the order in which a frame happens.
//!
//! 1. Every driver in turn looks and decides: they see positions as they were, and the target lanes of those who
//!    decided before them.
//! 2. Every car moves.
//! 3. Every pair is checked for collisions, and every car against the obstacles.
//!
//! Cars are listed in the order in which they came; it breaks ties.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::network::{LaneId, RoadNetwork};
use super::road::Road;
use super::vehicle::{CarRole, Driver, Vehicle};

/// How long a merging car and the ego do not see each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Blindness {
    /// Until the merging car has settled on the carriageway: in the middle of its lane, and bound for no other.
    UntilSettled,
    /// As long as the merging car is on a lane of the ramp.
    UntilOnCarriageway,
    /// For ever: cars from ramps and the ego never see each other.
    Always,
    /// Not at all: everybody sees everybody.
    Never,
}

/// How far from its lane's centre a car is settled, in metres.
const SETTLED: f64 = 0.5;

/// A road with cars on it.
#[derive(Clone, Debug)]
pub struct Traffic {
    /// The road that they are on.
    pub road: Arc<Road>,
    /// The cars, in the order in which they came.
    pub vehicles: Vec<Vehicle>,
    blindness: Blindness,
}

impl Traffic {
    /// Opens an empty road.
    pub fn new(road: Arc<Road>, blindness: Blindness) -> Self {
        Self { road, vehicles: Vec::new(), blindness }
    }

    /// Returns the lanes of the road.
    pub fn network(&self) -> &RoadNetwork {
        &self.road.network
    }

    /// Advances the world by one frame of `dt` seconds.
    pub fn step(&mut self, dt: f64) {
        self.decide();
        let network = &self.road.network;
        for vehicle in &mut self.vehicles {
            vehicle.integrate(network, dt);
        }
        self.collide(dt);
        self.settle();
    }

    fn decide(&mut self) {
        for me in 0..self.vehicles.len() {
            match self.vehicles[me].driver {
                Driver::Nobody => {}
                Driver::Controller => self.keep_lane_and_speed(me),
                Driver::Idm(_) => self.drive(me),
            }
        }
    }

    /// Returns whether one driver takes another car into account.
    pub fn sees(&self, observer: usize, other: usize) -> bool {
        let (observer, other) = (&self.vehicles[observer], &self.vehicles[other]);
        match (observer.role, other.role) {
            (CarRole::Ego, _) => !self.is_hidden(other),
            (_, CarRole::Ego) => !self.is_hidden(observer),
            _ => true,
        }
    }

    /// Returns whether a car and the ego do not see each other.
    fn is_hidden(&self, car: &Vehicle) -> bool {
        let merges = car.role == CarRole::Merging;
        match self.blindness {
            Blindness::UntilSettled => merges,
            Blindness::UntilOnCarriageway => merges && self.network().lane(car.lane).forbidden,
            Blindness::Always => merges || car.role == CarRole::Merged,
            Blindness::Never => false,
        }
    }

    /// Finds the next bodies ahead of and behind a driver along a lane, among those that they see.
    ///
    /// A body is a car, or an obstacle, numbered after the cars.
    pub fn neighbours(&self, me: usize, lane: LaneId) -> [Option<usize>; 2] {
        let own = self.network().lane(lane).along(self.vehicles[me].position);
        let (mut ahead, mut behind) = (None, None);
        let (mut nearest, mut farthest) = (f64::INFINITY, f64::NEG_INFINITY);
        for other in 0..self.vehicles.len() + self.road.obstacles.len() {
            let is_car = other < self.vehicles.len();
            if other == me || (is_car && !self.sees(me, other)) {
                continue;
            }
            let Some(s) = self.network().seen_along(lane, self.place_of(other)) else { continue };
            // Of two bodies at the same place ahead the later one counts, behind the earlier one.
            if own <= s && s <= nearest {
                (ahead, nearest) = (Some(other), s);
            }
            if s < own && s > farthest {
                (behind, farthest) = (Some(other), s);
            }
        }
        [ahead, behind]
    }

    pub(super) fn place_of(&self, body: usize) -> [f64; 2] {
        let n_vehicles = self.vehicles.len();
        match self.vehicles.get(body) {
            Some(vehicle) => vehicle.position,
            None => self.road.obstacles[body - n_vehicles],
        }
    }

    /// Returns how far ahead of a car a body is, along a lane.
    pub(super) fn gap(&self, me: usize, body: usize, lane: LaneId) -> f64 {
        let lane = self.network().lane(lane);
        lane.along(self.place_of(body)) - lane.along(self.vehicles[me].position)
    }

    /// Ends the merging of cars that have settled, whatever the blindness is.
    fn settle(&mut self) {
        let is_unseen = self.blindness == Blindness::Always;
        let settled = if is_unseen { CarRole::Merged } else { CarRole::Traffic };
        for vehicle in self.vehicles.iter_mut().filter(|car| car.role == CarRole::Merging) {
            let lane = self.road.network.lane(vehicle.lane);
            let bound = vehicle.lane == vehicle.target_lane;
            let centred = lane.local(vehicle.position)[1].abs() < SETTLED;
            if bound && centred && !lane.forbidden {
                vehicle.role = settled;
            }
        }
    }
}

#[cfg(test)]
#[path = "traffic_tests.rs"]
mod tests;
