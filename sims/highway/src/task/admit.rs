//! Who comes onto the road, when and where.
//!
//! Draws, in this order: the ego's lane; for each car of the traffic its lane, place and speed; for each merging car,
//! when it appears, by how much it leads.

use leadtime_numerics::Pcg64;

use super::settings::{
    HighwayWorldSettings, MergingSettings, StartLane, TrafficSettings, start_lanes,
};
use crate::world::{CarRole, Ramp, Traffic, Vehicle};

/// An ego slower than this would make a merging car start too far out, in m/s.
const SLOWEST_EGO: f64 = 15.0;
/// The greatest distance to the merge before the lead is taken off, in metres.
const FARTHEST: f64 = 225.0;

/// Places the ego and the traffic on an empty road.
pub(super) fn populate(
    traffic: &mut Traffic,
    settings: &HighwayWorldSettings,
    generator: &mut Pcg64,
) {
    let n_lanes = start_lanes(&traffic.road).count();
    let ego = &settings.ego;
    let rank = ego.lane.map_or_else(|| generator.below(n_lanes), |lane| lane as usize);
    let vehicle = start(traffic, rank, ego.x, ego.speed).with_idm(ego.desired_speed);
    traffic.vehicles.push(vehicle.with_role(CarRole::Ego));
    let TrafficSettings { cars, position_spread, speed_spread } = &settings.traffic;
    let own = rank;
    for car in cars {
        let rank = match car.lane {
            StartLane::Any => generator.below(n_lanes),
            StartLane::Own => own,
            // A road of one lane has no other one.
            StartLane::Other => (own + 1 + generator.below(n_lanes.max(2) - 1)) % n_lanes,
        };
        let x = car.x + generator.uniform(-position_spread, *position_spread);
        let speed = car.speed + generator.uniform(-speed_spread, *speed_spread);
        let vehicle = start(traffic, rank, x, speed).with_idm(speed);
        traffic.vehicles.push(vehicle);
    }
}

fn start(traffic: &Traffic, rank: usize, s: f64, speed: f64) -> Vehicle {
    let network = traffic.network();
    let mut lanes = start_lanes(&traffic.road);
    let lane = lanes.find(|&lane| network.rank(lane) as usize == rank).unwrap_or(0);
    let lane = network.lane(lane);
    Vehicle::new(network, lane.position(s, 0.0), lane.heading(s), speed)
}

/// Creates the car of a ramp: it would arrive at the merge with the ego, less its lead.
pub(super) fn merging_car(
    traffic: &Traffic,
    ramp: &Ramp,
    settings: &MergingSettings,
    generator: &mut Pcg64,
) -> Vehicle {
    let lead = generator.uniform(settings.lead[0], settings.lead[1]);
    let ego_speed = traffic.vehicles[0].speed.max(SLOWEST_EGO);
    let together = (settings.speed * settings.distance / ego_speed).min(FARTHEST);
    let mut distance = (together - lead).clamp(settings.range[0], settings.range[1]);
    let network = traffic.network();
    let mut place = ([ramp.merge_x - distance, 0.0], 0.0);
    for &lane in ramp.lanes[..ramp.lanes.len() - 1].iter().rev() {
        let lane = network.lane(lane);
        let s = lane.length - distance;
        place = (lane.position(s, 0.0), lane.heading(s));
        if s >= 0.0 {
            break;
        }
        distance -= lane.length;
    }
    let vehicle = Vehicle::new(network, place.0, place.1, settings.speed);
    vehicle.with_idm(settings.desired_speed).with_role(CarRole::Merging)
}
