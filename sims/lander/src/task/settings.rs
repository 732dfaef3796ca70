//! What can be chosen about the lander, its zones and what is paid.

use leadtime_sims::check::{SettingError, require, require_within};
use serde::{Deserialize, Serialize};

use super::zone::{DEFAULT_ZONES, FARTHEST_PLACE, Zone};
use crate::world::{Physics, PhysicsSettings};

/// How a topic is followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ReactionKind {
    /// By a small tilt-and-hover controller with a target speed per topic.
    Maneuver,
    /// By holding one engine: nearest to the source's letter, and of little effect.
    Raw,
}

/// Which pilot flies the lander when no reaction runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PilotKind {
    /// The trained pilot that is part of the program.
    Embedded,
    /// The scripted pilot of the original environment.
    Heuristic,
}

/// How being near a zone is punished; d is the distance, summed over what is nearer than `near_distance`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NearPenalty {
    /// By how deep one is in the zone's surroundings: `near_distance` - d, over zones.
    Depth,
    /// The same, over the four sides of each zone.
    Sides,
    /// By d itself, over zones: the source's letter, which rewards going nearer.
    Literal,
    /// Going near a zone costs nothing.
    Off,
}

/// How often entering a zone is punished.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EntryPenalty {
    /// In every frame inside a zone, as fuel is charged.
    PerFrame,
    /// In every step with a frame inside a zone.
    PerStep,
    /// In the first such step of an episode.
    Once,
}

/// How often being near a zone is punished.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NearCharge {
    /// In every frame, as fuel is charged.
    PerFrame,
    /// Where the step ends.
    PerStep,
}

/// The world of the task. Positions are in observed units: the pad at (0, 0), the view's edges at x = ±1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[expect(clippy::struct_excessive_bools, reason = "each is a switch of its own in a configuration")]
pub struct LanderWorldSettings {
    /// Which physics moves the lander. Default `two_gears`.
    pub physics: Physics,
    /// Whether wind and turbulence act. Default false.
    pub wind: bool,
    /// Largest wind force, in newtons (0 to 20). Default 15.
    pub wind_power: f64,
    /// Largest turbulence torque, in newton metres (0 to 2). Default 1.5.
    pub turbulence_power: f64,
    /// Largest start force, in newtons (0 to 3000). Default 1000; larger throws the lander further off.
    pub start_impulse: f64,
    /// Who flies. Default `embedded`.
    pub pilot: PilotKind,
    /// Whether the pilot lets the engines rest once the lander stands still on both legs. Default true.
    pub engines_off: bool,
    /// How a topic is followed. Default `maneuver`.
    pub reaction: ReactionKind,
    /// Frames of 1/50 s per step (1 to 100). Default 5, which is 0.1 s; 15 is a spoken word's 0.3 s.
    pub frames_per_step: u32,
    /// Steps after which an episode is lost (1 to 100000). Default 200.
    pub max_steps: u32,
    /// Whether the share of `max_steps` that is left is observed, so that running out of time can be foreseen. Default
    /// false.
    pub observe_time: bool,
    /// The danger zones, with sides of -100 to 100. Default: three, see [`DEFAULT_ZONES`].
    pub zones: Vec<Zone>,
    /// How far each zone is moved at most per episode, `[x, y]` (0 to 1); if it is not `[0, 0]`, zones are observed.
    pub zone_jitter: [f64; 2],
    /// Whether entering a zone ends the episode. Default true: training needs it; evaluation turns it off.
    pub zone_ends_episode: bool,
    /// What an episode that ends in a zone costs (at least 0). Default 300, as a crash: less, and dying early is what training settles on.
    pub zone_end_penalty: f64,
    /// What entering a zone costs otherwise (at least 0). Default 20.
    pub entry_penalty: f64,
    /// How often it costs that. Default `per_step`.
    pub entry_charged: EntryPenalty,
    /// How being near a zone is punished. Default `depth`.
    pub near_penalty: NearPenalty,
    /// How often it is. Default `per_step`.
    pub near_charged: NearCharge,
    /// What near means (0 to 2). Default 0.2.
    pub near_distance: f64,
    /// Cost per unit of distance, and per step or frame (at least 0). Default 10.
    pub near_weight: f64,
    /// Cost of a frame of the main engine (at least 0). Default 0.3.
    pub main_fuel: f64,
    /// Cost of a frame of a side engine (at least 0). Default 0.03.
    pub side_fuel: f64,
    /// Reward of a landing that counts (at least 0). Default 300.
    pub landing_reward: f64,
    /// Cost of a crash, and of leaving the view (at least 0). Default 300.
    pub crash_penalty: f64,
    /// Cost of running out of time (at least 0). Default 300.
    pub timeout_penalty: f64,
    /// Whether only a landing on the pad counts (|x| <= 0.2). Default true.
    pub on_pad: bool,
    /// Distance to a zone below which the scripted notifier speaks (0 to 2). Default 0.25.
    pub heuristic_distance: f64,
    /// The path that the scripted notifier knows, from high to low; places of -100 to 100.
    pub safe_path: Vec<[f64; 2]>,
}

