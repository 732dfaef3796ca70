//! Replays the recorded scenes.

use std::sync::Arc;

use leadtime_highway::world::constants::{LENGTH, WIDTH};
use leadtime_highway::world::{
    Blindness, Driver, DriverCommand, Footprint, LaneSettings, Lookup, ObservationSettings,
    RewardSettings, Road, RoadSettings, Side, SpeedGrid, Traffic, Vehicle, contact,
};
use serde_json::Value;

use super::compare::{HighwayReport, ScenarioReport, grow};
use super::trace::{
    CollisionCase, HighwayTraces, IdmCase, LaneRow, MergeEpisode, MergeEpisodes, RecordedScene,
    VehicleStart,
};
use crate::error::ReplayError;

/// Frames per decision of the recorded merge episodes.
const FRAMES: usize = 15;
/// Where a merge episode ends, in metres.
const GOAL: f64 = 370.0;
const OBSERVATION: ObservationSettings =
    ObservationSettings { rows: 5, headings: false, see_behind: false, own_x_unit: 200.0 };

/// Replays recorded scenes.
///
/// # Errors
///
/// [`ReplayError`] if the text is no set of traces, or holds nothing to compare.
pub fn replay(text: &str) -> Result<HighwayReport, ReplayError> {
    let traces: HighwayTraces = serde_json::from_str(text)
        .map_err(|source| ReplayError::Format { what: "traces", source })?;
    let dt = traces.meta.dt;
    let mut scenarios = Vec::new();
    for (name, scene) in [
        ("a_follow", &traces.a_follow),
        ("b_platoon", &traces.b_platoon),
        ("c_mobil", &traces.c_mobil),
        ("c2_dense", &traces.c2_dense),
        ("d_sine", &traces.d_sine),
        ("d2_meta_actions", &traces.d2_meta_actions),
    ] {
        if let Some(scene) = scene {
            scenarios.push(replay_scene(name, scene, dt)?);
        }
    }
    for (name, episodes, lookup) in [
        ("e_merge", &traces.e_merge, Lookup::Segment),
        ("e2_merge_slow", &traces.e2_merge_slow, Lookup::Segment),
        ("e3_merge_lanes", &traces.e3_merge_lanes, Lookup::Segment),
        ("e4_merge_v1", &traces.e4_merge_v1, Lookup::Numbers),
    ] {
        if let Some(episodes) = episodes {
            scenarios.push(replay_episodes(name, episodes, lookup, dt)?);
        }
    }
    if !traces.unit_collisions.is_empty() {
        scenarios.push(compare_collisions(&traces.unit_collisions));
    }
    if !traces.unit_idm.is_empty() {
        scenarios.push(compare_idm(&traces.unit_idm)?);
    }
    if scenarios.iter().all(|scenario| scenario.n_states == 0) {
        return Err(ReplayError::Empty { what: "traces hold no scenario" });
    }
    Ok(HighwayReport::new(format!("highway-env {}", traces.meta.highway_env), scenarios))
}

fn road(
    scenario: &'static str,
    lanes: &[LaneRow],
    lookup: Lookup,
) -> Result<Arc<Road>, ReplayError> {
    let lanes = lanes.iter().map(LaneRow::settings).collect();
    build(scenario, &RoadSettings { lanes, ramps: Vec::new(), obstacles: Vec::new() }, lookup)
}

fn build(
    scenario: &'static str,
    settings: &RoadSettings,
    lookup: Lookup,
) -> Result<Arc<Road>, ReplayError> {
    let road = settings.build(lookup);
    road.map(Arc::new).map_err(|source| ReplayError::Road { scenario, source })
}

fn unknown(scenario: &'static str, what: &'static str, given: &str) -> ReplayError {
    ReplayError::Unknown { scenario, what, given: given.to_owned() }
}

