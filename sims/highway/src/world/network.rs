//! Which lanes there are, which lie side by side, and which follow which.
//!
//! Lanes between the same two nodes form a road. Lanes are numbered in the order of first mention of their
//! start nodes, then of their end nodes, then as written: the order in which ties are broken everywhere.
//!
//! # What a driver looks along
//!
//! A driver who looks for the next car ahead or behind sees more than one segment. [`Lookup`] says how
//! much: the original's two ways (for comparison) and one that follows the geometry, which alone is right next to
//! ramps on the left.

use std::collections::BTreeSet;
use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::lane::{Lane, LaneSettings};

/// Number of a lane.
pub type LaneId = usize;

/// How far a lane's end may be from the start of the one that follows it, in metres.
const TOUCH: f64 = 0.1;

/// How drivers look along the road for their neighbours.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Lookup {
    /// On the one segment: highway-env's `merge-v0`. Blind beyond its end.
    Segment,
    /// One segment ahead and behind, matched by lane numbers: highway-env's `merge-v1`.
    Numbers,
    /// Two segments ahead and one behind, matched by where lanes touch.
    Geometry,
}

/// The lanes between two nodes, which are numbers here.
#[derive(Clone, Debug, PartialEq)]
struct ParallelLanes {
    from: usize,
    to: usize,
    lanes: Range<LaneId>,
}

/// A segment in a driver's view: the lane, and what to add to s on it.
type LaneSegment = (LaneId, f64);

/// The lanes of a world.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RoadNetwork {
    /// Names of the nodes, in the order of the alphabet.
    nodes: Vec<String>,
    roads: Vec<ParallelLanes>,
    lanes: Vec<Lane>,
    road_of: Vec<usize>,
    /// `[left, right]` of each lane.
    sides: Vec<[Option<LaneId>; 2]>,
    ranks: Vec<u32>,
    views: Vec<Vec<LaneSegment>>,
}

fn ends(lane: &LaneSettings) -> [&str; 2] {
    [&lane.from, &lane.to]
}

impl RoadNetwork {
    /// Arranges lanes; they must have a length.
    pub fn new(settings: &[LaneSettings], lookup: Lookup) -> Self {
        let nodes: BTreeSet<&str> = settings.iter().flat_map(ends).collect();
        let nodes = nodes.into_iter().map(str::to_owned).collect();
        let mut this = Self { nodes, ..Self::default() };
        let mut written: Vec<&LaneSettings> = settings.iter().collect();
        written.sort_by_cached_key(|lane| {
            let start = settings.iter().position(|other| other.from == lane.from);
            (start, settings.iter().position(|other| ends(other) == ends(lane)))
        });
        for lanes in written.chunk_by(|a, b| ends(a) == ends(b)) {
            let number = |name| this.nodes.partition_point(|node| node.as_str() < name);
            let [from, to] = ends(lanes[0]).map(number);
            let first = this.lanes.len();
            this.road_of.extend(lanes.iter().map(|_| this.roads.len()));
            this.lanes.extend(lanes.iter().map(|lane| Lane::new(lane)));
            this.roads.push(ParallelLanes { from, to, lanes: first..this.lanes.len() });
        }
        this.sides = (0..this.lanes.len()).map(|lane| this.find_sides(lane)).collect();
        this.ranks = (0..this.lanes.len()).map(|lane| this.find_rank(lane)).collect();
        this.views = (0..this.lanes.len()).map(|lane| this.find_view(lane, lookup)).collect();
        this
    }

    /// Returns a lane of this network.
    ///
    /// # Panics
    ///
    /// If the network has no such lane.
    pub fn lane(&self, lane: LaneId) -> &Lane {
        &self.lanes[lane]
    }

    /// Returns all lanes, by number.
    pub fn lanes(&self) -> &[Lane] {
        &self.lanes
    }

    /// Names a lane for a person: `m0→m1 1`.
    pub fn name(&self, lane: LaneId) -> String {
        let road = &self.roads[self.road_of[lane]];
        let (from, to) = (&self.nodes[road.from], &self.nodes[road.to]);
        format!("{from}→{to} {}", self.place(lane))
    }

    /// Returns the lanes between two nodes, in the order in which they were written.
    pub fn between(&self, from: &str, to: &str) -> Range<LaneId> {
        let mut roads = self.roads.iter();
        let road = roads.find(|road| [&self.nodes[road.from], &self.nodes[road.to]] == [from, to]);
        road.map_or(0..0, |road| road.lanes.clone())
    }

    /// Returns how many lanes lie side by side with a lane, itself included.
    pub fn n_abreast(&self, lane: LaneId) -> usize {
        self.roads[self.road_of[lane]].lanes.len()
    }

