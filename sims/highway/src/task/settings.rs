//! What can be chosen about the road, the cars on it and the listener who drives.

use leadtime_sims::check::{SettingError, require, require_within};
use serde::{Deserialize, Serialize};

use crate::world::constants::{LENGTH, MAX_ACCELERATION};
use crate::world::{
    Blindness, Lookup, ObservationSettings, RewardSettings, Road, RoadSettings, SpeedGrid,
};

/// What becomes of a commanded lane change that makes somebody behind brake hard.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum UnsafeChanges {
    /// It is done: the listener trusts who speaks.
    Execute,
    /// It is refused, as MOBIL would.
    Refuse,
}

/// The listener's own car, and how it is driven.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EgoSettings {
    /// Where it starts, in metres along the first road. Default 30.
    pub x: f64,
    /// The lane on which it starts, 0 the leftmost. Default: drawn.
    pub lane: Option<u32>,
    /// Its speed at the start, in m/s (1 to 40). Default 30.
    pub speed: f64,
    /// The speed that the listener wants, in m/s (1 to 40). Default 30.
    pub desired_speed: f64,
    /// How hard the listener brakes at most because they are asked to slow down, in m/s² (0.5 to 6); for what they see
    /// they brake harder. Default 6, the most that any driver brakes.
    pub braking: f64,
    /// Whether the listener changes lanes by their own judgement. Default true.
    pub changes_lanes: bool,
    /// What becomes of a commanded lane change that is unsafe. Default `execute`.
    pub unsafe_changes: UnsafeChanges,
    /// The speeds that "slow down" and "speed up" climb. Default: 5 from 15 to 38 m/s.
    pub speed_grid: SpeedGrid,
}

impl Default for EgoSettings {
    fn default() -> Self {
        Self {
            x: 30.0,
            lane: None,
            speed: 30.0,
            desired_speed: 30.0,
            braking: MAX_ACCELERATION,
            changes_lanes: true,
            unsafe_changes: UnsafeChanges::Execute,
            speed_grid: SpeedGrid { lowest: 15.0, highest: 38.0, n_speeds: 5 },
        }
    }
}

/// On which of the lanes a car of the traffic starts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StartLane {
    /// On any of them, drawn.
    #[default]
    Any,
    /// On the lane that the ego starts on.
    Own,
    /// On another than the ego's, drawn if there are several.
    Other,
}

impl StartLane {
    /// Settings written before there was a choice say nothing of it.
    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
    fn is_any(&self) -> bool {
        *self == Self::Any
    }
}

/// A car among the traffic.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CarSettings {
    /// Where it starts on average, in metres along the first road.
    pub x: f64,
    /// Its speed at the start on average, in m/s (1 to 40); its driver wants to keep it.
    pub speed: f64,
    /// Its lane. Default `any`.
    #[serde(default, skip_serializing_if = "StartLane::is_any")]
    pub lane: StartLane,
}

/// The cars on the carriageway.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrafficSettings {
    /// The cars (at most 32). Default: at 90, 70 and 5 m with 29, 31 and 31.5 m/s.
    pub cars: Vec<CarSettings>,
    /// How far a car starts from its average place at most, in metres. Default 5.
    pub position_spread: f64,
    /// How far a car's speed is from its average at most, in m/s. Default 1.
    pub speed_spread: f64,
}

impl Default for TrafficSettings {
    fn default() -> Self {
        let car = |x, speed| CarSettings { x, speed, lane: StartLane::Any };
        Self {
            cars: vec![car(90.0, 29.0), car(70.0, 31.0), car(5.0, 31.5)],
            position_spread: 5.0,
            speed_spread: 1.0,
        }
    }
}

/// The cars that come from the ramps, one per ramp.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MergingSettings {
    /// How far before the merge the ego is when the car appears, in metres (10 to 1000). Default 200.
    pub distance: f64,
    /// Its speed then, in m/s (1 to 40). Default 20.
    pub speed: f64,
    /// The speed that its driver wants, in m/s (1 to 40). Default 30.
    pub desired_speed: f64,
    /// By how many metres it arrives before the ego, drawn between these two (rising). Default 0 and 30.
    pub lead: [f64; 2],
    /// The least and greatest distance to the merge at which it appears, in metres. Default 60 and 228.
    pub range: [f64; 2],
    /// How long it and the ego do not see each other. Default `until_settled`.
    pub blindness: Blindness,
}

impl Default for MergingSettings {
    fn default() -> Self {
        Self {
            distance: 200.0,
            speed: 20.0,
            desired_speed: 30.0,
            lead: [0.0, 30.0],
            range: [60.0, 228.0],
            blindness: Blindness::UntilSettled,
        }
    }
}

