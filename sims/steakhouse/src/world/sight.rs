//! What a cook sees: a block of two by three tiles ahead, or the wide cone of the public original.
//!
//! Nothing hides anything: counters, stations and cooks are looked over, and only the grid's edge cuts the view.
//!
//! # Source
//!
//! Hsu et al. (arXiv:2509.07438) give the size of the block; its place is ours. The cone is the test by which
//! FOV-aware-planner draws what a cook sees.

use serde::{Deserialize, Serialize};

use super::grid::{Grid, GridPlace, Pose};
use super::kinds::Direction;

/// How far the block reaches ahead, in tiles.
const DEPTH: i32 = 2;
/// How far the block reaches to either side, in tiles.
const REACH: i32 = 1;
/// Angle from which on a cone takes in both neighbours to the side, in degrees.
const WIDE_DEGREES: u16 = 120;

/// The shape of what a cook sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FieldOfView {
    /// The two rows of three tiles directly ahead.
    Block,
    /// Everything within this angle, in degrees (1 to 179), however far.
    Cone(u16),
}

impl FieldOfView {
    /// Returns whether a tile is seen that lies so far ahead and to the side of the cook.
    fn sees(self, forward: i32, lateral: i32) -> bool {
        match self {
            Self::Block => (1..=DEPTH).contains(&forward) && lateral.abs() <= REACH,
            Self::Cone(degrees) => {
                let half_width = libm::tan(f64::from(degrees).to_radians() / 2.0);
                // The border of the cone belongs to it, whatever rounding makes of its slope.
                let within = f64::from(lateral.abs()) <= f64::from(forward) * half_width + 1e-9;
                let beside = degrees >= WIDE_DEGREES && forward == 0 && lateral.abs() == 1;
                (forward, lateral) == (0, 0) || (forward > 0 && within) || beside
            }
        }
    }

    /// Lists what is seen from a pose, row by row.
    pub fn visible(self, grid: &Grid, pose: Pose) -> impl Iterator<Item = GridPlace> {
        let [x, y] = grid.position(pose.place).map(|side| side as i32);
        grid.places().filter(move |&place| {
            let [to_x, to_y] = grid.position(place).map(|side| side as i32);
            self.sees_offset(pose.facing, to_x - x, to_y - y)
        })
    }

    /// Returns whether a tile is seen that lies so many columns to the right and rows below.
    pub fn sees_offset(self, facing: Direction, dx: i32, dy: i32) -> bool {
        let (east, south) = facing.offset();
        self.sees(dx * east + dy * south, dy * east - dx * south)
    }
}

/// Which stations are seen from every pose.
#[derive(Clone, Debug)]
pub struct Sight {
    /// `[tile, facing]`: a bit per station slot; 0 where nobody can stand.
    masks: Vec<u16>,
}

impl Sight {
    /// Looks around in every pose.
    pub fn new(grid: &Grid, field_of_view: FieldOfView) -> Self {
        let mut masks = vec![0; 4 * grid.width * grid.height()];
        for pose in grid.poses() {
            let seen = field_of_view.visible(grid, pose);
            let slots = seen.filter_map(|place| grid.slot_at(place));
            let mask = slots.fold(0, |mask, slot| mask | 1 << slot);
            masks[pose.place.index() * 4 + pose.facing as usize] = mask;
        }
        Self { masks }
    }

    /// Returns a bit per station slot that is seen.
    pub fn stations(&self, pose: Pose) -> u16 {
        self.masks[pose.place.index() * 4 + pose.facing as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::layouts::kitchen;

    fn seen(x: i32, y: i32, facing: Direction) -> Vec<[usize; 2]> {
        let ring = kitchen("ring").unwrap();
        let pose = Pose { place: ring.place(x, y).unwrap(), facing };
        FieldOfView::Block.visible(&ring, pose).map(|place| ring.position(place)).collect()
    }

    #[test]
    fn the_block_is_cut_by_the_edge_and_by_nothing_else() {
        assert_eq!(seen(7, 1, Direction::East), [[8, 0], [8, 1], [8, 2]]);
        assert_eq!(seen(4, 1, Direction::North), [[3, 0], [4, 0], [5, 0]]);
        let ahead = [[5, 4], [6, 4], [7, 4], [5, 5], [6, 5], [7, 5]];
        assert_eq!(seen(6, 3, Direction::South), ahead);
        assert_eq!(seen(2, 3, Direction::West), [[0, 2], [1, 2], [0, 3], [1, 3], [0, 4], [1, 4]]);
    }

    #[test]
    fn a_cone_widens_with_distance() {
        let widths = |degrees| {
            let cone = FieldOfView::Cone(degrees);
            [1, 2, 3].map(|forward| (0..20).filter(|&lateral| cone.sees(forward, lateral)).count())
        };
        assert_eq!(widths(90), [2, 3, 4]);
        assert_eq!(widths(120), [2, 4, 6]);
        assert_eq!(widths(145), [4, 7, 10]);
        assert!(FieldOfView::Cone(120).sees(0, 1) && !FieldOfView::Cone(90).sees(0, 1));
        assert!(!FieldOfView::Cone(150).sees(-1, 0));
    }

    #[test]
    fn stations_are_seen_by_slot() {
        let ring = kitchen("ring").unwrap();
        let sight = Sight::new(&ring, FieldOfView::Block);
        let mask = |x, y, facing| sight.stations(Pose { place: ring.place(x, y).unwrap(), facing });
        assert_eq!(mask(3, 1, Direction::North), 0b00_00_11);
        assert_eq!(mask(1, 4, Direction::West), 0b01_10_00);
        assert_eq!(mask(7, 3, Direction::East), 0);
    }
}
