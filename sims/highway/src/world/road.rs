//! Roads as data: the original's merge, the road with three merges, and whatever a person writes.
//!
//! ```text
//!                          m3 ══════════ m4
//! m0 ════════ m1 ════════ m2 ═══════════════ m4 ══════ m5 ════════ m6 ════ m7     two lanes throughout
//!     ramp 0 ─╱═══════                      ramp 2 ───╱═══════
//! ```
//!
//! A ramp is an approach, a converging lane and a lane parallel to the carriageway that ends at an obstacle.

use std::f64::consts::{FRAC_PI_2, PI};

use leadtime_sims::check::{SettingError, require};
use serde::{Deserialize, Serialize};

use super::lane::{LaneSettings, Wave};
use super::network::{LaneId, Lookup, RoadNetwork};

/// Which side of the carriageway a ramp comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// From the left, in the direction of travel.
    Left,
    /// From the right, in the direction of travel.
    Right,
}

/// A ramp as a person writes it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RampSettings {
    /// The nodes that it passes, at least three. Its last stretch lies next to the carriageway, on a lane that is
    /// forbidden; every earlier one is a road of a single lane.
    pub nodes: Vec<String>,
}

/// A road as a person writes it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RoadSettings {
    /// The lanes; those of the same two nodes lie side by side.
    pub lanes: Vec<LaneSettings>,
    /// The ramps from which cars merge, in the order in which the carriageway meets them.
    #[serde(default)]
    pub ramps: Vec<RampSettings>,
    /// Centres of obstacles of 2 m by 2 m.
    #[serde(default)]
    pub obstacles: Vec<[f64; 2]>,
}

/// A ramp whose lanes are known.
#[derive(Clone, Debug, PartialEq)]
pub struct Ramp {
    /// Its lanes, from the approach to the one next to the carriageway.
    pub lanes: Vec<LaneId>,
    /// Where it meets the carriageway: x of the start of its last lane.
    pub merge_x: f64,
    /// Where its last lane ends.
    pub end_x: f64,
    /// Where it comes from.
    pub side: Side,
}

impl Ramp {
    /// Returns the lane next to the carriageway.
    pub fn parallel(&self) -> LaneId {
        self.lanes[self.lanes.len() - 1]
    }
}

/// A road that has been checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Road {
    /// Its lanes, and how they lead on.
    pub network: RoadNetwork,
    /// The ramps that lead onto it.
    pub ramps: Vec<Ramp>,
    /// Centres of its obstacles.
    pub obstacles: Vec<[f64; 2]>,
}

/// Length of a ramp's approach, converging and parallel lane.
const RAMP: [f64; 3] = [150.0, 80.0, 80.0];
/// Half the way that a converging lane swings across.
const SWING: f64 = 3.25;
/// Speed limit of the three-merge road's carriageway and parallel lanes.
const LIMIT: f64 = 40.0;

impl RoadSettings {
    /// Returns the original's merge: 230 m, 80 m next to a ramp from the right, 150 m; 20 m/s everywhere.
    ///
    /// # Source
    ///
    /// highway-env 1.12.1, `envs/merge_env.py`.
    pub fn merge() -> Self {
        let mut this = Self { lanes: Vec::new(), ramps: Vec::new(), obstacles: Vec::new() };
        for y in [0.0, 4.0] {
            this.lanes.push(straight("a", "b", [0.0, 230.0], y));
            this.lanes.push(straight("b", "c", [230.0, 310.0], y));
            this.lanes.push(straight("c", "d", [310.0, 460.0], y));
        }
        this.push_ramp(["j", "k", "b", "c"], 230.0, Side::Right, 20.0);
        this
    }

    /// Returns the road with merges from the right at 230 m, from the left at 540 m and from the right at 850 m.
    pub fn three_merges() -> Self {
        use Side::{Left, Right};
        Self::merges(&[(230.0, Right), (540.0, Left), (850.0, Right)])
    }