/// When the scripted notifier speaks.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HeuristicSettings {
    /// How long before the ego reaches a merge it begins to warn, in seconds (0 to 60). Default 6.5.
    pub earliest: f64,
    /// It warns if the ego would be less than this behind the merging car, in metres (0 to 200). Default 60.
    pub gap_behind: f64,
    /// Or less than this ahead of it, in metres (0 to 200). Default 30.
    pub gap_ahead: f64,
}

impl Default for HeuristicSettings {
    fn default() -> Self {
        Self { earliest: 6.5, gap_behind: 60.0, gap_ahead: 30.0 }
    }
}

/// The world of the task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HighwayWorldSettings {
    /// The road; its carriageway leads along +x. Default: two lanes with merges at 230, 540 and 850 m.
    pub road: RoadSettings,
    /// How drivers look along the road. Default `geometry`.
    pub lookup: Lookup,
    /// Frames per second (1 to 240). Default 15, the original's.
    pub frame_rate: u32,
    /// Frames per step (1 to 100). Default 5, which is 1/3 s: a spoken word.
    pub frames_per_step: u32,
    /// Steps after which an episode is cut off (1 to 100000). Default 300.
    pub max_steps: u32,
    /// Where the task is done, in metres. Default 990.
    pub goal: f64,
    /// An arrival is a success within so many times the time that the way takes at the desired speed (1 to 100; 0: whenever).
    /// Default 0.
    pub arrive_within: f64,
    /// An arrival is a success if the ego never braked harder than this, in m/s² (0.5 to 10; 0: however hard). Default 0.
    pub hardest_braking: f64,
    /// An ego that has arrived earns 1 per step until this step, so that driving slowly earns nothing; 0: arriving
    /// ends the episode, as in the original. Default 200: at the least speed that can be asked for, 15 m/s, the goal is
    /// 192 steps away, so that nobody is paid for steps that others have no more.
    pub absorb_until: u32,
    /// The listener's own car.
    pub ego: EgoSettings,
    /// The cars on the carriageway.
    pub traffic: TrafficSettings,
    /// The cars from the ramps.
    pub merging: MergingSettings,
    /// What an observation has rows of, and in which units.
    pub observation: ObservationSettings,
    /// What a step pays.
    pub reward: RewardSettings,
    /// When the scripted notifier speaks.
    pub heuristic: HeuristicSettings,
}

impl Default for HighwayWorldSettings {
    fn default() -> Self {
        Self {
            road: RoadSettings::three_merges(),
            lookup: Lookup::Geometry,
            frame_rate: 15,
            frames_per_step: 5,
            max_steps: 300,
            goal: 990.0,
            arrive_within: 0.0,
            hardest_braking: 0.0,
            absorb_until: 200,
            ego: EgoSettings::default(),
            traffic: TrafficSettings::default(),
            merging: MergingSettings::default(),
            observation: ObservationSettings::default(),
            reward: RewardSettings::default(),
            heuristic: HeuristicSettings::default(),
        }
    }
}

impl HighwayWorldSettings {
    /// Checks ranges and the road, and returns the road.
    pub(super) fn build(&self) -> Result<Road, SettingError> {
        let road = self.road.build(self.lookup)?;
        self.check_time()?;
        self.check_ego(&road)?;
        self.check_traffic(&road)?;
        self.check_merging(&road)?;
        self.observation.check()?;
        self.reward.check()?;
        let HeuristicSettings { earliest, gap_behind, gap_ahead } = self.heuristic;
        require_within("world.heuristic.earliest", earliest, 0.0..=60.0, "s")?;
        require_within("world.heuristic.gap_behind", gap_behind, 0.0..=200.0, "m")?;
        require_within("world.heuristic.gap_ahead", gap_ahead, 0.0..=200.0, "m")?;
        Ok(road)
    }

    fn check_time(&self) -> Result<(), SettingError> {
        require_within("world.frame_rate", self.frame_rate, 1..=240, "frames per second")?;
        require_within("world.frames_per_step", self.frames_per_step, 1..=100, "frames")?;
        require_within("world.max_steps", self.max_steps, 1..=100_000, "steps")?;
        let (within, braking) = (self.arrive_within, self.hardest_braking);
        let fits = within == 0.0 || (1.0..=100.0).contains(&within);
        require(
            fits,
            "world.arrive_within",
            within,
            "0, or 1 to 100 times the time without traffic",
        )?;
        let fits = braking == 0.0 || (0.5..=10.0).contains(&braking);
        require(fits, "world.hardest_braking", braking, "0, or 0.5 to 10 m/s²")?;
        let until = self.absorb_until;
        require(until <= self.max_steps, "world.absorb_until", until, "at most `world.max_steps`")
    }

