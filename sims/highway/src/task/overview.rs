//! What a script may look at besides the observation: the next ramp, and the car that comes from it.

use leadtime_sims::Quantity;

use super::heuristic::{is_beside, is_free, lead_over};
use super::reaction::EGO;
use crate::world::{CarRole, Ramp, Side, Traffic};

/// What stands for a distance where there is no ramp, or no car, in metres.
const FAR: f64 = 1000.0;

/// Says what the numbers of [`observe`] are.
pub(super) fn quantities() -> Vec<Quantity> {
    let metres = [-FAR as f32, FAR as f32];
    vec![
        Quantity::new("ramp.ahead", "way to where the next ramp meets the road, in m", metres),
        Quantity::flag("ramp.left", "whether that ramp comes from the left"),
        Quantity::flag(
            "ramp.beside",
            "whether the own car is on the lane next to it, or bound for it",
        ),
        Quantity::new(
            "merger.lead",
            "how far the own car will be ahead of a car from that ramp where it merges, if both go on as they do, in m: of \
             several cars that for which it is nearest to 0",
            metres,
        ),
        Quantity::flag("left.free", "whether there is a lane to the left, free beside the own car"),
        Quantity::flag(
            "right.free",
            "whether there is a lane to the right, free beside the own car",
        ),
    ]
}

/// Writes what a script may look at. Shape `[6]`.
pub(super) fn observe(traffic: &Traffic, out: &mut [f32]) {
    let ego = &traffic.vehicles[EGO];
    let ramp = traffic.road.ramps.iter().find(|ramp| ego.position[0] < ramp.end_x);
    let flag = |is_so: bool| f32::from(u8::from(is_so));
    out.copy_from_slice(&[
        ramp.map_or(FAR, |ramp| ramp.merge_x - ego.position[0]) as f32,
        flag(ramp.is_some_and(|ramp| ramp.side == Side::Left)),
        flag(ramp.is_some_and(|ramp| is_beside(traffic, ego, ramp))),
        ramp.map_or(FAR, |ramp| least_lead(traffic, ramp)).clamp(-FAR, FAR) as f32,
        flag(is_free(traffic, Side::Left)),
        flag(is_free(traffic, Side::Right)),
    ]);
}

/// Returns the lead over the car from a ramp for which it is nearest to 0.
fn least_lead(traffic: &Traffic, ramp: &Ramp) -> f64 {
    let cars = traffic.vehicles.iter().filter(|car| car.role == CarRole::Merging);
    let leads = cars.filter(|car| car.position[0] < ramp.end_x);
    let leads = leads.map(|car| lead_over(&traffic.vehicles[EGO], car, ramp));
    leads.min_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(FAR)
}
