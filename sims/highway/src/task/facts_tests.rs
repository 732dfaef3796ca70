//! Every fact of the road, where a driver would agree and where not.

use std::sync::Arc;

use super::*;
use crate::world::{Blindness, Lookup, RoadSettings};

/// Where a car is: on a lane of the carriageway, at x, or on the first ramp.
#[derive(Clone, Copy)]
enum At {
    Left(f64),
    Right(f64),
    Ramp(f64),
}

use At::{Left, Ramp as OnRamp, Right};

/// A car: where it is, its speed, and whether it comes from the ramp.
type Car = (At, f64, bool);

/// Puts cars on the road with three merges, the first from the right at 230 m; the ego first.
fn traffic(cars: &[Car]) -> Traffic {
    let road = RoadSettings::three_merges().build(Lookup::Geometry).unwrap();
    let mut traffic = Traffic::new(Arc::new(road), Blindness::UntilSettled);
    for (i, &(at, speed, merges)) in cars.iter().enumerate() {
        let network = traffic.network();
        let (position, heading) = match at {
            Left(x) => ([x, 0.0], 0.0),
            Right(x) => ([x, 4.0], 0.0),
            OnRamp(x) => {
                let mut lanes = traffic.road.ramps[0].lanes.iter().map(|&lane| network.lane(lane));
                let found = lanes.find(|lane| x < lane.end()[0]).unwrap();
                let s = found.along([x, found.position(0.0, 0.0)[1]]);
                (found.position(s, 0.0), found.heading(s))
            }
        };
        let role = match (i, merges) {
            (EGO, _) => CarRole::Ego,
            (_, true) => CarRole::Merging,
            (_, false) => CarRole::Traffic,
        };
        traffic.vehicles.push(Vehicle::new(network, position, heading, speed).with_role(role));
    }
    traffic
}

fn holds(name: &str, cars: &[Car]) -> bool {
    let told = TOLD.iter().find(|told| told.0 == name).unwrap_or_else(|| panic!("{name}"));
    (told.2)(DriveMoment { traffic: &traffic(cars), desired_speed: 30.0 })
}

#[test]
fn every_fact_holds_where_a_driver_would_agree_and_nowhere_else() {
    let ego = (Right(100.0), 30.0, false);
    let later = (Right(200.0), 30.0, false);
    let car = |at, speed| (at, speed, false);
    let merger = |x, speed| (OnRamp(x), speed, true);
    let cases: &[(&str, &[Car], &[Car])] = &[
        ("traffic_ahead", &[ego, car(Left(180.0), 30.0)], &[ego, car(Left(210.0), 30.0)]),
        ("traffic_ahead", &[ego, car(Left(180.0), 30.0)], &[ego, merger(140.0, 20.0)]),
        ("car_ahead", &[ego, car(Right(180.0), 30.0)], &[ego, car(Left(180.0), 30.0)]),
        ("gap_ahead", &[ego, car(Right(160.0), 30.0)], &[ego, car(Right(140.0), 30.0)]),
        ("lane_clear", &[ego, car(Left(180.0), 30.0)], &[ego, car(Right(180.0), 30.0)]),
        ("road_clear", &[ego, car(Left(60.0), 30.0)], &[ego, merger(140.0, 20.0)]),
        ("gap_closing", &[ego, car(Right(180.0), 25.0)], &[ego, car(Right(180.0), 30.0)]),
        (
            "merge_gap_closing",
            &[(Right(200.0), 20.0, false), merger(180.0, 25.0)],
            &[(Right(200.0), 20.0, false), merger(180.0, 20.0)],
        ),
        ("car_behind", &[later, car(Right(160.0), 30.0)], &[later, car(Left(160.0), 30.0)]),
        (
            "car_closing_behind",
            &[later, car(Right(160.0), 33.0)],
            &[later, car(Right(160.0), 30.0)],
        ),
        ("traffic_behind", &[later, car(Left(160.0), 30.0)], &[later, car(Left(120.0), 30.0)]),
        ("car_to_pass", &[later, car(Left(240.0), 28.0)], &[later, car(Right(240.0), 28.0)]),
        ("car_to_pass", &[later, car(Left(240.0), 28.0)], &[later, car(Left(240.0), 31.0)]),
        ("ramp_ahead", &[ego], &[(Right(250.0), 30.0, false)]),
        ("car_on_ramp", &[ego, merger(120.0, 20.0)], &[ego, car(Right(120.0), 20.0)]),
        ("car_merging", &[later, merger(200.0, 20.0)], &[later, merger(150.0, 20.0)]),
        ("car_merging", &[later, (Right(250.0), 20.0, true)], &[later, car(Right(250.0), 20.0)]),
        ("merging_car_ahead", &[later, merger(210.0, 20.0)], &[later, merger(190.0, 20.0)]),
        ("hidden_car_ahead", &[ego, merger(140.0, 20.0)], &[ego, car(OnRamp(140.0), 20.0)]),
        ("danger_ahead", &[ego, car(Right(150.0), 15.0)], &[ego, car(Right(180.0), 29.0)]),
        // Both are 10 m beyond the merge after four seconds; the other comes 40 m later.
        (
            "danger_ahead",
            &[(Right(120.0), 30.0, false), merger(160.0, 20.0)],
            &[(Right(120.0), 30.0, false), merger(120.0, 20.0)],
        ),
        ("lane_ends", &[(OnRamp(250.0), 20.0, false)], &[(Right(250.0), 20.0, false)]),
        ("left_lane", &[ego], &[(Left(100.0), 30.0, false)]),
        ("right_lane", &[(Left(100.0), 30.0, false)], &[ego]),
        // What lies to the right there is the ramp.
        ("right_lane", &[(Left(250.0), 30.0, false)], &[(Right(250.0), 30.0, false)]),
        ("too_fast", &[(Right(100.0), 32.0, false)], &[ego]),
        ("too_slow", &[(Right(100.0), 25.0, false)], &[ego]),
        (
            "too_slow",
            &[(Right(100.0), 25.0, false)],
            &[(Right(100.0), 25.0, false), car(Right(130.0), 25.0)],
        ),
    ];
    for (i, (name, so, other)) in cases.iter().enumerate() {
        assert!(holds(name, so), "{name}, case {i}");
        assert!(!holds(name, other), "{name}, case {i} otherwise");
    }
    assert!(TOLD.iter().all(|told| cases.iter().any(|case| case.0 == told.0)));
}

#[test]
fn on_an_empty_road_beyond_the_ramps_only_room_is_told() {
    let cars = [(Right(950.0), 30.0, false)];
    let told: Vec<&str> =
        TOLD.iter().map(|told| told.0).filter(|name| holds(name, &cars)).collect();
    assert_eq!(told, ["gap_ahead", "lane_clear", "road_clear", "left_lane"]);
}
