//! What a decision on the road pays: fast and on the right, without a crash and without hindering those who merge.
//!
//! R = (Σ weight · term - low) / (high - low), with low = collision + merging and high = right lane + speed: an
//! ordinary drive pays between 0 and 1. What comes on top, for a drive that is late or rough, is the task's.
//!
//! # Source
//!
//! highway-env 1.12.1, `envs/merge_env.py`; the speed range of 15 to 38 m/s is that of Hsu et al. (arXiv:2509.07438).

use leadtime_sims::RewardTerm;
use leadtime_sims::check::{SettingError, require, require_within};
use serde::{Deserialize, Serialize};

use super::traffic::Traffic;
use super::vehicle::{Driver, Vehicle};

/// More than any car from a ramp is slower or faster than it wants to be, as a share of that; a few such cars pay less than a step may
/// add to the sums of an episode.
const LARGEST_SHARE: f64 = 1e2;

/// Weights of the reward.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RewardSettings {
    /// Of a crash of the ego (-100 to 0). Default -1.
    pub collision: f64,
    /// Of driving on the right lane (0 to 100). Default 0.1.
    pub right_lane: f64,
    /// Of the speed, which counts 0 to 1 over `speed_range` (0 to 100; above 0 in sum with `right_lane`). Default 0.2.
    pub high_speed: f64,
    /// Of each car on a merging lane, by how far it is below its target speed (-100 to 0). Default -0.5.
    pub merging: f64,
    /// Of a commanded lane change (-100 to 0). Default -0.05.
    pub lane_change: f64,
    /// The speeds that count 0 and 1, in m/s (rising, -40 to 80). Default 15 and 38.
    pub speed_range: [f64; 2],
    /// How near to the ego a car on a merging lane must be to count, in metres (at least 0). Default 200.
    pub merging_range: f64,
    /// What each step of driving costs after the time to arrive is over, in reward as it is (-1000 to 0). Default 0.
    pub late: f64,
    /// What braking too hard costs, in reward as it is, once, when it first happens (-1000 to 0). Default 0.
    pub hard_braking: f64,
}

impl Default for RewardSettings {
    fn default() -> Self {
        Self {
            collision: -1.0,
            right_lane: 0.1,
            high_speed: 0.2,
            merging: -0.5,
            lane_change: -0.05,
            speed_range: [15.0, 38.0],
            merging_range: 200.0,
            late: 0.0,
            hard_braking: 0.0,
        }
    }
}

/// The terms of a reward, before they are weighted.
#[derive(Clone, Copy, Debug, Default)]
pub struct RewardTerms {
    /// 1 after a crash of the ego.
    pub collision: f64,
    /// Lanes to the left of the ego's.
    pub right_lane: f64,
    /// Speed, 0 to 1 over its range, and beyond.
    pub high_speed: f64,
    /// Sum over cars on merging lanes of (target - speed) / target.
    pub merging: f64,
    /// 1 if a lane change was commanded.
    pub lane_change: f64,
}

impl RewardSettings {
    /// The original's: speeds of 20 to 30 m/s, and all merging cars.
    pub fn stock() -> Self {
        Self { speed_range: [20.0, 30.0], merging_range: f64::MAX, ..Self::default() }
    }

    pub(crate) fn check(&self) -> Result<(), SettingError> {
        require_within("world.reward.collision", self.collision, -100.0..=0.0, "")?;
        require_within("world.reward.merging", self.merging, -100.0..=0.0, "")?;
        require_within("world.reward.lane_change", self.lane_change, -100.0..=0.0, "")?;
        require_within("world.reward.right_lane", self.right_lane, 0.0..=100.0, "")?;
        require_within("world.reward.high_speed", self.high_speed, 0.0..=100.0, "")?;
        require_within("world.reward.late", self.late, -1000.0..=0.0, "")?;
        require_within("world.reward.hard_braking", self.hard_braking, -1000.0..=0.0, "")?;
        let (fits, speed) = (self.right_lane + self.high_speed > 0.0, self.high_speed);
        let allowed = "above 0, or a `right_lane` above 0";
        require(fits, "world.reward.high_speed", speed, allowed)?;
        let [low, high] = self.speed_range;
        let fits = -40.0 <= low && low < high && high <= 80.0;
        let given = format_args!("[{low}, {high}]");
        require(fits, "world.reward.speed_range", given, "two rising speeds of -40 to 80 m/s")?;
        let range = self.merging_range;
        require(range >= 0.0, "world.reward.merging_range", range, "at least 0 m")
    }

    /// Weighs the terms: `[collision, right lane, speed, merging, lane change]`, in units of reward.
    pub(crate) fn pieces(&self, terms: &RewardTerms) -> [f64; 5] {
        let span = self.span();
        [
            self.collision * terms.collision,
            self.right_lane * terms.right_lane,
            self.high_speed * terms.high_speed,
            self.merging * terms.merging,
            self.lane_change * terms.lane_change,
        ]
        .map(|piece| piece / span)
    }

