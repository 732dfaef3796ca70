//! What is true of the road now: the facts that sentences to the driver presuppose.
//!
//! Positions are centres of cars, in metres along the road. What the driver cannot see is there all the same: a fact is
//! about the road and not about what the driver knows of it.
//!
//! | threshold | value | why |
//! |---|---|---|
//! | [`AHEAD`] | 100 m | three seconds at 30 m/s: a driver mentions the cars that concern them |
//! | [`BEHIND`] | 60 m | what fills the mirror; two seconds at 30 m/s |
//! | [`NEXT_RAMP`] | 200 m | seven seconds: where the cars of a ramp appear by default, and signs announce it |
//! | [`ABOUT`] | 50 m | the last two and a half seconds on the ramp: the car is about to merge |
//! | [`GAP`] | 50 m | the distance that a driver keeps at 30 m/s, and a car more |
//! | [`FASTER`] | 1 m/s | a difference in speed that can be seen |
//! | [`SOON`] | 5 s | a car that is reached within this is a danger |
//! | [`MEETS`] | 20 m | cars that come this near where one merges have to do something about it |

use leadtime_sims::Fact;

use super::heuristic::{is_beside, lead_over};
use super::reaction::EGO;
use crate::world::{CarRole, LaneId, Ramp, Side, Traffic, Vehicle};

const AHEAD: f64 = 100.0;
const BEHIND: f64 = 60.0;
const NEXT_RAMP: f64 = 200.0;
const ABOUT: f64 = 50.0;
const GAP: f64 = 50.0;
const FASTER: f64 = 1.0;
const SOON: f64 = 5.0;
const MEETS: f64 = 20.0;
/// How far ahead the car that merges must leave room for the ego to speak of a gap before it, in metres.
const MERGE_GAP: f64 = 40.0;
/// Slower than wanted by this, with nothing in the way, is too slow, in m/s.
const TOO_SLOW: f64 = 3.0;

/// What the facts are read off.
#[derive(Clone, Copy, Debug)]
pub(super) struct DriveMoment<'a> {
    /// The cars and their road.
    pub(super) traffic: &'a Traffic,
    /// The speed that the driver wants, in m/s.
    pub(super) desired_speed: f64,
}

