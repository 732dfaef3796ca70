//! `CartPole-v1` of Gymnasium: the same dynamics in the same order of operations, the same limits, the same start.
//!
//! # Source
//!
//! Barto, Sutton, Anderson, *Neuronlike Adaptive Elements That Can Solve Difficult Learning Control Problems*,
//! 1983; Gymnasium 1.x, `gymnasium/envs/classic_control/cartpole.py` (explicit Euler).

use leadtime_numerics::{Pcg64, Purpose};
use leadtime_proto::{ActionSpec, EnvSpec};
use serde::{Deserialize, Serialize};

use crate::check::{SettingError, require_within};
use crate::description::{Description, NamedHead, ObservationLayout, Quantity, RewardTerm};
use crate::environment::{
    End, Environment, EpisodeSeed, SnapshotError, StepOutcome, read_snapshot, write_snapshot,
};
use crate::scene::{Gauge, Scene, Shape, Tone, View};

const GRAVITY: f64 = 9.8;
const CART_MASS: f64 = 1.0;
const POLE_MASS: f64 = 0.1;
const TOTAL_MASS: f64 = CART_MASS + POLE_MASS;
/// Half the pole's length, in metres.
const HALF_LENGTH: f64 = 0.5;
const POLE_MASS_LENGTH: f64 = POLE_MASS * HALF_LENGTH;
const FORCE: f64 = 10.0;
/// Duration of a step, in seconds.
const TAU: f64 = 0.02;
const ANGLE_LIMIT_RAD: f64 = 12.0 * 2.0 * std::f64::consts::PI / 360.0;
const POSITION_LIMIT: f64 = 2.4;
/// What no motion comes to within the limits: on the track a cart reaches some 10 m/s.
const FASTEST: f64 = 1e3;

/// Settings of [`CartPole`]: its time limit.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CartPoleSettings {
    /// Steps until the time limit (1..=100000). Default 500, as in `CartPole-v1`.
    pub max_steps: u32,
}