    /// Lays out a carriageway of two lanes from x = 0 with merges at rising x, which are at least 310 m apart.
    pub fn merges(merges: &[(f64, Side)]) -> Self {
        let mut this = Self { lanes: Vec::new(), ramps: Vec::new(), obstacles: Vec::new() };
        let (mut x, mut node) = (0.0, 0);
        for (i, &(merge_x, side)) in merges.iter().enumerate() {
            this.push_carriageway(node, [x, merge_x]);
            let beyond = merge_x + RAMP[2];
            this.push_carriageway(node + 1, [merge_x, beyond]);
            let names = [format!("j{i}"), format!("k{i}"), m(node + 1), m(node + 2)];
            let names = names.each_ref().map(String::as_str);
            this.push_ramp(names, merge_x, side, LIMIT);
            (x, node) = (beyond, node + 2);
        }
        this.push_carriageway(node, [x, x + 150.0]);
        this
    }

    /// Checks lanes, their connections and ramps, and arranges them.
    ///
    /// # Errors
    ///
    /// [`SettingError`] if there are no lanes or more than 256, an obstacle is not finite, a lane is impossible or ends
    /// where nothing goes on, or a ramp is not made of lanes of the road. It names the first such entry.
    pub fn build(&self, lookup: Lookup) -> Result<Road, SettingError> {
        let n_lanes = self.lanes.len();
        let given = format_args!("{n_lanes} lanes");
        require((1..=256).contains(&n_lanes), "world.road.lanes", given, "1 to 256 lanes")?;
        self.lanes.iter().try_for_each(check_lane)?;
        for [x, y] in &self.obstacles {
            let finite = x.is_finite() && y.is_finite();
            let given = format_args!("[{x}, {y}]");
            require(finite, "world.road.obstacles", given, "points [x, y] in metres")?;
        }
        let network = RoadNetwork::new(&self.lanes, lookup);
        check_connections(&network)?;
        let ramps = self.ramps.iter().map(|ramp| ramp.find(&network)).collect::<Result<_, _>>()?;
        Ok(Road { network, ramps, obstacles: self.obstacles.clone() })
    }

    fn push_carriageway(&mut self, node: usize, ends: [f64; 2]) {
        for y in [0.0, 4.0] {
            let lane = straight(&m(node), &m(node + 1), ends, y);
            self.lanes.push(LaneSettings { speed_limit: LIMIT, ..lane });
        }
    }

    /// Adds a ramp, its three lanes and the obstacle at its end.
    fn push_ramp(&mut self, nodes: [&str; 4], merge_x: f64, side: Side, parallel_limit: f64) {
        let [approach, converging, parallel] = RAMP;
        // The parallel lane is the carriageway's neighbour; the approach lies twice the swing further out.
        let (y, outwards) = match side {
            Side::Right => (8.0, 1.0),
            Side::Left => (-4.0, -1.0),
        };
        let converges_from = merge_x - converging;
        let from = converges_from - approach;
        let far = y + outwards * 2.0 * SWING;
        let mut own = [
            straight(nodes[0], nodes[1], [from, converges_from], far),
            straight(nodes[1], nodes[2], [converges_from, merge_x], y + outwards * SWING),
            straight(nodes[2], nodes[3], [merge_x, merge_x + parallel], y),
        ];
        let (pulsation, phase) = (PI / converging, outwards * FRAC_PI_2);
        own[1].wave = Some(Wave { amplitude: SWING, pulsation, phase });
        own[2].speed_limit = parallel_limit;
        self.lanes.extend(own.map(|lane| LaneSettings { forbidden: true, ..lane }));
        self.ramps.push(RampSettings { nodes: nodes.map(str::to_owned).to_vec() });
        self.obstacles.push([merge_x + parallel, y]);
    }
}

