//! What can be chosen about the kitchen, the cook and what is paid.

use leadtime_sims::check::{SettingError, require, require_within};
use serde::{Deserialize, Serialize};

use crate::world::{FieldOfView, Grid, StartFamily, WorkTimes, kitchen};

/// How the cook chooses between subtasks, or places, that are equally good.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TieRule {
    /// One of them by chance.
    Random,
    /// The first in the order of the lists.
    First,
}

/// The world of the task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SteakhouseWorldSettings {
    /// The kitchen: `ring`, `wings`, `annex`, `steak_mid_2`, `steak_side_2`, `steak_none_3`, or its own rows. Default `ring`.
    pub layout: String,
    /// Steps that a steak cooks (1 to 200). Default 10.
    pub cook_time: u8,
    /// Chops that a garnish takes (1 to 200). Default 2.
    pub chop_time: u8,
    /// Washes that a plate takes (1 to 200). Default 2.
    pub wash_time: u8,
    /// What stations hold at the start; of several, one is drawn per episode. Default `["random"]`.
    pub start_families: Vec<StartFamily>,
    /// Whether the cook starts anywhere, instead of on the start tile. Default true.
    pub random_pose: bool,
    /// From when to when, in steps, stations in somebody else's use become free, `[low, high]`, one draw per episode.
    /// Default `[0, 0]`: never.
    pub release_steps: [u32; 2],
    /// Whether the cook knows from the start what the stations hold. Default false.
    pub aware: bool,
    /// Steps in a row that a station must be in view to be known (1 to 100). Default 1.
    pub see_delay: u8,
    /// What the cook sees. Default `block`: two rows of three tiles ahead.
    pub field_of_view: FieldOfView,
    /// How the cook chooses between equals. Default `random`.
    pub ties: TieRule,
    /// Words from which on a direction also tells what the stations hold (1 to 1000). Default 5.
    pub direction_discloses_from: u32,
    /// Words from which on `inform` tells what the stations hold (1 to 1000). Default 4.
    pub inform_discloses_from: u32,
    /// Steps after which an episode is lost (1 to 10000). Default 100.
    pub max_steps: u32,
    /// Steps that a delivery may take beyond those of a cook who knows everything (0 to 10000). Default 8.
    pub deadline_slack: u32,
    /// Reward of a delivery in time (at least 0). Default 20.
    pub delivery_reward: f64,
    /// Reward of a later delivery (at least 0). Default 5.
    pub late_reward: f64,
    /// Reward of an interaction that the dish needs (at least 0). Default 0.5.
    pub progress_reward: f64,
    /// Cost of a step (at least 0). Default 0.05.
    pub step_cost: f64,
    /// Cost of a step of work in vain (at least 0). Default 0.1.
    pub redundant_cost: f64,
}

impl Default for SteakhouseWorldSettings {
    fn default() -> Self {
        let WorkTimes { cook, chop, wash } = WorkTimes::default();
        Self {
            layout: "ring".to_owned(),
            cook_time: cook,
            chop_time: chop,
            wash_time: wash,
            start_families: vec![StartFamily::Random],
            random_pose: true,
            release_steps: [0, 0],
            aware: false,
            see_delay: 1,
            field_of_view: FieldOfView::Block,
            ties: TieRule::Random,
            direction_discloses_from: 5,
            inform_discloses_from: 4,
            max_steps: 100,
            deadline_slack: 8,
            delivery_reward: 20.0,
            late_reward: 5.0,
            progress_reward: 0.5,
            step_cost: 0.05,
            redundant_cost: 0.1,
        }
    }
}