    /// Returns the last step in which an arrival is in time, if there is one.
    pub(super) fn last_step_in_time(&self) -> Option<u32> {
        let way = (self.goal - self.ego.x) / self.ego.desired_speed;
        let steps = f64::from(self.frame_rate) / f64::from(self.frames_per_step);
        // Rounding must not take the step that ends exactly in time.
        let last = self.arrive_within * way * steps + 1e-9;
        (self.arrive_within > 0.0).then_some(last as u32)
    }

    fn check_ego(&self, road: &Road) -> Result<(), SettingError> {
        let EgoSettings { x, lane, speed, desired_speed, braking, speed_grid, .. } = self.ego;
        let n_lanes = start_lanes(road).count() as u32;
        let given = lane.unwrap_or(0);
        let allowed = format!("0 to {}", n_lanes.saturating_sub(1));
        require(given < n_lanes, "world.ego.lane", given, allowed)?;
        check_speed("world.ego.speed", speed)?;
        check_speed("world.ego.desired_speed", desired_speed)?;
        require_within("world.ego.braking", braking, 0.5..=MAX_ACCELERATION, "m/s²")?;
        check_place("world.ego.x", x, 0.0, road)?;
        let SpeedGrid { lowest, highest, n_speeds } = speed_grid;
        let fits =
            (0.0..highest).contains(&lowest) && highest <= 40.0 && (2..=64).contains(&n_speeds);
        let given = format_args!("{n_speeds} from {lowest} to {highest}");
        require(fits, "world.ego.speed_grid", given, "2 to 64 speeds, rising, 0 to 40 m/s")?;
        let allowed = format!("beyond the ego's start at {x} m");
        require(self.goal > x, "world.goal", self.goal, allowed)?;
        start_lanes(road).try_for_each(|lane| self.check_way(road, lane))
    }

    /// Follows the road from a lane on which cars start; it must lead to the goal.
    fn check_way(&self, road: &Road, start: usize) -> Result<(), SettingError> {
        let network = &road.network;
        let mut lane = start;
        // No way is longer than there are lanes, unless it goes round in a circle.
        for _ in network.lanes() {
            let end = network.lane(lane).end();
            if end[0] >= self.goal {
                return Ok(());
            }
            let next = network.next(lane, end);
            if next == lane {
                break;
            }
            lane = next;
        }
        let given =
            format!("{} as the end of the way from {}", network.name(lane), network.name(start));
        let allowed = format!("lanes that lead on to the goal at {} m", self.goal);
        Err(SettingError { key: "world.road.lanes", given, allowed: allowed.into() })
    }

    fn check_traffic(&self, road: &Road) -> Result<(), SettingError> {
        let TrafficSettings { cars, position_spread: spread, speed_spread } = &self.traffic;
        let given = format_args!("{} cars", cars.len());
        require(cars.len() <= 32, "world.traffic.cars", given, "at most 32 cars")?;
        require_within("world.traffic.position_spread", *spread, 0.0..=100.0, "m")?;
        require_within("world.traffic.speed_spread", *speed_spread, 0.0..=10.0, "m/s")?;
        for (i, car) in cars.iter().enumerate() {
            check_speed("world.traffic.cars", car.speed)?;
            check_place("world.traffic.cars", car.x, *spread, road)?;
            let earlier = cars[..i].iter().map(|other| (other.x, 2.0 * spread));
            for (x, reach) in earlier.chain([(self.ego.x, *spread)]) {
                let given = format_args!("cars at {} m and {x} m", car.x);
                let least = LENGTH + reach;
                let apart = (car.x - x).abs() >= least;
                let allowed = format!("cars {least} m apart or more, so that none overlap");
                require(apart, "world.traffic.cars", given, allowed)?;
            }
        }
        Ok(())
    }

    fn check_merging(&self, road: &Road) -> Result<(), SettingError> {
        let MergingSettings { distance, speed, desired_speed, lead, range, .. } = self.merging;
        require_within("world.merging.distance", distance, 10.0..=1000.0, "m")?;
        check_speed("world.merging.speed", speed)?;
        check_speed("world.merging.desired_speed", desired_speed)?;
        let given = format_args!("{lead:?}");
        let fits = lead[0] <= lead[1] && lead.iter().all(|lead| lead.abs() <= 1000.0);
        require(fits, "world.merging.lead", given, "two rising distances of -1000 to 1000 m")?;
        for ramp in &road.ramps {
            let before = &ramp.lanes[..ramp.lanes.len() - 1];
            let length: f64 = before.iter().map(|&lane| road.network.lane(lane).length).sum();
            let fits = 0.0 <= range[0] && range[0] <= range[1] && range[1] <= length;
            let given = format_args!("{range:?}");
            let allowed =
                format!("two rising distances of 0 to {length} m, the length of the ramp");
            require(fits, "world.merging.range", given, allowed)?;
        }
        let merges: Vec<f64> = road.ramps.iter().map(|ramp| ramp.merge_x).collect();
        let (in_order, given) = (merges.is_sorted_by(|a, b| a < b), format_args!("{merges:?}"));
        require(in_order, "world.road.ramps", given, "ramps in the order of their merges")
    }
}