    /// Returns the lanes to the left and to the right of a lane.
    pub fn sides(&self, lane: LaneId) -> [Option<LaneId>; 2] {
        self.sides[lane]
    }

    /// Counts the lanes to the left of a lane that one may change into: 0 for the leftmost.
    pub fn rank(&self, lane: LaneId) -> u32 {
        self.ranks[lane]
    }

    /// Returns whether two lanes lie side by side.
    pub fn same_road(&self, a: LaneId, b: LaneId) -> bool {
        self.road_of[a] == self.road_of[b]
    }

    /// Returns whether a lane ends where one next to it goes on.
    pub fn ends(&self, lane: LaneId) -> bool {
        let goes_on = |lane: LaneId| (0..self.lanes.len()).any(|next| self.follows(next, lane));
        !goes_on(lane) && self.roads[self.road_of[lane]].lanes.clone().any(goes_on)
    }

    /// Returns how far along a lane a driver on it sees a point, if it lies in their view.
    pub fn seen_along(&self, lane: LaneId, point: [f64; 2]) -> Option<f64> {
        self.views[lane].iter().find_map(|&(segment, offset)| {
            self.lanes[segment].holds(point, 1.0).map(|s| s + offset)
        })
    }

    /// Finds the lane that a car is on: the least sum of distance and difference in heading (1 m per radian).
    ///
    /// `hint` is where it was; it makes the search quick and does not change its result.
    pub fn closest(&self, point: [f64; 2], heading: f64, hint: LaneId) -> LaneId {
        let cost = |lane: &Lane, distance: f64| distance + lane.misalignment(point, heading);
        let hinted = &self.lanes[hint];
        let bound = cost(hinted, hinted.distance(point));
        let (mut best, mut lowest) = (hint, f64::INFINITY);
        for (id, lane) in self.lanes.iter().enumerate() {
            let distance = lane.distance(point);
            if distance > bound {
                continue;
            }
            let cost = cost(lane, distance);
            if cost < lowest {
                (best, lowest) = (id, cost);
            }
        }
        best
    }

    /// Finds the lane that follows a lane for a driver without a route; the lane itself at the end of the network.
    ///
    /// Between roads of as many lanes one keeps one's place; otherwise the nearest lane follows.
    pub fn next(&self, lane: LaneId, point: [f64; 2]) -> LaneId {
        let centre = self.lanes[lane].position(self.lanes[lane].along(point), 0.0);
        let road = &self.roads[self.road_of[lane]];
        let (mut best, mut nearest) = (lane, f64::INFINITY);
        for next in self.roads.iter().filter(|next| next.from == road.to) {
            let same = next.lanes.start + self.place(lane);
            let is_as_wide = next.lanes.len() == road.lanes.len();
            for candidate in if is_as_wide { same..same + 1 } else { next.lanes.clone() } {
                let distance = self.lanes[candidate].distance(centre);
                if distance < nearest {
                    (best, nearest) = (candidate, distance);
                }
            }
        }
        best
    }

    /// Returns a lane's place among those next to it, as written.
    fn place(&self, lane: LaneId) -> usize {
        lane - self.roads[self.road_of[lane]].lanes.start
    }

    fn find_sides(&self, lane: LaneId) -> [Option<LaneId>; 2] {
        let mut sides = [None; 2];
        let mut reach = [f64::INFINITY; 2];
        for other in self.roads[self.road_of[lane]].lanes.clone() {
            let across = self.lanes[lane].local(self.lanes[other].position(0.0, 0.0))[1];
            let side = usize::from(across > 0.0);
            if other != lane && across.abs() < reach[side] {
                (sides[side], reach[side]) = (Some(other), across.abs());
            }
        }
        sides
    }

    fn find_rank(&self, lane: LaneId) -> u32 {
        let (mut rank, mut at) = (0, lane);
        // At most as many as lie abreast, so that odd geometry cannot go round in a circle.
        for _ in 0..self.n_abreast(lane) {
            let Some(left) = self.sides[at][0] else { break };
            rank += u32::from(!self.lanes[left].forbidden);
            at = left;
        }
        rank
    }