impl SteakhouseWorldSettings {
    /// Checks ranges, and returns the kitchen.
    pub(super) fn check(&self) -> Result<Grid, SettingError> {
        let grid = kitchen(&self.layout)?;
        require_within("world.cook_time", self.cook_time, 1..=200, "")?;
        require_within("world.chop_time", self.chop_time, 1..=200, "")?;
        require_within("world.wash_time", self.wash_time, 1..=200, "")?;
        self.check_starts(&grid)?;
        let [low, high] = self.release_steps;
        let given = format_args!("[{low}, {high}]");
        let fits = low <= high && high <= 10_000 && (low > 0 || high == 0);
        require(fits, "world.release_steps", given, "1 <= low <= high <= 10000, or [0, 0]")?;
        require_within("world.see_delay", self.see_delay, 1..=100, "steps")?;
        if let FieldOfView::Cone(degrees) = self.field_of_view {
            let fits = (1..=179).contains(&degrees);
            require(fits, "world.field_of_view", degrees, "a cone of 1 to 179 degrees")?;
        }
        require_within("world.max_steps", self.max_steps, 1..=10_000, "steps")?;
        require_within("world.deadline_slack", self.deadline_slack, 0..=10_000, "steps")?;
        for (key, words) in [
            ("world.direction_discloses_from", self.direction_discloses_from),
            ("world.inform_discloses_from", self.inform_discloses_from),
        ] {
            require_within(key, words, 1..=1000, "words")?;
        }
        for (key, amount) in [
            ("world.delivery_reward", self.delivery_reward),
            ("world.late_reward", self.late_reward),
            ("world.progress_reward", self.progress_reward),
            ("world.step_cost", self.step_cost),
            ("world.redundant_cost", self.redundant_cost),
        ] {
            require_within(key, amount, 0.0..=1e6, "")?;
        }
        Ok(grid)
    }

    fn check_starts(&self, grid: &Grid) -> Result<(), SettingError> {
        const KEY: &str = "world.start_families";
        let families = &self.start_families;
        let given = format_args!("{families:?}");
        require((1..=64).contains(&families.len()), KEY, given, "1 to 64 families")?;
        let possible = families.iter().all(|family| family.is_possible(grid));
        let given = "`unavailable` in a kitchen with one station of each kind";
        require(possible, KEY, given, "a layout with two stations of some kind")
    }

    /// Returns how long work takes.
    pub fn times(&self) -> WorkTimes {
        WorkTimes { cook: self.cook_time, chop: self.chop_time, wash: self.wash_time }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn impossible_settings_are_named() {
        let refused = |change: fn(&mut SteakhouseWorldSettings)| {
            let mut settings = SteakhouseWorldSettings::default();
            change(&mut settings);
            settings.check().unwrap_err().to_string()
        };
        let key = |change| refused(change).split('`').nth(1).unwrap().to_owned();
        assert_eq!(key(|s| s.cook_time = 0), "world.cook_time");
        assert_eq!(key(|s| s.chop_time = 201), "world.chop_time");
        assert_eq!(key(|s| s.wash_time = 0), "world.wash_time");
        assert_eq!(key(|s| s.start_families.clear()), "world.start_families");
        assert_eq!(key(|s| s.release_steps = [0, 5]), "world.release_steps");
        assert_eq!(key(|s| s.release_steps = [5, 4]), "world.release_steps");
        assert_eq!(key(|s| s.see_delay = 0), "world.see_delay");
        assert_eq!(key(|s| s.field_of_view = FieldOfView::Cone(180)), "world.field_of_view");
        assert_eq!(key(|s| s.max_steps = 0), "world.max_steps");
        assert_eq!(key(|s| s.deadline_slack = 10_001), "world.deadline_slack");
        assert_eq!(key(|s| s.inform_discloses_from = 0), "world.inform_discloses_from");
        assert_eq!(key(|s| s.late_reward = f64::NAN), "world.late_reward");
        assert_eq!(
            refused(|s| {
                s.layout = "steak_mid_2".to_owned();
                s.start_families = vec![StartFamily::Unavailable];
            }),
            "`world.start_families` is `unavailable` in a kitchen with one station of each kind; \
             allowed: a layout with two stations of some kind"
        );
        let text =
            r#"{"start_families": ["all_ready", "unavailable"], "field_of_view": {"cone": 120}}"#;
        let settings: SteakhouseWorldSettings = serde_json::from_str(text).unwrap();
        assert_eq!(settings.field_of_view, FieldOfView::Cone(120));
        settings.check().unwrap();
    }
}
