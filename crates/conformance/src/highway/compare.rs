//! What a replay found, and how a state is compared with a recorded one.

use leadtime_highway::world::{Driver, Vehicle};
use serde::Serialize;

use super::trace::VehicleRow;
use crate::section::{Section, mark};

/// What any recorded state may differ by: the traces are rounded to nine decimals.
const STATE_BOUND: f64 = 1e-8;
/// What any observed number may differ by: observations have single precision.
const OBSERVATION_BOUND: f64 = 1e-6;

/// The largest differences of a scenario.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Errors {
    /// Of a coordinate, in metres.
    pub position: f64,
    /// Of a heading, in radians.
    pub heading: f64,
    /// Of a speed, in m/s.
    pub speed: f64,
    /// Of a commanded acceleration (m/s²) or steering angle (radians).
    pub command: f64,
    /// Of a lane-change timer, in seconds.
    pub timer: f64,
    /// Of an observed number.
    pub observation: f64,
    /// Of a reward.
    pub reward: f64,
}

/// What was found of one scenario.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ScenarioReport {
    /// Its key in the traces.
    pub name: &'static str,
    /// Number of episodes or cases.
    pub n_episodes: usize,
    /// Number of compared states of a car.
    pub n_states: usize,
    /// Number of compared decisions.
    pub n_decisions: usize,
    /// The largest differences of any of them.
    pub errors: Errors,
    /// Lanes, target lanes, crash flags, ends and speed places that differ.
    pub n_mismatches: usize,
    /// Whether every difference is within its bound and nothing discrete differs.
    pub passed: bool,
}

/// What a replay found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HighwayReport {
    /// What recorded the traces.
    pub source: String,
    /// What a state may differ by.
    pub state_bound: f64,
    /// What an observed number may differ by.
    pub observation_bound: f64,
    /// Scenarios, in the order of their keys.
    pub scenarios: Vec<ScenarioReport>,
    /// Whether every scenario passed.
    pub passed: bool,
}

impl HighwayReport {
    pub(super) fn new(source: String, scenarios: Vec<ScenarioReport>) -> Self {
        let passed = scenarios.iter().all(|scenario| scenario.passed);
        let (state_bound, observation_bound) = (STATE_BOUND, OBSERVATION_BOUND);
        Self { source, state_bound, observation_bound, scenarios, passed }
    }

    pub(crate) fn sections(&self) -> Vec<Section> {
        let row = |scenario: &ScenarioReport| {
            let ScenarioReport { name, n_states, n_decisions, n_mismatches, passed, .. } = scenario;
            let Errors { position, heading, speed, command, observation, reward, .. } =
                scenario.errors;
            let errors = [position, heading, speed, command, observation, reward];
            let mut row = vec![(*name).to_owned(), n_states.to_string(), n_decisions.to_string()];
            row.extend(errors.map(|error| format!("{error:.1e}")));
            row.extend([n_mismatches.to_string(), mark(*passed)]);
            row
        };
        let (state, observation) = (self.state_bound, self.observation_bound);
        vec![Section {
            title: format!("bounds: states {state:.0e}, observations {observation:.0e}"),
            head: vec![
                "scenario",
                "states",
                "steps",
                "position",
                "heading",
                "speed",
                "command",
                "observed",
                "reward",
                "mismatches",
                "",
            ],
            rows: self.scenarios.iter().map(row).collect(),
            notes: Vec::new(),
        }]
    }
}

impl ScenarioReport {
    pub(super) fn new(name: &'static str) -> Self {
        Self { name, ..Self::default() }
    }

    /// Sets `passed` by what was found.
    pub(super) fn evaluated(mut self) -> Self {
        let Errors { position, heading, speed, command, timer, observation, reward } = self.errors;
        let states = [position, heading, speed, command, timer, reward];
        let within = states.iter().all(|&error| error <= STATE_BOUND);
        self.passed = within && observation <= OBSERVATION_BOUND && self.n_mismatches == 0;
        self
    }

    /// Counts something discrete that should be equal.
    pub(super) fn expect<T: PartialEq>(&mut self, found: &T, recorded: &T) {
        self.n_mismatches += usize::from(found != recorded);
    }

    pub(super) fn compare_states(&mut self, vehicles: &[Vehicle], states: &[VehicleRow]) {
        self.expect(&vehicles.len(), &states.len());
        for (vehicle, state) in vehicles.iter().zip(states) {
            self.compare_state(vehicle, state);
        }
    }

    fn compare_state(&mut self, vehicle: &Vehicle, state: &VehicleRow) {
        self.n_states += 1;
        let errors = &mut self.errors;
        grow(&mut errors.position, vehicle.position[0], Some(state.x));
        grow(&mut errors.position, vehicle.position[1], Some(state.y));
        grow(&mut errors.heading, vehicle.heading, Some(state.heading));
        grow(&mut errors.speed, vehicle.speed, Some(state.speed));
        grow(&mut errors.command, vehicle.acceleration, state.acceleration);
        grow(&mut errors.command, vehicle.steering, state.steering);
        if let Driver::Idm(idm) = vehicle.driver {
            grow(&mut errors.timer, idm.timer, state.timer);
        }
        self.expect(&(vehicle.lane as i64), &state.lane);
        if vehicle.driver != Driver::Nobody {
            self.expect(&(vehicle.target_lane as i64), &state.target_lane);
        }
        self.expect(&u8::from(vehicle.crashed), &state.crashed);
    }

    pub(super) fn compare_observation(&mut self, found: &[f32], recorded: &[Vec<f64>]) {
        let recorded = recorded.iter().flatten();
        self.expect(&found.len(), &recorded.clone().count());
        for (&found, &recorded) in found.iter().zip(recorded) {
            grow(&mut self.errors.observation, f64::from(found), Some(recorded));
        }
    }
}

/// Enlarges an error; nothing recorded is no error, and a NaN is the largest of all.
pub(super) fn grow(error: &mut f64, found: f64, recorded: Option<f64>) {
    let Some(recorded) = recorded else { return };
    let difference = (found - recorded).abs();
    if difference.is_nan() || difference > *error {
        *error = if difference.is_nan() { f64::INFINITY } else { difference };
    }
}