fn start(
    scenario: &'static str,
    traffic: &Traffic,
    start: &VehicleStart,
) -> Result<Vehicle, ReplayError> {
    let network = traffic.network();
    let vehicle = Vehicle::new(network, [start.x, start.y], start.heading, start.speed);
    let target_speed = start.target_speed.unwrap_or(0.0);
    match start.class.as_str() {
        "Vehicle" => Ok(vehicle),
        "ControlledVehicle" | "MDPVehicle" => Ok(vehicle.with_controller(target_speed)),
        "IDMVehicle" => {
            let mut vehicle = vehicle.with_idm(target_speed);
            if let Driver::Idm(idm) = &mut vehicle.driver {
                idm.timer = start.timer.unwrap_or(idm.timer);
                idm.changes_lanes = start.enable_lane_change.unwrap_or(true);
            }
            Ok(vehicle)
        }
        class => Err(unknown(scenario, "vehicle", class)),
    }
}

/// The commands in the order of their numbers, and how they are called.
const COMMANDS: [(&str, DriverCommand); 5] = [
    ("LANE_LEFT", DriverCommand::Change(Side::Left)),
    ("IDLE", DriverCommand::Idle),
    ("LANE_RIGHT", DriverCommand::Change(Side::Right)),
    ("FASTER", DriverCommand::Faster),
    ("SLOWER", DriverCommand::Slower),
];

fn replay_scene(
    name: &'static str,
    scene: &RecordedScene,
    dt: f64,
) -> Result<ScenarioReport, ReplayError> {
    let road = road(name, &scene.lanes, Lookup::Segment)?;
    let mut traffic = Traffic::new(road, Blindness::Never);
    for vehicle in &scene.vehicles {
        let vehicle = start(name, &traffic, vehicle)?;
        traffic.vehicles.push(vehicle);
    }
    // Commands and places on the grid are the first car's.
    if traffic.vehicles.is_empty() {
        let what = "scene without cars";
        return Err(ReplayError::Impossible { run: name.to_owned(), what });
    }
    let grid = match scene.target_speeds[..] {
        [lowest, .., highest] => {
            SpeedGrid { lowest, highest, n_speeds: scene.target_speeds.len() as u32 }
        }
        _ => SpeedGrid::STOCK,
    };
    let mut report = ScenarioReport::new(name);
    report.n_episodes = 1;
    for (frame, states) in scene.states.iter().enumerate() {
        report.compare_states(&traffic.vehicles, states);
        if frame + 1 == scene.states.len() {
            break;
        }
        for &(from, acceleration) in &scene.leader_acceleration_from_step {
            if from == frame && traffic.vehicles.len() > 1 {
                traffic.vehicles[1].acceleration = acceleration;
            }
        }
        if let Some(action) = scene.actions.get(&frame) {
            let named = COMMANDS.iter().find(|(command, _)| command == action);
            let (_, command) = named.ok_or_else(|| unknown(name, "action", action))?;
            traffic.command(0, *command, &grid);
        }
        for &(at, place, target_speed) in &scene.speed_index {
            if at == frame {
                let wanted = traffic.vehicles[0].target_speed;
                report.expect(&grid.index(wanted), &place);
                grow(&mut report.errors.speed, wanted, Some(target_speed));
            }
        }
        traffic.step(dt);
    }
    Ok(report.evaluated())
}

fn replay_episodes(
    name: &'static str,
    episodes: &MergeEpisodes,
    lookup: Lookup,
    dt: f64,
) -> Result<ScenarioReport, ReplayError> {
    let recorded = road(name, &episodes.lanes, lookup)?;
    let road = build(name, &RoadSettings::merge(), lookup)?;
    let mut report = ScenarioReport::new(name);
    // Our own road is driven; the recorded one must be the same.
    report.expect(&road.network, &recorded.network);
    for episode in &episodes.episodes {
        let traffic = Traffic::new(Arc::clone(&road), Blindness::Never);
        replay_episode(episode, traffic, dt, &mut report)?;
    }
    Ok(report.evaluated())
}

/// Places the cars of a merge episode.
fn populate(traffic: &mut Traffic, draws: &[(usize, f64, f64); 3]) {
    let Traffic { road, vehicles, .. } = traffic;
    let car = |place, speed| Vehicle::new(&road.network, place, 0.0, speed);
    vehicles.push(car([30.0, 4.0], 30.0).with_controller(30.0));
    let means = [(90.0, 29.0), (70.0, 31.0), (5.0, 31.5)];
    vehicles.extend(means.iter().zip(draws).map(|((x, speed), &(lane, dx, dv))| {
        car([x + dx, 4.0 * lane as f64], speed + dv).with_idm(0.0)
    }));
    vehicles.push(car([110.0, 14.5], 20.0).with_idm(30.0));
}

