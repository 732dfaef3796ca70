//! Danger zones: rectangles in the units of observed positions.

use serde::{Deserialize, Serialize};

/// A rectangle where a lander must not be.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Zone {
    /// Left side, in observed units.
    pub x0: f64,
    /// Right side, greater than `x0`.
    pub x1: f64,
    /// Lower side, in observed units.
    pub y0: f64,
    /// Upper side, greater than `y0`.
    pub y1: f64,
}

/// The three zones of the task: near the start, above the pad, to its right.
pub const DEFAULT_ZONES: [Zone; 3] = [
    Zone { x0: -1.5, x1: -0.4, y0: 0.95, y1: 1.1 },
    Zone { x0: -0.3, x1: 0.3, y0: 0.5, y1: 0.65 },
    Zone { x0: 0.3, x1: 1.5, y0: 0.4, y1: 0.65 },
];

/// How far from the pad a place of the map may be: a hundred times as far as one can fly sideways.
pub(super) const FARTHEST_PLACE: f64 = 100.0;

impl Zone {
    /// Returns whether its sides are numbers in the right order, and within reach.
    pub fn is_proper(&self) -> bool {
        let sides = [self.x0, self.x1, self.y0, self.y1];
        let within = sides.iter().all(|side| side.abs() <= FARTHEST_PLACE);
        within && self.x0 < self.x1 && self.y0 < self.y1
    }

    /// Returns whether a point lies in it; the border belongs to it.
    pub fn contains(&self, [x, y]: [f64; 2]) -> bool {
        (self.x0..=self.x1).contains(&x) && (self.y0..=self.y1).contains(&y)
    }

    /// Computes the distance from a point; 0 inside.
    pub fn distance(&self, [x, y]: [f64; 2]) -> f64 {
        let dx = (self.x0 - x).max(x - self.x1).max(0.0);
        let dy = (self.y0 - y).max(y - self.y1).max(0.0);
        libm::sqrt(dx * dx + dy * dy)
    }

    /// Computes the distances from a point to the four sides: left, right, lower, upper.
    pub fn side_distances(&self, point: [f64; 2]) -> [f64; 4] {
        let Self { x0, x1, y0, y1 } = *self;
        let side = |x0, x1, y0, y1| Self { x0, x1, y0, y1 }.distance(point);
        [side(x0, x0, y0, y1), side(x1, x1, y0, y1), side(x0, x1, y0, y0), side(x0, x1, y1, y1)]
    }

    /// Returns whether it is another zone, moved by at most `reach` along x and y.
    pub(super) fn is_moved(&self, original: &Self, reach: [f64; 2]) -> bool {
        // What is moved is rounded; sides are a hundred at most.
        const ROUNDING: f64 = 1e-9;
        let [dx, dy] = [self.x0 - original.x0, self.y0 - original.y0];
        let moved = original.moved(dx, dy);
        let grown = [self.x1 - moved.x1, self.y1 - moved.y1];
        dx.abs() <= reach[0] + ROUNDING
            && dy.abs() <= reach[1] + ROUNDING
            && grown.iter().all(|side| side.abs() <= ROUNDING)
    }

    pub(super) fn moved(&self, dx: f64, dy: f64) -> Self {
        Self { x0: self.x0 + dx, x1: self.x1 + dx, y0: self.y0 + dy, y1: self.y1 + dy }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ZONE: Zone = Zone { x0: 0.0, x1: 2.0, y0: 0.0, y1: 1.0 };

    #[test]
    fn distances_are_to_the_nearest_point() {
        assert_eq!(ZONE.distance([1.0, 0.5]), 0.0);
        assert_eq!(ZONE.distance([1.0, 1.5]), 0.5);
        assert_eq!(ZONE.distance([-3.0, 5.0]), 5.0);
        assert_eq!(ZONE.side_distances([0.5, 0.25]), [0.5, 1.5, 0.25, 0.75]);
        // The border is inside.
        assert!(ZONE.contains([0.0, 1.0]) && !ZONE.contains([0.0, 1.001]));
    }

    #[test]
    fn a_zone_has_an_inside() {
        assert!(ZONE.is_proper());
        assert!(!Zone { x0: 2.0, ..ZONE }.is_proper());
        assert!(!Zone { y1: f64::NAN, ..ZONE }.is_proper());
        assert!(!Zone { x0: -1e12, ..ZONE }.is_proper());
    }

    #[test]
    fn a_zone_is_moved_as_a_whole_and_no_farther_than_it_may_be() {
        let is_moved = |zone: Zone| zone.is_moved(&ZONE, [0.1, 0.0]);
        assert!(
            is_moved(ZONE) && is_moved(ZONE.moved(0.1, 0.0)) && is_moved(ZONE.moved(-0.07, 0.0))
        );
        assert!(!is_moved(ZONE.moved(0.11, 0.0)) && !is_moved(ZONE.moved(0.0, 0.01)));
        let no_number = Zone { x1: f64::NAN, ..ZONE };
        assert!(!is_moved(Zone { x1: 2.05, ..ZONE }) && !is_moved(no_number));
    }
}
