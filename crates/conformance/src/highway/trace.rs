//! The format of the traces.

use leadtime_highway::world::{LaneSettings, Wave};
use serde::Deserialize;
use serde_json::Value;

/// Everything that is replayed; scenarios that a file lacks are skipped.
#[derive(Debug, Deserialize)]
pub(super) struct HighwayTraces {
    pub(super) meta: Meta,
    pub(super) a_follow: Option<RecordedScene>,
    pub(super) b_platoon: Option<RecordedScene>,
    pub(super) c_mobil: Option<RecordedScene>,
    pub(super) c2_dense: Option<RecordedScene>,
    pub(super) d_sine: Option<RecordedScene>,
    pub(super) d2_meta_actions: Option<RecordedScene>,
    pub(super) e_merge: Option<MergeEpisodes>,
    pub(super) e2_merge_slow: Option<MergeEpisodes>,
    pub(super) e3_merge_lanes: Option<MergeEpisodes>,
    pub(super) e4_merge_v1: Option<MergeEpisodes>,
    #[serde(default)]
    pub(super) unit_collisions: Vec<CollisionCase>,
    #[serde(default)]
    pub(super) unit_idm: Vec<IdmCase>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Meta {
    pub(super) highway_env: String,
    pub(super) dt: f64,
}

/// Cars that drive on from a start.
#[derive(Debug, Deserialize)]
pub(super) struct RecordedScene {
    pub(super) lanes: Vec<LaneRow>,
    pub(super) vehicles: Vec<VehicleStart>,
    pub(super) states: Vec<Vec<VehicleRow>>,
    /// (frame, acceleration) of car 1.
    #[serde(default)]
    pub(super) leader_acceleration_from_step: Vec<(usize, f64)>,
    #[serde(default)]
    pub(super) actions: std::collections::BTreeMap<usize, String>,
    #[serde(default)]
    pub(super) target_speeds: Vec<f64>,
    /// (frame, place on the grid, target speed) of car 0.
    #[serde(default)]
    pub(super) speed_index: Vec<(usize, u32, f64)>,
}

#[derive(Debug, Deserialize)]
pub(super) struct MergeEpisodes {
    pub(super) lanes: Vec<LaneRow>,
    pub(super) episodes: Vec<MergeEpisode>,
}

#[derive(Debug, Deserialize)]
pub(super) struct MergeEpisode {
    /// (lane, U(-5, 5), U(-1, 1)) of three cars.
    pub(super) draws: [(usize, f64, f64); 3],
    pub(super) policy: Vec<RecordedDecision>,
    pub(super) states: Vec<Vec<VehicleRow>>,
}

#[derive(Debug, Deserialize)]
pub(super) struct RecordedDecision {
    pub(super) action: Option<u8>,
    pub(super) obs: Vec<Vec<f64>>,
    #[serde(default)]
    pub(super) reward: f64,
    #[serde(default)]
    pub(super) terminated: bool,
    #[serde(default)]
    pub(super) truncated: bool,
}

#[derive(Debug, Deserialize)]
pub(super) struct LaneRow {
    from: String,
    to: String,
    start: [f64; 2],
    end: [f64; 2],
    width: f64,
    speed_limit: f64,
    forbidden: bool,
    amplitude: Option<f64>,
    pulsation: Option<f64>,
    phase: Option<f64>,
}

impl LaneRow {
    /// Returns the lane; a wave's rounded numbers are taken for the fractions of π that they stand for.
    pub(super) fn settings(&self) -> LaneSettings {
        use std::f64::consts::{FRAC_PI_2, PI};
        let exact = |x: f64, meant: f64| if (x - meant).abs() < 1e-8 { meant } else { x };
        let swing = self.amplitude.zip(self.pulsation).zip(self.phase);
        let wave = swing.map(|((amplitude, pulsation), phase)| {
            let (pulsation, phase) = (exact(pulsation, 2.0 * PI / 160.0), exact(phase, FRAC_PI_2));
            Wave { amplitude, pulsation, phase }
        });
        let &Self { width, speed_limit, forbidden, .. } = self;
        let lane = LaneSettings::new(&self.from, &self.to, self.start, self.end);
        LaneSettings { width, speed_limit, forbidden, wave, ..lane }
    }
}

#[derive(Debug, Deserialize)]
pub(super) struct VehicleStart {
    pub(super) class: String,
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) heading: f64,
    pub(super) speed: f64,
    pub(super) target_speed: Option<f64>,
    pub(super) timer: Option<f64>,
    pub(super) enable_lane_change: Option<bool>,
}

/// A row, recorded as a list in this order.
#[derive(Debug, Deserialize)]
pub(super) struct VehicleRow {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) heading: f64,
    pub(super) speed: f64,
    pub(super) lane: i64,
    pub(super) target_lane: i64,
    pub(super) acceleration: Option<f64>,
    pub(super) steering: Option<f64>,
    pub(super) timer: Option<f64>,
    pub(super) crashed: u8,
}

/// Two rectangles, each (x, y, heading, speed).
#[derive(Debug, Deserialize)]
pub(super) struct CollisionCase {
    pub(super) a: [f64; 4],
    pub(super) b: [f64; 4],
    pub(super) dt: f64,
    pub(super) intersecting: bool,
    pub(super) will_intersect: bool,
    /// A pair where the rectangles will intersect; anything elsewhere.
    pub(super) translation: Value,
}

/// A car behind another.
#[derive(Debug, Deserialize)]
pub(super) struct IdmCase {
    pub(super) target_speed: f64,
    pub(super) speed: f64,
    pub(super) gap: Option<f64>,
    pub(super) front_speed: Option<f64>,
    pub(super) acceleration: f64,
    pub(super) desired_gap: Option<f64>,
}