impl RampSettings {
    fn find(&self, network: &RoadNetwork) -> Result<Ramp, SettingError> {
        let error = |allowed: String| SettingError {
            key: "world.road.ramps",
            given: format!("{:?}", self.nodes),
            allowed: allowed.into(),
        };
        let stretches = self.nodes.windows(2).collect::<Vec<_>>();
        if stretches.len() < 2 {
            return Err(error("at least three nodes".to_owned()));
        }
        let mut lanes = Vec::with_capacity(stretches.len());
        for (i, stretch) in stretches.iter().enumerate() {
            let is_last = i + 1 == stretches.len();
            let mut fit = network.between(&stretch[0], &stretch[1]);
            let lane = if is_last {
                fit.find(|&lane| network.lane(lane).forbidden)
            } else {
                fit.next().filter(|_| fit.next().is_none())
            };
            let kind = if is_last { "a forbidden lane" } else { "a road of a single lane" };
            let wanted = || error(format!("{kind} from `{}` to `{}`", stretch[0], stretch[1]));
            lanes.push(lane.ok_or_else(wanted)?);
        }
        let parallel = lanes[lanes.len() - 1];
        let side = match network.sides(parallel) {
            [Some(_), None] => Side::Right,
            [None, Some(_)] => Side::Left,
            _ => return Err(error("a last lane at one edge of the carriageway".to_owned())),
        };
        let lane = network.lane(parallel);
        let (merge_x, end_x) = (lane.position(0.0, 0.0)[0], lane.end()[0]);
        Ok(Ramp { lanes, merge_x, end_x, side })
    }
}

/// Names a node of the carriageway.
fn m(node: usize) -> String {
    format!("m{node}")
}

fn straight(from: &str, to: &str, [x0, x1]: [f64; 2], y: f64) -> LaneSettings {
    LaneSettings::new(from, to, [x0, y], [x1, y])
}

fn check_lane(lane: &LaneSettings) -> Result<(), SettingError> {
    const KEY: &str = "world.road.lanes";
    let (from, to) = (&lane.from, &lane.to);
    let [[x0, y0], [x1, y1]] = [lane.start, lane.end];
    let given = format_args!("{from}→{to} from [{x0}, {y0}] to [{x1}, {y1}]");
    let length = libm::sqrt((x1 - x0) * (x1 - x0) + (y1 - y0) * (y1 - y0));
    let allowed = "lanes with an end at least 1 m and at most 100 km from their start";
    require((1.0..=1e5).contains(&length), KEY, given, allowed)?;
    let places = [x0, y0, x1, y1].iter().all(|place| place.abs() <= 1e6);
    require(places, KEY, given, "places within 1000 km of the origin")?;
    require(from != to, KEY, given, "lanes between two different nodes")?;
    let given = format_args!("{from}→{to} of width {}", lane.width);
    require((1.0..=20.0).contains(&lane.width), KEY, given, "widths of 1 to 20 m")?;
    let given = format_args!("{from}→{to} with a limit of {}", lane.speed_limit);
    require((1.0..=40.0).contains(&lane.speed_limit), KEY, given, "limits of 1 to 40 m/s")?;
    let Some(Wave { amplitude, pulsation, phase }) = lane.wave else { return Ok(()) };
    let given =
        format_args!("{from}→{to} with a wave of {amplitude} m, {pulsation} rad/m, {phase}");
    let fits = amplitude.abs() <= 20.0 && pulsation.abs() <= 1.0 && phase.abs() <= 10.0;
    require(fits, KEY, given, "waves of at most 20 m, 1 rad/m and 10 rad")
}