    fn find_view(&self, lane: LaneId, lookup: Lookup) -> Vec<LaneSegment> {
        let (mut view, mut before) = (vec![(lane, 0.0)], Vec::new());
        match lookup {
            Lookup::Segment => {}
            Lookup::Numbers => {
                let (road, place) = (&self.roads[self.road_of[lane]], self.place(lane));
                let matching = |other: &ParallelLanes| {
                    other.lanes.start + if place < other.lanes.len() { place } else { 0 }
                };
                let next = self.roads.iter().filter(|next| next.from == road.to).map(matching);
                view.extend(next.map(|next| (next, self.lanes[lane].length)));
                let previous = self.roads.iter().filter(|previous| previous.to == road.from);
                before.extend(previous.map(matching));
            }
            Lookup::Geometry => {
                let all = 0..self.lanes.len();
                let mut ahead = view.clone();
                for _hop in 0..2 {
                    let next = ahead.iter().flat_map(|&(at, offset)| {
                        let beyond = offset + self.lanes[at].length;
                        let followers = all.clone().filter(move |&next| self.follows(next, at));
                        followers.map(move |follower| (follower, beyond))
                    });
                    ahead = next.collect();
                    view.extend(&ahead);
                }
                before.extend(all.filter(|&previous| self.follows(lane, previous)));
            }
        }
        view.extend(before.into_iter().map(|previous| (previous, -self.lanes[previous].length)));
        view
    }

    /// Returns whether lane `b` begins where lane `a` ends.
    fn follows(&self, b: LaneId, a: LaneId) -> bool {
        let (end, start) = (self.lanes[a].end(), self.lanes[b].position(0.0, 0.0));
        let [dx, dy] = [end[0] - start[0], end[1] - start[1]];
        a != b && libm::sqrt(dx * dx + dy * dy) < TOUCH
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::RoadSettings;

    fn network(lookup: Lookup) -> RoadNetwork {
        RoadNetwork::new(&RoadSettings::merge().lanes, lookup)
    }

    #[test]
    fn lanes_are_numbered_by_their_nodes_first_mention() {
        let network = network(Lookup::Segment);
        let names: Vec<String> =
            (0..network.lanes().len()).map(|lane| network.name(lane)).collect();
        let expected =
            ["a→b 0", "a→b 1", "b→c 0", "b→c 1", "b→c 2", "c→d 0", "c→d 1", "j→k 0", "k→b 0"];
        assert_eq!(names, expected);
        assert_eq!((network.between("b", "c"), network.between("c", "b")), (2..5, 0..0));
    }

    #[test]
    fn neighbours_are_found_across_the_road() {
        let network = RoadNetwork::new(&RoadSettings::three_merges().lanes, Lookup::Geometry);
        let lanes: Vec<LaneId> = network.between("m3", "m4").collect();
        let [left, right, ramp] = lanes[..] else { panic!("three lanes") };
        assert_eq!(network.sides(left), [Some(ramp), Some(right)]);
        assert_eq!(network.sides(right), [Some(left), None]);
        assert_eq!(network.sides(ramp), [None, Some(left)]);
        assert_eq!([left, right, ramp].map(|lane| network.rank(lane)), [0, 1, 0]);
        let ramp = network.between("m1", "m2").end - 1;
        assert_eq!((network.sides(ramp)[1], network.rank(ramp)), (None, 2));
    }

    #[test]
    fn a_ramp_leads_into_the_parallel_lane_and_that_to_the_nearest() {
        let network = network(Lookup::Segment);
        assert_eq!(network.next(7, [149.0, 14.5]), 8);
        assert_eq!(network.next(8, [229.0, 8.0]), 4);
        assert_eq!(network.next(4, [309.0, 8.0]), 6);
        assert_eq!(network.next(0, [229.0, 0.0]), 2);
        assert_eq!(network.next(6, [459.0, 4.0]), 6);
    }

    #[test]
    fn the_closest_lane_does_not_depend_on_the_hint() {
        let network = network(Lookup::Segment);
        for (point, lane) in
            [([229.9, 2.0], 0), ([230.0, 2.1], 1), ([231.0, 6.1], 4), ([190.0, 9.0], 8)]
        {
            for hint in 0..9 {
                assert_eq!(network.closest(point, 0.0, hint), lane, "{point:?} from {hint}");
            }
        }
    }

    #[test]
    fn lookups_differ_in_what_lies_beyond_a_segment() {
        let beyond = [250.0, 4.0];
        let seen = |lookup| network(lookup).seen_along(1, beyond);
        assert_eq!(seen(Lookup::Segment), None);
        assert_eq!(seen(Lookup::Numbers), Some(250.0));
        assert_eq!(seen(Lookup::Geometry), Some(250.0));
        // By numbers, a car from the ramp looks ahead on the left lane of the carriageway.
        let left = [250.0, 0.0];
        assert_eq!(network(Lookup::Numbers).seen_along(8, left), Some(100.0));
        assert_eq!(network(Lookup::Geometry).seen_along(8, left), None);
        let ramp = [250.0, 8.0];
        assert_eq!(network(Lookup::Geometry).seen_along(8, ramp), Some(100.0));
        assert_eq!(network(Lookup::Geometry).seen_along(1, [400.0, 4.0]), Some(400.0));
        assert_eq!(network(Lookup::Geometry).seen_along(6, beyond), Some(-60.0));
    }
}