fn replay_episode(
    episode: &MergeEpisode,
    mut traffic: Traffic,
    dt: f64,
    report: &mut ScenarioReport,
) -> Result<(), ReplayError> {
    populate(&mut traffic, &episode.draws);
    let mut states = episode.states.iter();
    let mut observation = vec![0.0; OBSERVATION.dim()];
    let rewards = RewardSettings::stock();
    if let Some(states) = states.next() {
        report.compare_states(&traffic.vehicles, states);
    }
    report.n_episodes += 1;
    for decision in &episode.policy {
        if let Some(action) = decision.action {
            let numbered = COMMANDS.get(usize::from(action));
            let error = || unknown(report.name, "action", &action.to_string());
            let &(_, command) = numbered.ok_or_else(error)?;
            traffic.command(0, command, &SpeedGrid::STOCK);
            for states in states.by_ref().take(FRAMES) {
                traffic.step(dt);
                report.compare_states(&traffic.vehicles, states);
            }
            let changes = matches!(command, DriverCommand::Change(_));
            let terms = traffic.terms(0, changes, &rewards);
            grow(&mut report.errors.reward, rewards.reward(&terms), Some(decision.reward));
            let ego = &traffic.vehicles[0];
            let ended = ego.crashed || ego.position[0] > GOAL;
            report.expect(&(ended, false), &(decision.terminated, decision.truncated));
        }
        traffic.observe(0, 2, &OBSERVATION, &mut observation);
        report.compare_observation(&observation, &decision.obs);
        report.n_decisions += 1;
    }
    report.expect(&states.count(), &0);
    Ok(())
}

fn compare_collisions(cases: &[CollisionCase]) -> ScenarioReport {
    let mut report = ScenarioReport::new("unit_collisions");
    for case in cases {
        let [a, b] = [case.a, case.b].map(|[x, y, heading, speed]| {
            let (sine, cosine) = libm::sincos(heading);
            Footprint { position: [x, y], direction: [cosine, sine], size: [LENGTH, WIDTH], speed }
        });
        let found = contact(&a, &b, case.dt);
        report.expect(&found.touches, &case.intersecting);
        report.expect(&found.translation.is_some(), &case.will_intersect);
        for (axis, moved) in found.translation.iter().flatten().enumerate() {
            let recorded = case.translation.get(axis).and_then(Value::as_f64);
            grow(&mut report.errors.position, *moved, recorded);
        }
        report.n_episodes += 1;
    }
    report.evaluated()
}

fn compare_idm(cases: &[IdmCase]) -> Result<ScenarioReport, ReplayError> {
    let mut report = ScenarioReport::new("unit_idm");
    let lane = LaneSettings::new("0", "1", [0.0, 0.0], [2000.0, 0.0]);
    let lanes = vec![LaneSettings { speed_limit: 30.0, ..lane }];
    let settings = RoadSettings { lanes, ramps: Vec::new(), obstacles: Vec::new() };
    let road = build("unit_idm", &settings, Lookup::Segment)?;
    for case in cases {
        let mut traffic = Traffic::new(Arc::clone(&road), Blindness::Never);
        let car = |x, speed| Vehicle::new(&road.network, [x, 0.0], 0.0, speed);
        traffic.vehicles.push(car(100.0, case.speed).with_idm(case.target_speed));
        let front = case.gap.zip(case.front_speed).map(|(gap, speed)| {
            traffic.vehicles.push(car(100.0 + gap, speed));
            1
        });
        // Relative to what they are: a gap of a millimetre makes millions.
        let relative = |value: f64, recorded: f64| value / recorded.abs().max(1.0);
        let found = traffic.acceleration(Some(0), front);
        let recorded = case.acceleration;
        let scaled = Some(relative(recorded, recorded));
        grow(&mut report.errors.command, relative(found, recorded), scaled);
        if let Some(front) = front {
            let found = traffic.desired_gap(0, front);
            grow(&mut report.errors.position, found, case.desired_gap);
        }
        report.n_episodes += 1;
    }
    Ok(report.evaluated())
}