impl<'a> DriveMoment<'a> {
    fn ego(self) -> &'a Vehicle {
        &self.traffic.vehicles[EGO]
    }

    /// Lists the other cars, each with how far ahead of the ego it is.
    fn others(self) -> impl Iterator<Item = (&'a Vehicle, f64)> {
        let x = self.ego().position[0];
        self.traffic.vehicles[EGO + 1..].iter().map(move |car| (car, car.position[0] - x))
    }

    fn is_on_carriageway(self, car: &Vehicle) -> bool {
        !self.traffic.network().lane(car.lane).forbidden
    }

    /// Lists the cars on the ego's lane, each with how far ahead of the ego it is along the lane.
    fn on_lane(self) -> impl Iterator<Item = (&'a Vehicle, f64)> {
        let (network, ego) = (self.traffic.network(), self.ego());
        let own = network.lane(ego.lane).along(ego.position);
        let cars = self.traffic.vehicles[EGO + 1..].iter();
        cars.filter_map(move |car| Some((car, network.seen_along(ego.lane, car.position)? - own)))
    }

    /// Returns the next car ahead on the ego's lane, and how far it is.
    fn leader(self) -> Option<(&'a Vehicle, f64)> {
        let ahead = self.on_lane().filter(|(_, ahead)| *ahead >= 0.0);
        ahead.min_by(|a, b| a.1.total_cmp(&b.1))
    }

    fn is_free_for(self, distance: f64) -> bool {
        self.leader().is_none_or(|(_, ahead)| ahead > distance)
    }

    /// Returns whether the ego is on its way to run into its leader soon.
    fn closes_in(self) -> bool {
        self.leader().is_some_and(|(car, ahead)| {
            let closing = self.ego().speed - car.speed;
            closing > FASTER && ahead < SOON * closing
        })
    }

    /// Returns the ramp whose merge is next or under way, if it is near.
    fn ramp(self) -> Option<&'a Ramp> {
        let x = self.ego().position[0];
        let next = self.traffic.road.ramps.iter().find(|ramp| x < ramp.end_x);
        next.filter(|ramp| ramp.merge_x - x <= NEXT_RAMP)
    }

    /// Lists the cars that are on the next ramp, or have left it and not settled.
    fn cars_of_ramp(self) -> impl Iterator<Item = (&'a Vehicle, &'a Ramp)> {
        self.ramp().into_iter().flat_map(move |ramp| {
            let comes = move |car: &&Vehicle| {
                let merges = car.role == CarRole::Merging && car.position[0] < ramp.end_x;
                ramp.lanes.contains(&car.lane) || merges
            };
            let cars = self.traffic.vehicles[EGO + 1..].iter().filter(comes);
            cars.map(move |car| (car, ramp))
        })
    }

    /// Returns whether a car is about to leave a ramp, or is between it and the middle of a lane.
    fn merges(self, car: &Vehicle) -> bool {
        let on_ramp =
            self.traffic.road.ramps.iter().any(|ramp| {
                ramp.lanes.contains(&car.lane) && ramp.merge_x - car.position[0] <= ABOUT
            });
        on_ramp || (car.role == CarRole::Merging && self.is_on_carriageway(car))
    }

    fn is_near(self, car: &Vehicle) -> bool {
        (car.position[0] - self.ego().position[0]).abs() <= AHEAD
    }

    fn has_lane(self, side: Side) -> bool {
        let network = self.traffic.network();
        let beside: Option<LaneId> = network.sides(self.ego().lane)[side as usize];
        beside.is_some_and(|lane| !network.lane(lane).forbidden)
    }

    /// Returns whether the ego and a car from the ramp come close where it merges, on the lane next to the ramp.
    fn meets(self, car: &Vehicle, ramp: &Ramp) -> bool {
        lead_over(self.ego(), car, ramp).abs() <= MEETS && is_beside(self.traffic, self.ego(), ramp)
    }
}

fn ahead_within(ahead: f64, reach: f64) -> bool {
    0.0 < ahead && ahead <= reach
}

