//! Traffic as a whole: nobody leaves the road, and a mirrored road gives the mirrored drive.

use std::sync::Arc;

use proptest::prelude::*;

use super::*;
use crate::world::{Lookup, RoadSettings, Wave};

const DT: f64 = 1.0 / 15.0;

/// A car's start: lane of the carriageway, x, speed, wanted speed.
type CarStart = (bool, f64, f64, f64);

fn starts() -> impl Strategy<Value = Vec<CarStart>> {
    // Places of 30 m each, so that nobody starts inside another.
    let car = (any::<bool>(), 0.0..15.0_f64, 15.0..35.0_f64, 15.0..38.0_f64);
    prop::collection::vec(car, 1..12).prop_map(|cars| {
        let place = |(i, (lane, x, speed, wanted))| (lane, 30.0 * i as f64 + x, speed, wanted);
        cars.into_iter().enumerate().map(place).collect()
    })
}

/// Returns a road as seen in a mirror along y = 0: what was on the left is on the right.
fn mirrored(mut road: RoadSettings) -> RoadSettings {
    for lane in &mut road.lanes {
        (lane.start[1], lane.end[1]) = (-lane.start[1], -lane.end[1]);
        lane.wave = lane.wave.map(|wave| Wave { amplitude: -wave.amplitude, ..wave });
    }
    road.obstacles.iter_mut().for_each(|obstacle| obstacle[1] = -obstacle[1]);
    road
}

fn traffic(road: &RoadSettings, starts: &[CarStart], sign: f64) -> Traffic {
    let road = Arc::new(road.build(Lookup::Geometry).unwrap());
    let mut traffic = Traffic::new(road, Blindness::UntilSettled);
    let ramps = [([110.0, 14.5], CarRole::Merging), ([430.0, -10.5], CarRole::Merging)];
    let cars = starts.iter().map(|&(right, x, speed, wanted)| {
        ([x, if right { 4.0 } else { 0.0 }], CarRole::Traffic, speed, wanted)
    });
    let ramps = ramps.map(|(place, role)| (place, role, 20.0, 30.0));
    for ([x, y], role, speed, wanted) in cars.chain(ramps) {
        let vehicle = Vehicle::new(traffic.network(), [x, sign * y], 0.0, speed);
        let mut vehicle = vehicle.with_idm(wanted).with_role(role);
        if let Driver::Idm(idm) = &mut vehicle.driver {
            // The usual start of a timer depends on y.
            idm.timer = (0.37 * x).rem_euclid(1.0);
        }
        traffic.vehicles.push(vehicle);
    }
    traffic.vehicles[0].role = CarRole::Ego;
    traffic
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn nobody_leaves_the_road(starts in starts()) {
        let mut traffic = traffic(&RoadSettings::three_merges(), &starts, 1.0);
        for frame in 0..600 {
            traffic.step(DT);
            for vehicle in &traffic.vehicles {
                prop_assert!(vehicle.is_proper(traffic.network(), 0));
                let lane = traffic.network().lane(vehicle.lane);
                let [s, r] = lane.local(vehicle.position);
                // A wreck may be pushed aside; everybody else is on a lane, or has driven off the end of the last.
                let beyond = vehicle.position[0] > 1080.0;
                prop_assert!(
                    vehicle.crashed || (r.abs() <= 2.5 && (beyond || s <= lane.length + 1.0)),
                    "frame {}: {:?} at {} {} of {}", frame, vehicle, s, r,
                    traffic.network().name(vehicle.lane)
                );
            }
        }
    }

    #[test]
    fn a_mirrored_road_gives_the_mirrored_drive(starts in starts()) {
        let road = RoadSettings::three_merges();
        let mut plain = traffic(&road, &starts, 1.0);
        let mut mirrored = traffic(&mirrored(road), &starts, -1.0);
        for frame in 0..450 {
            plain.step(DT);
            mirrored.step(DT);
            for (a, b) in plain.vehicles.iter().zip(&mirrored.vehicles) {
                let [x, y] = [a.position[0] - b.position[0], a.position[1] + b.position[1]];
                let same = x.abs() < 1e-6
                    && y.abs() < 1e-6
                    && (a.heading + b.heading).abs() < 1e-6
                    && (a.speed - b.speed).abs() < 1e-6
                    && (a.lane, a.target_lane, a.crashed, a.role)
                        == (b.lane, b.target_lane, b.crashed, b.role);
                prop_assert!(same, "frame {}: {:?} {:?}", frame, a, b);
            }
        }
    }
}

#[test]
fn a_car_on_the_ramp_merges_before_the_obstacle() {
    let mut traffic = traffic(&RoadSettings::three_merges(), &[(false, 800.0, 30.0, 30.0)], 1.0);
    for _ in 0..200 {
        traffic.step(DT);
    }
    // From the right and from the left alike.
    for (car, y) in traffic.vehicles[1..].iter().zip([4.0, 0.0]) {
        assert!(!car.crashed && (car.position[1] - y).abs() < 0.1, "{car:?}");
        assert_eq!(car.role, CarRole::Traffic);
    }
}

#[test]
fn blindness_ends_as_set() {
    use Blindness::{Always, Never, UntilOnCarriageway, UntilSettled};
    let road = Arc::new(RoadSettings::three_merges().build(Lookup::Geometry).unwrap());
    let settles = |blindness, place: [f64; 2]| {
        let mut traffic = Traffic::new(Arc::clone(&road), blindness);
        for (place, role) in [([0.0, 0.0], CarRole::Ego), (place, CarRole::Merging)] {
            let vehicle = Vehicle::new(traffic.network(), place, 0.0, 20.0).with_idm(20.0);
            traffic.vehicles.push(vehicle.with_role(role));
        }
        traffic.settle();
        traffic.sees(0, 1) && traffic.sees(1, 0)
    };
    let (ramp, edge, middle) = ([250.0, 8.0], [250.0, 5.0], [250.0, 4.2]);
    assert_eq!([ramp, edge, middle].map(|at| settles(UntilSettled, at)), [false, false, true]);
    assert_eq!([ramp, edge, middle].map(|at| settles(UntilOnCarriageway, at)), [false, true, true]);
    assert_eq!([ramp, middle].map(|place| settles(Always, place)), [false, false]);
    assert!(settles(Never, ramp));
}
