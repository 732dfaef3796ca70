//! The scripted notifier: warns when a merging car and the ego would meet.
//!
//! Both are taken to go on as they do. Where the merging car is when it can first change lanes, shortly after the
//! merge, the ego must not be near. If it would be, "slow down"; and if there is no time left for that, "merge" away
//! from the ramp, given that the other lane is free.

use leadtime_sims::Message;

use super::reaction::{EGO, MERGE_LEFT, MERGE_RIGHT, SLOW_DOWN};
use super::settings::HeuristicSettings;
use crate::world::{CarRole, Ramp, Side, Traffic, Vehicle};

/// How far beyond the merge a car changes lanes, in metres.
const CHANGES_AFTER: f64 = 10.0;
/// Less time than this, and braking comes too late, in seconds.
const TOO_LATE: f64 = 2.5;
/// How far ahead and behind a lane must be free, in metres.
const FREE: f64 = 25.0;

/// Returns the message that the scripted notifier would start now.
pub(super) fn advise(traffic: &Traffic, settings: &HeuristicSettings) -> Option<Message> {
    let ego = &traffic.vehicles[EGO];
    let ramp = traffic.road.ramps.iter().find(|ramp| ego.position[0] < ramp.end_x)?;
    let cars = traffic.vehicles.iter().filter(|car| car.role == CarRole::Merging);
    let mut cars = cars.filter(|car| car.position[0] < ramp.end_x);
    let conflict = cars.any(|car| meet(ego, car, ramp, settings));
    if !conflict || !is_beside(traffic, ego, ramp) {
        return None;
    }
    let left = (ramp.merge_x + CHANGES_AFTER - ego.position[0]) / ego.speed.max(1.0);
    let (side, topic) = match ramp.side {
        Side::Left => (Side::Right, MERGE_RIGHT),
        Side::Right => (Side::Left, MERGE_LEFT),
    };
    let topic = if left < TOO_LATE && is_free(traffic, side) { topic } else { SLOW_DOWN };
    Some(Message { topic, comprehension: 2, conveyance: 5 })
}

/// Returns whether the ego will be near a merging car where that car changes lanes.
fn meet(ego: &Vehicle, car: &Vehicle, ramp: &Ramp, settings: &HeuristicSettings) -> bool {
    let left = (ramp.merge_x - ego.position[0]) / ego.speed.max(1.0);
    let lead = lead_over(ego, car, ramp);
    left < settings.earliest && -settings.gap_behind < lead && lead < settings.gap_ahead
}

/// Returns by how many metres the ego will be ahead where a merging car can first change lanes, if both go on as they do.
pub(super) fn lead_over(ego: &Vehicle, car: &Vehicle, ramp: &Ramp) -> f64 {
    let place = (ramp.merge_x + CHANGES_AFTER).max(car.position[0]);
    let time = (place - car.position[0]) / car.speed.max(1.0);
    ego.position[0] + ego.speed * time - place
}

/// Returns whether the ego is on, or bound for, the lane next to the ramp.
pub(super) fn is_beside(traffic: &Traffic, ego: &Vehicle, ramp: &Ramp) -> bool {
    let network = traffic.network();
    let [left, right] = network.sides(ramp.parallel());
    let Some(beside) = left.or(right) else { return false };
    [ego.lane, ego.target_lane].iter().any(|&lane| network.rank(lane) == network.rank(beside))
}

/// Returns whether the ego's lane on a side is there, and free around the ego.
pub(super) fn is_free(traffic: &Traffic, side: Side) -> bool {
    let Some(lane) = traffic.lane_for_change(EGO, side) else { return false };
    let network = traffic.network();
    let ego = network.lane(lane).along(traffic.vehicles[EGO].position);
    let near = |s: f64| (s - ego).abs() < FREE;
    let mut others = traffic.vehicles[EGO + 1..].iter();
    !others.any(|car| network.seen_along(lane, car.position).is_some_and(near))
}
