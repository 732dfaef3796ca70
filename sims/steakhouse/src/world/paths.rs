//! Shortest paths through a kitchen, all computed when it is loaded.
//!
//! From every pose, a breadth-first search over (tile, direction): going to a direction steps onto the floor ahead and
//! faces it, or only turns; every action costs 1. Directions are tried north, south, east, west, poses are marked when
//! they are generated, and the first generated pose that faces a target ends the path to it. That fixes one path per
//! pose and target, so that nothing about motion is left to chance.

use std::collections::VecDeque;

use super::grid::{Grid, GridPlace, Pose};
use super::kinds::{Action, Direction};

/// The path to a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Route {
    /// Actions until the place is in front: steps and turns.
    pub cost: u16,
    /// What to do first; to interact, if the place is in front.
    pub first: Action,
}

/// The paths from every pose to everything that a cook can use.
#[derive(Clone, Debug)]
pub struct Paths {
    /// By tile: its number among the floor tiles, or among the others.
    number: Vec<u16>,
    n_targets: usize,
    /// The shortest path from each pose to each target; `None` where there is none. `[floor, facing, target]`
    routes: Vec<Option<Route>>,
}

impl Paths {
    /// Computes the shortest paths from every pose, by a breadth-first search each.
    pub fn new(grid: &Grid) -> Self {
        let (mut n_floor, mut n_targets) = (0, 0);
        let number = grid.places().map(|place| {
            let count = if grid.is_floor(place) { &mut n_floor } else { &mut n_targets };
            *count += 1;
            *count - 1
        });
        let number = number.collect();
        let n_targets = usize::from(n_targets);
        let n_routes = usize::from(n_floor) * 4 * n_targets;
        let mut paths = Self { number, n_targets, routes: vec![None; n_routes] };
        grid.poses().for_each(|pose| paths.search(grid, pose));
        paths
    }

    /// Returns the path from a pose to facing a place; `None` if it cannot be reached.
    pub fn route(&self, from: Pose, to: GridPlace) -> Option<Route> {
        let target = usize::from(self.number[to.index()]);
        self.routes[self.pose_index(from) * self.n_targets + target]
    }

    fn pose_index(&self, pose: Pose) -> usize {
        usize::from(self.number[pose.place.index()]) * 4 + pose.facing as usize
    }

    fn search(&mut self, grid: &Grid, start: Pose) {
        let stay = Route { cost: 0, first: Action::Interact };
        let mut is_reached = vec![false; grid.floor.len() * 4];
        is_reached[self.pose_index(start)] = true;
        self.note(grid, start, start, stay);
        let mut open = VecDeque::from([(start, stay)]);
        while let Some((pose, so_far)) = open.pop_front() {
            for facing in Direction::ALL {
                let place = grid.free_ahead(Pose { facing, ..pose }).unwrap_or(pose.place);
                let next = Pose { place, facing };
                let first = if so_far.cost == 0 { Action::Go(facing) } else { so_far.first };
                let route = Route { cost: so_far.cost + 1, first };
                if !std::mem::replace(&mut is_reached[self.pose_index(next)], true) {
                    open.push_back((next, route));
                    self.note(grid, start, next, route);
                }
            }
        }
    }

    /// Notes the path to what a newly reached pose faces, unless there was one before.
    fn note(&mut self, grid: &Grid, start: Pose, reached: Pose, route: Route) {
        let faced = grid.ahead(reached);
        if grid.is_floor(faced) {
            return;
        }
        let target = usize::from(self.number[faced.index()]);
        let index = self.pose_index(start) * self.n_targets + target;
        self.routes[index].get_or_insert(route);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::layouts::kitchen;

    fn costs(grid: &Grid, from: Pose) -> [u16; 10] {
        let paths = Paths::new(grid);
        [(8, 1), (8, 3), (8, 5), (2, 0), (4, 0), (0, 1), (0, 3), (0, 5), (2, 6), (6, 6)]
            .map(|(x, y)| paths.route(from, grid.place(x, y).unwrap()).unwrap().cost)
    }

    #[test]
    fn distances_in_the_ring_are_those_counted_by_hand() {
        let ring = kitchen("ring").unwrap();
        let pose = |x, y, facing| Pose { place: ring.place(x, y).unwrap(), facing };
        let (start, meat) = (pose(6, 3, Direction::South), pose(7, 1, Direction::East));
        assert_eq!(costs(&ring, start), [3, 1, 3, 7, 5, 7, 9, 7, 7, 2]);
        assert_eq!(costs(&ring, meat), [0, 3, 5, 6, 4, 6, 8, 10, 9, 5]);
        let sink = pose(1, 5, Direction::West);
        assert_eq!(costs(&ring, sink), [10, 8, 6, 5, 8, 5, 3, 0, 2, 6]);
    }

    #[test]
    fn the_first_action_steps_turns_or_interacts() {
        let ring = kitchen("ring").unwrap();
        let paths = Paths::new(&ring);
        let first = |x, y, facing, [to_x, to_y]: [i32; 2]| {
            let from = Pose { place: ring.place(x, y).unwrap(), facing };
            paths.route(from, ring.place(to_x, to_y).unwrap()).map(|route| route.first)
        };
        let go = |direction| Some(Action::Go(direction));
        assert_eq!(first(7, 1, Direction::East, [8, 1]), Some(Action::Interact));
        assert_eq!(first(7, 1, Direction::South, [8, 1]), go(Direction::East));
        // North before west: the meat is fetched along the east wall.
        assert_eq!(first(6, 3, Direction::South, [8, 1]), go(Direction::North));
        // No floor borders on a corner.
        assert_eq!(first(6, 3, Direction::South, [0, 0]), None);
    }
}