/// A fact, and whether it holds.
type DriveFact = (&'static str, &'static str, fn(DriveMoment<'_>) -> bool);

/// Every fact of the domain.
const TOLD: &[DriveFact] = &[
    ("traffic_ahead", "a car is at most 100 m ahead on the carriageway, on any lane", |d| {
        d.others().any(|(car, ahead)| d.is_on_carriageway(car) && ahead_within(ahead, AHEAD))
    }),
    ("car_ahead", "a car is at most 100 m ahead on the own lane", |d| !d.is_free_for(AHEAD)),
    ("gap_ahead", "no car within 50 m ahead on the own lane", |d| d.is_free_for(GAP)),
    ("lane_clear", "no car within 100 m ahead on the own lane", |d| d.is_free_for(AHEAD)),
    ("road_clear", "no car within 100 m ahead, on any lane or ramp", |d| {
        !d.others().any(|(_, ahead)| ahead_within(ahead, AHEAD))
    }),
    (
        "gap_closing",
        "a car at most 100 m ahead on the own lane is slower, by more than 1 m/s",
        |d| {
            d.leader()
                .is_some_and(|(car, ahead)| ahead <= AHEAD && d.ego().speed - car.speed > FASTER)
        },
    ),
    (
        "merge_gap_closing",
        "a car from the next ramp would merge at most 40 m behind the own car, and is faster by more than 1 m/s",
        |d| {
            d.cars_of_ramp().any(|(car, ramp)| {
                let lead = lead_over(d.ego(), car, ramp);
                ahead_within(lead, MERGE_GAP) && car.speed - d.ego().speed > FASTER
            })
        },
    ),
    ("car_behind", "a car is at most 60 m behind on the own lane", |d| {
        d.on_lane().any(|(_, ahead)| ahead_within(-ahead, BEHIND))
    }),
    ("car_closing_behind", "a car behind on the own lane is faster, by more than 1 m/s", |d| {
        d.on_lane()
            .any(|(car, ahead)| ahead_within(-ahead, BEHIND) && car.speed - d.ego().speed > FASTER)
    }),
    ("traffic_behind", "a car is at most 60 m behind on the carriageway, on any lane", |d| {
        d.others().any(|(car, ahead)| d.is_on_carriageway(car) && ahead_within(-ahead, BEHIND))
    }),
    ("car_to_pass", "a car on another lane is at most 60 m ahead, and not faster", |d| {
        let on_own = |car: &Vehicle| d.on_lane().any(|(other, _)| std::ptr::eq(other, car));
        d.others().any(|(car, ahead)| {
            let slower = car.speed <= d.ego().speed;
            d.is_on_carriageway(car) && ahead_within(ahead, BEHIND) && slower && !on_own(car)
        })
    }),
    ("ramp_ahead", "a ramp joins the road at most 200 m ahead", |d| {
        let x = d.ego().position[0];
        d.traffic.road.ramps.iter().any(|ramp| ahead_within(ramp.merge_x - x, NEXT_RAMP))
    }),
    ("car_on_ramp", "a car is on the next ramp, which joins the road within 200 m", |d| {
        d.cars_of_ramp().any(|(car, ramp)| ramp.lanes.contains(&car.lane))
    }),
    (
        "car_merging",
        "a car within 100 m is on the last 50 m before a merge, beside the carriageway, or not yet settled on it",
        |d| d.others().any(|(car, _)| d.is_near(car) && d.merges(car)),
    ),
    ("merging_car_ahead", "a car that is merging is at most 100 m ahead", |d| {
        d.others().any(|(car, ahead)| ahead_within(ahead, AHEAD) && d.merges(car))
    }),
    ("hidden_car_ahead", "a car that the driver does not see is at most 100 m ahead", |d| {
        let cars = d.traffic.vehicles.iter().enumerate().skip(EGO + 1);
        let x = d.ego().position[0];
        cars.into_iter()
            .any(|(i, car)| !d.traffic.sees(EGO, i) && ahead_within(car.position[0] - x, AHEAD))
    }),
    (
        "danger_ahead",
        "a car ahead on the own lane is reached within 5 s, or a car from the next ramp comes within 20 m where it merges",
        |d| d.closes_in() || d.cars_of_ramp().any(|(car, ramp)| d.meets(car, ramp)),
    ),
    ("lane_ends", "the own lane ends within 200 m, and one beside it goes on", |d| {
        let (network, ego) = (d.traffic.network(), d.ego());
        let lane = network.lane(ego.lane);
        network.ends(ego.lane) && lane.length - lane.along(ego.position) <= NEXT_RAMP
    }),
    ("left_lane", "there is a lane to the left that may be driven on", |d| d.has_lane(Side::Left)),
    ("right_lane", "there is a lane to the right that may be driven on", |d| {
        d.has_lane(Side::Right)
    }),
    (
        "too_fast",
        "faster by 1 m/s than the lane allows or than the driver wants, or a car ahead is reached within 5 s",
        |d| {
            let limit = d.traffic.network().lane(d.ego().lane).speed_limit;
            d.ego().speed > limit.min(d.desired_speed) + FASTER || d.closes_in()
        },
    ),
    ("too_slow", "slower by 3 m/s than the driver wants, with no car within 50 m ahead", |d| {
        d.ego().speed < d.desired_speed - TOO_SLOW && d.is_free_for(GAP)
    }),
];

pub(super) fn facts() -> Vec<Fact> {
    TOLD.iter().map(|&(name, meaning, _)| Fact { name, meaning }).collect()
}

/// Says which of them hold. Shape as [`facts`].
pub(super) fn observe(drive: DriveMoment<'_>, holds: &mut [bool]) {
    for ((.., is_so), out) in TOLD.iter().zip(holds) {
        *out = is_so(drive);
    }
}

#[cfg(test)]
#[path = "facts_tests.rs"]
mod tests;