impl Default for CartPoleSettings {
    fn default() -> Self {
        Self { max_steps: 500 }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct CartPoleState {
    /// Cart position (m), its velocity (m/s), pole angle (rad), its velocity (rad/s).
    motion: [f64; 4],
    n_steps: u32,
}

/// A pole on a cart that is pushed left or right.
///
/// # Shapes
///
/// Observation `[4]`: cart position and velocity, pole angle and angular velocity. Action: one head, 0 pushes left
/// and 1 right. Reward 1 per step; the metric `success` is 1 when the time limit was reached.
#[derive(Clone, Debug)]
pub struct CartPole {
    spec: EnvSpec,
    max_steps: u32,
    state: CartPoleState,
}

impl CartPole {
    /// Creates the task.
    ///
    /// # Errors
    ///
    /// [`SettingError`] if a setting is out of range.
    pub fn new(settings: &CartPoleSettings) -> Result<Self, SettingError> {
        require_within("world.max_steps", settings.max_steps, 1..=100_000, "steps")?;
        let spec = EnvSpec {
            obs_dim: 4,
            actions: ActionSpec::discrete("push", 2),
            metrics: vec!["success".to_owned()],
        };
        Ok(Self { spec, max_steps: settings.max_steps, state: CartPoleState::default() })
    }

    /// Starts an episode from a given generator; `Pcg64::seed_from_u64(seed)` is Gymnasium's `reset(seed=seed)`.
    fn reset_with(&mut self, mut generator: Pcg64, observation: &mut [f32]) {
        let motion = std::array::from_fn(|_| generator.uniform(-0.05, 0.05));
        self.state = CartPoleState { motion, n_steps: 0 };
        self.observe(observation);
    }

    fn observe(&self, observation: &mut [f32]) {
        for (out, value) in observation.iter_mut().zip(self.state.motion) {
            *out = value as f32;
        }
    }

    fn has_fallen(&self) -> bool {
        let [x, _, theta, _] = self.state.motion;
        x.abs() > POSITION_LIMIT || theta.abs() > ANGLE_LIMIT_RAD
    }
}

/// Advances the motion by one Euler step under a horizontal force.
fn advance([x, x_dot, theta, theta_dot]: [f64; 4], force: f64) -> [f64; 4] {
    let (cos, sin) = (libm::cos(theta), libm::sin(theta));
    let temp = (force + POLE_MASS_LENGTH * (theta_dot * theta_dot) * sin) / TOTAL_MASS;
    let theta_acc = (GRAVITY * sin - cos * temp)
        / (HALF_LENGTH * (4.0 / 3.0 - POLE_MASS * (cos * cos) / TOTAL_MASS));
    let x_acc = temp - POLE_MASS_LENGTH * theta_acc * cos / TOTAL_MASS;
    [x + TAU * x_dot, x_dot + TAU * x_acc, theta + TAU * theta_dot, theta_dot + TAU * theta_acc]
}

impl Environment for CartPole {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn describe(&self) -> Description {
        let unbounded = [f32::NEG_INFINITY, f32::INFINITY];
        // The observation that ends an episode may lie beyond the limits; the original states twice of them.
        let (position, angle) = (2.0 * POSITION_LIMIT as f32, 2.0 * ANGLE_LIMIT_RAD as f32);
        let observation = ObservationLayout::single(vec![
            Quantity::new("x", "the cart's position, in m", [-position, position]),
            Quantity::new("vx", "the cart's velocity, in m/s", unbounded),
            Quantity::new("angle", "the pole's angle from upright, in rad", [-angle, angle]),
            Quantity::new("spin", "the pole's angular velocity, in rad/s", unbounded),
        ]);
        let choices = ["left", "right"].map(str::to_owned).to_vec();
        let actions = vec![NamedHead { name: "push".to_owned(), choices }];
        let rewards = vec![RewardTerm::new("a step", 1.0, "")];
        Description { observation, actions, rewards }
    }

    fn reset(&mut self, seed: EpisodeSeed, observation: &mut [f32]) {
        self.reset_with(seed.stream(Purpose::World), observation);
    }

    fn step(&mut self, action: &[u8], observation: &mut [f32]) -> StepOutcome {
        let force = if action[0] == 1 { FORCE } else { -FORCE };
        self.state.motion = advance(self.state.motion, force);
        self.state.n_steps += 1;
        self.observe(observation);
        let end = if self.has_fallen() {
            Some(End::Terminated)
        } else {
            (self.state.n_steps >= self.max_steps).then_some(End::Truncated)
        };
        StepOutcome { reward: 1.0, end }
    }

    fn metrics(&self, out: &mut [f32]) {
        out[0] = f32::from(u8::from(self.state.n_steps >= self.max_steps && !self.has_fallen()));
    }

    fn write_state(&self, out: &mut Vec<u8>) {
        write_snapshot(&self.state, out);
    }

    fn read_state(&mut self, state: &[u8], observation: &mut [f32]) -> Result<(), SnapshotError> {
        let state: CartPoleState = read_snapshot(state)?;
        let within = state.motion.iter().all(|value| value.abs() <= FASTEST);
        if !within || state.n_steps > self.max_steps {
            return Err(SnapshotError::Mismatch { what: "motion or time limit" });
        }
        self.state = state;
        self.observe(observation);
        Ok(())
    }

    fn scene(&self) -> Option<Scene> {
        let [x, _, theta, _] = self.state.motion;
        let top = [x + 2.0 * HALF_LENGTH * libm::sin(theta), 2.0 * HALF_LENGTH * libm::cos(theta)];
        let rail = vec![[-POSITION_LIMIT, 0.0], [POSITION_LIMIT, 0.0]];
        Some(Scene {
            view: View { min: [-POSITION_LIMIT, -0.5], max: [POSITION_LIMIT, 1.5] },
            shapes: vec![
                Shape::Line { points: rail, tone: Tone::Ground },
                Shape::Rectangle { min: [x - 0.25, -0.15], max: [x + 0.25, 0.0], tone: Tone::Own },
                Shape::Line { points: vec![[x, 0.0], top], tone: Tone::Other },
            ],
            position: [x, 0.0],
            gauge: Gauge { label: "pole's angle (rad)", value: theta },
            outcome: if self.has_fallen() { "fallen".to_owned() } else { String::new() },
            ..Scene::default()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    include!("../../tests/golden/cartpole.rs");

    #[test]
    fn episodes_equal_gymnasiums() {
        for case in GOLDEN {
            let mut task = CartPole::new(&CartPoleSettings::default()).unwrap();
            let mut observation = [0.0; 4];
            task.reset_with(Pcg64::seed_from_u64(case.seed), &mut observation);
            assert_eq!(observation, case.first, "seed {}", case.seed);
            // The original's own action cycle: left, right, right.
            let action = |t: usize| u8::from(!t.is_multiple_of(3));
            let mut ends = |t: &usize| task.step(&[action(*t)], &mut observation).end.is_some();
            let last = (0..500).find(&mut ends);
            assert_eq!(last, Some(case.n_steps - 1), "seed {}", case.seed);
            // Sine and cosine of another library may differ in the last bit; nothing here amplifies that much.
            for (ours, theirs) in observation.iter().zip(case.last) {
                assert!((ours - theirs).abs() < 1e-5, "{observation:?} {:?}", case.last);
            }
        }
    }

    #[test]
    fn a_motion_that_no_rollout_may_show_is_not_restored() {
        let mut task = CartPole::new(&CartPoleSettings::default()).unwrap();
        let mut observation = [0.0; 4];
        task.reset_with(Pcg64::seed_from_u64(3), &mut observation);
        for (i, value) in [1e300, -1e12, f64::NAN].into_iter().enumerate() {
            let mut state = task.state;
            state.motion[i] = value;
            let mut bytes = Vec::new();
            write_snapshot(&state, &mut bytes);
            assert!(task.read_state(&bytes, &mut observation).is_err(), "{value}");
        }
        let mut bytes = Vec::new();
        task.write_state(&mut bytes);
        task.read_state(&bytes, &mut observation).unwrap();
    }

    #[test]
    fn balancing_to_the_limit_is_a_truncated_success() {
        let mut task = CartPole::new(&CartPoleSettings { max_steps: 60 }).unwrap();
        let mut observation = [0.0; 4];
        task.reset_with(Pcg64::seed_from_u64(3), &mut observation);
        let last = (0..=60).find_map(|_| {
            let [_, _, theta, theta_dot] = task.state.motion;
            let action = u8::from(theta + 0.5 * theta_dot > 0.0);
            task.step(&[action], &mut observation).end
        });
        let mut success = [0.0];
        task.metrics(&mut success);
        assert_eq!((last, success), (Some(End::Truncated), [1.0]));
    }
}
