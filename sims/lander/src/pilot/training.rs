//! The pilot's own training task: the unmodified lander, with the weather and the starts that a pilot must master.
//!
//! Observation, actions and reward are those of `LunarLander-v3`. What is drawn per episode, from the environment's
//! own stream, is whether the wind blows and whether the start is wide: a pilot that has only seen the original's
//! starts cannot recover from the places to which a notification leads it.

use leadtime_numerics::Purpose;
use leadtime_proto::{ActionSpec, EnvSpec};
use leadtime_sims::check::{SettingError, require_within};
use leadtime_sims::description::{Description, NamedHead, ObservationLayout, RewardTerm};
use leadtime_sims::environment::{
    End, Environment, EpisodeSeed, SnapshotError, StepOutcome, read_snapshot, write_snapshot,
};
use leadtime_sims::scene::{Gauge, Scene};
use serde::{Deserialize, Serialize};

use super::evaluate::Flyer;
use super::network::{Pilot, engines_off};
use crate::world::{
    Engine, Lander, LanderOutcome, LanderSnapshot, Physics, PhysicsSettings, SNAPSHOT_MARGIN,
    START_IMPULSES, VIEW, caption, quantities,
};

/// Settings of the pilot's training task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PilotTaskSettings {
    /// Which physics moves the lander.
    pub physics: Physics,
    /// Share of episodes with wind and turbulence, 0 to 1.
    pub wind_share: f64,
    /// Largest wind force, in newtons, 0 to 20.
    pub wind_power: f64,
    /// Largest turbulence torque, in newton metres, 0 to 2.
    pub turbulence_power: f64,
    /// Largest start force, in newtons, 0 to 3000; the original's is 1000.
    pub start_impulse: f64,
    /// Share of episodes with a wide start, 0 to 1.
    pub wide_start_share: f64,
    /// Largest start force of a wide start, in newtons, 0 to 3000.
    pub wide_start_impulse: f64,
    /// Whether engines rest, whatever the policy says, once the lander stands still on both legs.
    pub engines_off: bool,
    /// Frames after which an episode is cut off, 1 to 100000; the original's is 1000.
    pub max_frames: u32,
}

impl Default for PilotTaskSettings {
    fn default() -> Self {
        let world = PhysicsSettings::default();
        Self {
            physics: world.physics,
            wind_share: 0.5,
            wind_power: world.wind_power,
            turbulence_power: world.turbulence_power,
            start_impulse: world.start_impulse,
            wide_start_share: 0.5,
            wide_start_impulse: 2200.0,
            engines_off: false,
            max_frames: super::evaluate::MAX_FRAMES,
        }
    }
}

/// The pilot's training task.
#[derive(Debug)]
pub struct PilotTask {
    settings: PilotTaskSettings,
    spec: EnvSpec,
    lander: Lander,
    frames: u32,
    outcome: Option<LanderOutcome>,
}

#[derive(Serialize, Deserialize)]
struct PilotTaskSnapshot {
    frames: u32,
    outcome: Option<LanderOutcome>,
    lander: LanderSnapshot,
}

impl PilotTask {
    /// Makes the task.
    ///
    /// # Errors
    ///
    /// [`SettingError`] if a setting is outside its range.
    pub fn new(settings: &PilotTaskSettings) -> Result<Self, SettingError> {
        require_within("world.wind_share", settings.wind_share, 0.0..=1.0, "")?;
        require_within("world.wide_start_share", settings.wide_start_share, 0.0..=1.0, "")?;
        let world = PhysicsSettings {
            physics: settings.physics,
            wind_power: settings.wind_power,
            turbulence_power: settings.turbulence_power,
            start_impulse: settings.start_impulse,
            wind: false,
        };
        world.check()?;
        let impulse = settings.wide_start_impulse;
        require_within("world.wide_start_impulse", impulse, START_IMPULSES, "N")?;
        require_within("world.max_frames", settings.max_frames, 1..=100_000, "frames")?;
        let actions = ActionSpec::discrete("engine", Engine::ALL.len());
        let metrics = ["success", "crashed", "out", "timed_out"].map(str::to_owned).to_vec();
        Ok(Self {
            settings: settings.clone(),
            spec: EnvSpec { obs_dim: 8, actions, metrics },
            lander: Lander::new(&world),
            frames: 0,
            outcome: None,
        })
    }