impl Default for LanderWorldSettings {
    fn default() -> Self {
        let lander = PhysicsSettings::default();
        Self {
            physics: lander.physics,
            wind: false,
            wind_power: lander.wind_power,
            turbulence_power: lander.turbulence_power,
            start_impulse: lander.start_impulse,
            pilot: PilotKind::Embedded,
            engines_off: true,
            reaction: ReactionKind::Maneuver,
            frames_per_step: 5,
            max_steps: 200,
            observe_time: false,
            zones: DEFAULT_ZONES.to_vec(),
            zone_jitter: [0.0, 0.0],
            zone_ends_episode: true,
            zone_end_penalty: 300.0,
            entry_penalty: 20.0,
            entry_charged: EntryPenalty::PerStep,
            near_penalty: NearPenalty::Depth,
            near_charged: NearCharge::PerStep,
            near_distance: 0.2,
            near_weight: 10.0,
            main_fuel: 0.3,
            side_fuel: 0.03,
            landing_reward: 300.0,
            crash_penalty: 300.0,
            timeout_penalty: 300.0,
            on_pad: true,
            heuristic_distance: 0.25,
            safe_path: vec![[-0.1, 0.9], [-0.5, 0.8], [-0.5, 0.4], [0.0, 0.0]],
        }
    }
}

impl LanderWorldSettings {
    /// Checks ranges; the error names the first impossible setting.
    pub(super) fn check(&self) -> Result<(), SettingError> {
        self.lander().check()?;
        require_within("world.frames_per_step", self.frames_per_step, 1..=100, "frames")?;
        require_within("world.max_steps", self.max_steps, 1..=100_000, "steps")?;
        self.check_zones()?;
        for (key, amount) in [
            ("world.zone_end_penalty", self.zone_end_penalty),
            ("world.entry_penalty", self.entry_penalty),
            ("world.near_weight", self.near_weight),
            ("world.main_fuel", self.main_fuel),
            ("world.side_fuel", self.side_fuel),
            ("world.landing_reward", self.landing_reward),
            ("world.crash_penalty", self.crash_penalty),
            ("world.timeout_penalty", self.timeout_penalty),
        ] {
            require_within(key, amount, 0.0..=1e6, "")?;
        }
        require_within("world.near_distance", self.near_distance, 0.0..=2.0, "")?;
        require_within("world.heuristic_distance", self.heuristic_distance, 0.0..=2.0, "")?;
        let mut places = self.safe_path.iter().flatten();
        let within = places.all(|place| place.abs() <= FARTHEST_PLACE);
        let path = format_args!("{:?}", self.safe_path);
        let allowed = format!("points [x, y] of -{FARTHEST_PLACE} to {FARTHEST_PLACE}");
        require(within, "world.safe_path", path, allowed)
    }

    fn check_zones(&self) -> Result<(), SettingError> {
        let n_zones = self.zones.len();
        require(n_zones <= 64, "world.zones", format_args!("{n_zones} zones"), "at most 64 zones")?;
        for zone in &self.zones {
            let Zone { x0, x1, y0, y1 } = zone;
            let given = format_args!("{{ x0 = {x0}, x1 = {x1}, y0 = {y0}, y1 = {y1} }}");
            let allowed = format!("x0 < x1 and y0 < y1, of -{FARTHEST_PLACE} to {FARTHEST_PLACE}");
            require(zone.is_proper(), "world.zones", given, allowed)?;
        }
        let fits = self.zone_jitter.iter().all(|jitter| (0.0..=1.0).contains(jitter));
        let given = format_args!("{:?}", self.zone_jitter);
        require(fits, "world.zone_jitter", given, "[x, y] of 0 to 1")
    }

    pub(super) fn has_jitter(&self) -> bool {
        self.zone_jitter != [0.0, 0.0]
    }

    pub(super) fn lander(&self) -> PhysicsSettings {
        PhysicsSettings {
            physics: self.physics,
            wind: self.wind,
            wind_power: self.wind_power,
            turbulence_power: self.turbulence_power,
            start_impulse: self.start_impulse,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn impossible_settings_are_named() {
        let refused = |change: fn(&mut LanderWorldSettings)| {
            let mut settings = LanderWorldSettings::default();
            change(&mut settings);
            settings.check().unwrap_err().to_string()
        };
        assert_eq!(
            refused(|s| s.zones[1].x0 = 0.3),
            "`world.zones` is { x0 = 0.3, x1 = 0.3, y0 = 0.5, y1 = 0.65 }; \
             allowed: x0 < x1 and y0 < y1, of -100 to 100"
        );
        assert!(refused(|s| s.zones[0].x0 = -1e12).contains("of -100 to 100"));
        assert!(refused(|s| s.safe_path[3] = [0.0, -1e12]).contains("world.safe_path"));
        let allowed = "`world.frames_per_step` is 0; allowed: 1 to 100 frames";
        assert_eq!(refused(|s| s.frames_per_step = 0), allowed);
        assert!(refused(|s| s.max_steps = 0).contains("world.max_steps"));
        assert!(refused(|s| s.landing_reward = f64::NAN).contains("world.landing_reward"));
        assert_eq!(
            refused(|s| s.near_distance = -1.0),
            "`world.near_distance` is -1; allowed: 0 to 2"
        );
        assert!(refused(|s| s.zone_jitter = [2.0, 0.0]).contains("world.zone_jitter"));
        assert!(refused(|s| s.wind_power = f64::NAN).contains("world.wind_power"));
        let start = "`world.start_impulse` is -1; allowed: 0 to 3000 N";
        assert_eq!(refused(|s| s.start_impulse = -1.0), start);
        LanderWorldSettings::default().check().unwrap();
    }
}
