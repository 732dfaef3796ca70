//! Replays the recorded scenes.

use std::sync::Arc;

use leadtime_highway::world::constants::{LENGTH, WIDTH};
use leadtime_highway::world::{
    Blindness, Driver, DriverCommand, Footprint, Lookup, ObservationSettings, RewardSettings, Road,
    RoadSettings, Side, SpeedGrid, Traffic, Vehicle, contact,
};
use leadtime_sims::check::SettingError;
use serde_json::Value;
use thiserror::Error;

use super::compare::{HighwayReport, ScenarioReport, grow};
use super::trace::{
    CollisionCase, HighwayTraces, IdmCase, LaneRow, MergeEpisode, MergeEpisodes, RecordedScene,
    VehicleStart,
};
use super::{OBSERVATION_BOUND, STATE_BOUND};

/// Frames per decision of the recorded merge episodes.
const FRAMES: usize = 15;
/// Where a merge episode ends, in metres.
const GOAL: f64 = 370.0;
const OBSERVATION: ObservationSettings =
    ObservationSettings { rows: 5, headings: false, see_behind: false };

/// Why a text cannot be replayed.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the sentence of each variant names its fields")]
pub enum HighwayReplayError {
    /// It is not a set of recorded scenes.
    #[error("traces cannot be read")]
    Format(#[from] serde_json::Error),
    /// A recorded road is malformed.
    #[error("the road of scenario `{scenario}` is impossible")]
    Road {
        scenario: &'static str,
        #[source]
        source: SettingError,
    },
    /// A recorded action or class of vehicle that does not exist.
    #[error("scenario `{scenario}` has the unknown {what} `{given}`")]
    Unknown { scenario: &'static str, what: &'static str, given: String },
    /// There is nothing to compare.
    #[error("the traces hold no scenario to compare")]
    Empty,
}

/// Replays recorded scenes.
///
/// # Errors
///
/// [`HighwayReplayError`] if the text is no set of traces, or holds nothing to compare.
pub fn replay(text: &str) -> Result<HighwayReport, HighwayReplayError> {
    let traces: HighwayTraces = serde_json::from_str(text)?;
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
        return Err(HighwayReplayError::Empty);
    }
    Ok(HighwayReport {
        source: format!("highway-env {}", traces.meta.highway_env),
        state_bound: STATE_BOUND,
        observation_bound: OBSERVATION_BOUND,
        passed: scenarios.iter().all(|scenario| scenario.passed),
        scenarios,
    })
}

fn road(
    scenario: &'static str,
    lanes: &[LaneRow],
    lookup: Lookup,
) -> Result<Arc<Road>, HighwayReplayError> {
    let lanes = lanes.iter().map(LaneRow::settings).collect();
    let settings = RoadSettings { lanes, ramps: Vec::new(), obstacles: Vec::new() };
    let road =
        settings.build(lookup).map_err(|source| HighwayReplayError::Road { scenario, source })?;
    Ok(Arc::new(road))
}

fn start(
    scenario: &'static str,
    traffic: &Traffic,
    start: &VehicleStart,
) -> Result<Vehicle, HighwayReplayError> {
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
        class => {
            Err(HighwayReplayError::Unknown { scenario, what: "vehicle", given: class.to_owned() })
        }
    }
}

fn named_command(scenario: &'static str, name: &str) -> Result<DriverCommand, HighwayReplayError> {
    match name {
        "LANE_LEFT" => Ok(DriverCommand::Change(Side::Left)),
        "LANE_RIGHT" => Ok(DriverCommand::Change(Side::Right)),
        "IDLE" => Ok(DriverCommand::Idle),
        "FASTER" => Ok(DriverCommand::Faster),
        "SLOWER" => Ok(DriverCommand::Slower),
        _ => Err(HighwayReplayError::Unknown { scenario, what: "action", given: name.to_owned() }),
    }
}

fn numbered_command(
    scenario: &'static str,
    action: u8,
) -> Result<DriverCommand, HighwayReplayError> {
    let names = ["LANE_LEFT", "IDLE", "LANE_RIGHT", "FASTER", "SLOWER"];
    let given = || action.to_string();
    let name = names.get(usize::from(action));
    let name = name.ok_or_else(|| HighwayReplayError::Unknown {
        scenario,
        what: "action",
        given: given(),
    })?;
    named_command(scenario, name)
}