    /// Lists what a step pays.
    pub(crate) fn terms(&self) -> Vec<RewardTerm> {
        let one = RewardTerms {
            collision: 1.0,
            right_lane: 1.0,
            high_speed: 1.0,
            merging: 1.0,
            lane_change: 1.0,
        };
        let [collision, right_lane, high_speed, merging, lane_change] = self.pieces(&one);
        let [low, high] = self.speed_range;
        let speed = format!("(speed - {low}) / ({high} - {low}), speed in m/s");
        let slowed = "(target - speed) / target of a merging car";
        let key = |name: &str| format!("world.reward.{name}");
        vec![
            RewardTerm::new("every step", self.reward(&RewardTerms::default()), ""),
            RewardTerm::new("a crash", collision, key("collision")),
            RewardTerm::new("the lanes to the left of the own car", right_lane, key("right_lane")),
            RewardTerm::new(speed, high_speed, key("high_speed")),
            RewardTerm::new(slowed, merging, key("merging")),
            RewardTerm::new("a commanded lane change", lane_change, key("lane_change")),
        ]
    }

    /// Computes the reward of a step: its weighted terms, mapped linearly so that 0 is a crash with one merging car at
    /// a standstill, and 1 the highest speed with one lane to the left. A commanded lane change costs extra.
    pub fn reward(&self, terms: &RewardTerms) -> f64 {
        let low = self.collision + self.merging;
        self.pieces(terms).iter().sum::<f64>() - low / self.span()
    }

    fn span(&self) -> f64 {
        self.right_lane + self.high_speed - self.collision - self.merging
    }
}

impl Traffic {
    /// Computes the terms of a car's reward.
    pub fn terms(&self, me: usize, lane_change: bool, settings: &RewardSettings) -> RewardTerms {
        let own = &self.vehicles[me];
        let [low, high] = settings.speed_range;
        let merging = self.vehicles.iter().filter(|vehicle| {
            let there = self.road.ramps.iter().any(|ramp| ramp.parallel() == vehicle.lane);
            let [dx, dy] = [0, 1].map(|axis| vehicle.position[axis] - own.position[axis]);
            let distance = libm::sqrt(dx * dx + dy * dy);
            there && vehicle.driver != Driver::Nobody && distance <= settings.merging_range
        });
        // Cars from ramps want 1 m/s or more; what somebody made up may want none.
        let slowed = |car: &Vehicle| {
            let share = (car.target_speed - car.speed) / car.target_speed;
            if share.abs() <= LARGEST_SHARE { share } else { 0.0 }
        };
        RewardTerms {
            collision: f64::from(u8::from(own.crashed)),
            right_lane: f64::from(self.network().rank(own.lane)),
            high_speed: (own.speed - low) / (high - low),
            merging: merging.map(slowed).sum(),
            lane_change: f64::from(u8::from(lane_change)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rewards_are_those_of_the_worked_table() {
        let settings = RewardSettings::default();
        let reward = |speed: f64, lane, change: fn(&mut RewardTerms)| {
            let high_speed = (speed - 15.0) / 23.0;
            let mut terms = RewardTerms { high_speed, right_lane: lane, ..RewardTerms::default() };
            change(&mut terms);
            settings.reward(&terms)
        };
        // (0.1 lane + 0.2 (v - 15) / 23 - ... + 1.5) / 1.8, worked by hand.
        for (found, expected) in [
            (reward(30.0, 1.0, |_| {}), 0.961_352_657),
            (reward(30.0, 0.0, |_| {}), 0.905_797_101),
            (reward(38.0, 1.0, |_| {}), 1.0),
            (reward(0.0, 1.0, |_| {}), 0.816_425_121),
            (reward(30.0, 1.0, |terms| terms.collision = 1.0), 0.405_797_101),
            (reward(30.0, 1.0, |terms| terms.lane_change = 1.0), 0.933_574_879),
            (reward(30.0, 1.0, |terms| terms.merging = 1.0 / 3.0), 0.868_760_064),
        ] {
            assert!((found - expected).abs() < 1e-9, "{found} {expected}");
        }
    }

    #[test]
    fn impossible_weights_are_named() {
        let refused = |change: fn(&mut RewardSettings)| {
            let mut settings = RewardSettings::default();
            change(&mut settings);
            settings.check().unwrap_err().to_string()
        };
        let text = refused(|s| s.collision = 1.0);
        assert_eq!(text, "`world.reward.collision` is 1; allowed: -100 to 0");
        assert!(refused(|s| s.merging = f64::NAN).contains("world.reward.merging"));
        assert!(refused(|s| s.speed_range = [20.0, 20.0]).contains("[20, 20]"));
        assert!(refused(|s| (s.right_lane, s.high_speed) = (0.0, 0.0)).contains("above 0"));
        assert!(refused(|s| s.merging_range = -1.0).contains("merging_range"));
        RewardSettings::stock().check().unwrap();
    }
}