    fn timed_out(&self) -> bool {
        self.outcome.is_none() && self.frames >= self.settings.max_frames
    }
}

impl Environment for PilotTask {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn describe(&self) -> Description {
        let choices = ["idle", "left", "main", "right"].map(str::to_owned).to_vec();
        let potential = "a frame, times the change of the original's shaping potential";
        let rewards = [
            (potential, 1.0),
            ("coming to rest, and nothing else", 100.0),
            ("a crash or leaving the view, and nothing else", -100.0),
            ("a frame of the main engine", -Engine::Main.fuel()),
            ("a frame of a side engine", -Engine::Left.fuel()),
        ];
        Description {
            observation: ObservationLayout::single(quantities()),
            actions: vec![NamedHead { name: "engine".to_owned(), choices }],
            rewards: rewards.map(|(when, amount)| RewardTerm::new(when, amount, "")).to_vec(),
        }
    }

    fn reset(&mut self, seed: EpisodeSeed, observation: &mut [f32]) {
        let mut variant = seed.stream(Purpose::Task);
        let windy = variant.unit() < self.settings.wind_share;
        let wide = variant.unit() < self.settings.wide_start_share;
        let settings = &self.settings;
        let impulse = if wide { settings.wide_start_impulse } else { settings.start_impulse };
        self.lander.set_start(windy, impulse);
        observation.copy_from_slice(&self.lander.reset(seed.stream(Purpose::World)));
        (self.frames, self.outcome) = (0, None);
    }

    fn step(&mut self, action: &[u8], observation: &mut [f32]) -> StepOutcome {
        let chosen = Engine::try_from(action[0]).expect("actions are those of the specification");
        let rests = self.settings.engines_off && engines_off(self.lander.observation());
        let frame = self.lander.step(if rests { Engine::Idle } else { chosen });
        self.frames += 1;
        self.outcome = frame.outcome;
        observation.copy_from_slice(&frame.observation);
        let end = match frame.outcome {
            Some(_) => Some(End::Terminated),
            None => self.timed_out().then_some(End::Truncated),
        };
        StepOutcome { reward: frame.reward as f32, end }
    }

    fn metrics(&self, out: &mut [f32]) {
        let ended = |outcome| self.outcome == Some(outcome);
        let (landed, crashed) = (ended(LanderOutcome::Landed), ended(LanderOutcome::Crashed));
        let ways = [landed, crashed, ended(LanderOutcome::Out), self.timed_out()];
        out.copy_from_slice(&ways.map(|way| f32::from(u8::from(way))));
    }

    fn snapshot_margin(&self) -> usize {
        SNAPSHOT_MARGIN
    }

    fn write_state(&self, out: &mut Vec<u8>) {
        let (frames, outcome) = (self.frames, self.outcome);
        write_snapshot(&PilotTaskSnapshot { frames, outcome, lander: self.lander.snapshot() }, out);
    }

    fn read_state(&mut self, state: &[u8], observation: &mut [f32]) -> Result<(), SnapshotError> {
        let snapshot: PilotTaskSnapshot = read_snapshot(state)?;
        if snapshot.frames > self.settings.max_frames {
            return Err(SnapshotError::Mismatch { what: "frames" });
        }
        self.lander.restore(&snapshot.lander)?;
        (self.frames, self.outcome) = (snapshot.frames, snapshot.outcome);
        observation.copy_from_slice(self.lander.observation());
        Ok(())
    }

    fn baselines(&self) -> &'static [&'static str] {
        &["heuristic", "embedded"]
    }

    fn baseline_action(&self, name: &str, action: &mut [u8]) -> bool {
        let flyer = match name {
            "heuristic" => Flyer::Heuristic,
            "embedded" => Flyer::Network { pilot: Pilot::embedded(), rests: false },
            _ => return false,
        };
        action[0] = flyer.engine(self.lander.observation()) as u8;
        true
    }

    fn scene(&self) -> Option<Scene> {
        let [x, y, ..] = *self.lander.observation();
        Some(Scene {
            view: VIEW,
            shapes: self.lander.shapes(),
            position: [f64::from(x), f64::from(y)],
            gauge: Gauge { label: "height", value: f64::from(y) },
            outcome: caption(self.outcome).to_owned(),
            ..Scene::default()
        })
    }
}