fn replay_scene(
    name: &'static str,
    scene: &RecordedScene,
    dt: f64,
) -> Result<ScenarioReport, HighwayReplayError> {
    let road = road(name, &scene.lanes, Lookup::Segment)?;
    let mut traffic = Traffic::new(road, Blindness::Never);
    for vehicle in &scene.vehicles {
        let vehicle = start(name, &traffic, vehicle)?;
        traffic.push(vehicle);
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
        report.compare_states(traffic.vehicles(), states);
        if frame + 1 == scene.states.len() {
            break;
        }
        for &(from, acceleration) in &scene.leader_acceleration_from_step {
            if from == frame && traffic.vehicles().len() > 1 {
                traffic.vehicle_mut(1).acceleration = acceleration;
            }
        }
        if let Some(action) = scene.actions.get(&frame) {
            traffic.command(0, named_command(name, action)?, &grid);
        }
        for &(at, place, target_speed) in &scene.speed_index {
            if at == frame {
                let wanted = traffic.vehicles()[0].target_speed;
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
) -> Result<ScenarioReport, HighwayReplayError> {
    let recorded = road(name, &episodes.lanes, lookup)?;
    let error = |source| HighwayReplayError::Road { scenario: name, source };
    let road = Arc::new(RoadSettings::merge().build(lookup).map_err(error)?);
    let mut report = ScenarioReport::new(name);
    // Our own road is driven; the recorded one must be the same.
    report.expect(&road.network, &recorded.network);
    for episode in &episodes.episodes {
        replay_episode(
            episode,
            Traffic::new(Arc::clone(&road), Blindness::Never),
            dt,
            &mut report,
        )?;
    }
    Ok(report.evaluated())
}

/// Places the cars of a merge episode.
fn populate(traffic: &mut Traffic, draws: &[(usize, f64, f64); 3]) {
    let car = |traffic: &Traffic, place, speed| Vehicle::new(traffic.network(), place, 0.0, speed);
    let ego = car(traffic, [30.0, 4.0], 30.0).with_controller(30.0);
    traffic.push(ego);
    for ((x, speed), (lane, dx, dv)) in [(90.0, 29.0), (70.0, 31.0), (5.0, 31.5)].iter().zip(draws)
    {
        let place = [x + dx, 4.0 * *lane as f64];
        let vehicle = car(traffic, place, speed + dv).with_idm(0.0);
        traffic.push(vehicle);
    }
    let merging = car(traffic, [110.0, 14.5], 20.0).with_idm(30.0);
    traffic.push(merging);
}

fn replay_episode(
    episode: &MergeEpisode,
    mut traffic: Traffic,
    dt: f64,
    report: &mut ScenarioReport,
) -> Result<(), HighwayReplayError> {
    populate(&mut traffic, &episode.draws);
    let mut states = episode.states.iter();
    let mut observation = vec![0.0; OBSERVATION.dim()];
    let rewards = RewardSettings::stock();
    if let Some(states) = states.next() {
        report.compare_states(traffic.vehicles(), states);
    }
    report.n_episodes += 1;
    for decision in &episode.policy {
        if let Some(action) = decision.action {
            let command = numbered_command(report.name, action)?;
            traffic.command(0, command, &SpeedGrid::STOCK);
            for states in states.by_ref().take(FRAMES) {
                traffic.step(dt);
                report.compare_states(traffic.vehicles(), states);
            }
            let changes = matches!(command, DriverCommand::Change(_));
            let terms = traffic.terms(0, changes, &rewards);
            grow(&mut report.errors.reward, rewards.reward(&terms), Some(decision.reward));
            let ego = &traffic.vehicles()[0];
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

fn compare_idm(cases: &[IdmCase]) -> Result<ScenarioReport, HighwayReplayError> {
    let mut report = ScenarioReport::new("unit_idm");
    let lane = leadtime_highway::world::LaneSettings {
        from: "0".to_owned(),
        to: "1".to_owned(),
        start: [0.0, 0.0],
        end: [2000.0, 0.0],
        width: 4.0,
        speed_limit: 30.0,
        forbidden: false,
        wave: None,
    };
    let settings = RoadSettings { lanes: vec![lane], ramps: Vec::new(), obstacles: Vec::new() };
    let error = |source| HighwayReplayError::Road { scenario: "unit_idm", source };
    let road = Arc::new(settings.build(Lookup::Segment).map_err(error)?);
    for case in cases {
        let mut traffic = Traffic::new(Arc::clone(&road), Blindness::Never);
        let car = |x, speed| Vehicle::new(&road.network, [x, 0.0], 0.0, speed);
        traffic.push(car(100.0, case.speed).with_idm(case.target_speed));
        let front = case.gap.zip(case.front_speed).map(|(gap, speed)| {
            traffic.push(car(100.0 + gap, speed));
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