/// Checks that no lane ends in the void: where its end node leads on, a lane goes on next to its end.
fn check_connections(network: &RoadNetwork) -> Result<(), SettingError> {
    for (id, lane) in network.lanes().iter().enumerate() {
        let end = lane.end();
        let next = network.next(id, end);
        let gap = network.lane(next).distance(end);
        // Where lanes are lost, as at the end of a ramp, the next one lies one lane to the side.
        let given =
            format_args!("{}, which ends {gap} m from {}", network.name(id), network.name(next));
        let allowed = "lanes that touch, or lie side by side, where they share a node";
        require(gap <= 1.5 * lane.width, "world.road.lanes", given, allowed)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(change: impl FnOnce(&mut RoadSettings)) -> String {
        let mut road = RoadSettings::three_merges();
        change(&mut road);
        road.build(Lookup::Geometry).unwrap_err().to_string()
    }

    #[test]
    fn the_three_merge_road_is_where_it_should_be() {
        let road = RoadSettings::three_merges().build(Lookup::Geometry).unwrap();
        let sides = [Side::Right, Side::Left, Side::Right];
        assert_eq!(road.obstacles, [[310.0, 8.0], [620.0, -4.0], [930.0, 8.0]]);
        assert_eq!(road.network.lanes().len(), 3 * (2 + 3 + 2) + 2);
        for ((ramp, side), (merge_x, y)) in
            road.ramps.iter().zip(sides).zip([(230.0, 14.5), (540.0, -10.5), (850.0, 14.5)])
        {
            assert_eq!((ramp.side, ramp.merge_x, ramp.end_x), (side, merge_x, merge_x + 80.0));
            let [approach, converging, parallel] = ramp.lanes[..] else { panic!("three lanes") };
            let lane = |id| road.network.lane(id);
            assert_eq!(lane(approach).position(0.0, 0.0), [merge_x - 230.0, y]);
            assert_eq!((lane(approach).length, lane(converging).length), (150.0, 80.0));
            assert!(lane(converging).distance(lane(approach).end()) < 1e-9);
            assert!(lane(parallel).distance(lane(converging).end()) < 1e-9);
            assert_eq!((lane(approach).speed_limit, lane(parallel).speed_limit), (20.0, 40.0));
        }
        assert_eq!(road.network.name(road.network.lanes().len() - 1), "m6→m7 1");
    }

    #[test]
    fn a_road_reads_as_a_person_writes_it() {
        let text = r#"{"lanes": [{"from": "a", "to": "b", "start": [0, 0], "end": [500, 0]}]}"#;
        let road: RoadSettings = serde_json::from_str(text).unwrap();
        let road = road.build(Lookup::Geometry).unwrap();
        assert_eq!((road.network.lane(0).width, road.network.lane(0).speed_limit), (4.0, 20.0));
        let endless = r#"{"lanes": [{"from": "a", "to": "b", "start": [0, 0]}]}"#;
        let error = serde_json::from_str::<RoadSettings>(endless).unwrap_err().to_string();
        assert!(error.starts_with("missing field `end`"), "{error}");
    }

    #[test]
    fn impossible_roads_are_named() {
        let text = refused(|road| road.lanes[2].end = road.lanes[2].start);
        assert!(text.starts_with("`world.road.lanes` is m1→m2 from [230, 0] to [230, 0]"));
        assert!(refused(|road| road.lanes[2].end[0] = f64::NAN).contains("m1→m2"));
        let text = refused(|road| road.lanes[0].end[0] = 200.0);
        let expected = "`world.road.lanes` is m0→m1 0, which ends 30 m from m1→m2 0; \
                        allowed: lanes that touch, or lie side by side, where they share a node";
        assert_eq!(text, expected);
        assert!(refused(|road| road.lanes.clear()).contains("0 lanes"));
        assert!(refused(|road| road.lanes[0].speed_limit = 0.0).contains("limit of 0"));
        assert!(refused(|road| road.obstacles[0][1] = f64::INFINITY).contains("[310, inf]"));
        let text = refused(|road| road.ramps[1].nodes[0] = "j7".to_owned());
        let expected = "`world.road.ramps` is [\"j7\", \"k1\", \"m3\", \"m4\"]; \
                        allowed: a road of a single lane from `j7` to `k1`";
        assert_eq!(text, expected);
        assert!(refused(|road| road.ramps[0].nodes.truncate(2)).contains("at least three nodes"));
        let text = refused(|road| road.ramps[0].nodes[3] = "m3".to_owned());
        assert!(text.contains("a forbidden lane from `m1` to `m3`"), "{text}");
    }
}