/// Lists the lanes of the first road on which cars may start.
pub(super) fn start_lanes(road: &Road) -> impl Iterator<Item = usize> + '_ {
    let network = &road.network;
    let on_first = move |lane: &usize| network.same_road(0, *lane);
    (0..network.lanes().len()).filter(on_first).filter(|&lane| !network.lane(lane).forbidden)
}

fn check_speed(key: &'static str, speed: f64) -> Result<(), SettingError> {
    require((1.0..=40.0).contains(&speed), key, format_args!("{speed} m/s"), "1 to 40 m/s")
}

fn check_place(key: &'static str, x: f64, spread: f64, road: &Road) -> Result<(), SettingError> {
    let length = road.network.lane(0).length;
    let fits = x - spread >= 0.0 && x + spread <= length;
    let allowed = format!("{spread} to {} m, on the first road", length - spread);
    require(fits, key, format_args!("{x} m"), allowed)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(change: impl FnOnce(&mut HighwayWorldSettings)) -> String {
        let mut settings = HighwayWorldSettings::default();
        change(&mut settings);
        settings.build().unwrap_err().to_string()
    }

    #[test]
    fn impossible_settings_are_named() {
        assert_eq!(
            refused(|s| s.traffic.cars[1].x = 36.0),
            "`world.traffic.cars` is cars at 36 m and 30 m; allowed: cars 10 m apart or more, so that none overlap"
        );
        assert!(refused(|s| s.traffic.cars[1].x = 80.0).contains("cars at 80 m and 90 m"));
        assert!(refused(|s| s.traffic.cars[0].x = 300.0).contains("300 m; allowed: 5 to 225 m"));
        assert_eq!(refused(|s| s.ego.lane = Some(2)), "`world.ego.lane` is 2; allowed: 0 to 1");
        assert!(refused(|s| s.ego.speed = f64::NAN).contains("world.ego.speed"));
        assert!(refused(|s| s.ego.speed_grid.n_speeds = 1).contains("1 from 15 to 38"));
        assert_eq!(
            refused(|s| s.goal = 1200.0),
            "`world.road.lanes` is m6→m7 0 as the end of the way from m0→m1 0; \
             allowed: lanes that lead on to the goal at 1200 m"
        );
        assert!(refused(|s| s.goal = 20.0).contains("beyond the ego's start at 30 m"));
        // A misspelt node cuts the road in two.
        assert!(refused(|s| s.road.lanes[0].to = "M1".to_owned()).contains("m0→M1 0 as the end"));
        assert!(refused(|s| s.absorb_until = 301).contains("world.absorb_until"));
        assert!(refused(|s| s.arrive_within = 0.9).contains("world.arrive_within"));
        assert!(refused(|s| s.arrive_within = f64::NAN).contains("world.arrive_within"));
        assert!(refused(|s| s.hardest_braking = -1.0).contains("world.hardest_braking"));
        assert!(refused(|s| s.ego.braking = 0.0).contains("world.ego.braking"));
        assert!(refused(|s| s.frames_per_step = 0).contains("world.frames_per_step"));
        assert!(refused(|s| s.merging.range = [60.0, 231.0]).contains("0 to 230 m"));
        assert!(refused(|s| s.merging.lead = [30.0, 0.0]).contains("world.merging.lead"));
        assert!(refused(|s| s.observation.rows = 0).contains("world.observation.rows"));
        assert!(
            refused(|s| s.observation.own_x_unit = 0.0).contains("world.observation.own_x_unit")
        );
        assert!(refused(|s| s.reward.late = 1.0).contains("world.reward.late"));
        assert!(
            refused(|s| s.reward.hard_braking = f64::NAN).contains("world.reward.hard_braking")
        );
        assert!(refused(|s| s.reward.collision = 1.0).contains("world.reward.collision"));
        assert!(refused(|s| s.heuristic.earliest = -1.0).contains("world.heuristic.earliest"));
        assert!(refused(|s| s.road.ramps.reverse()).contains("[850.0, 540.0, 230.0]"));
        assert!(refused(|s| s.road.lanes[0].end[0] = 100.0).contains("m0→m1 0, which ends"));
    }
}
