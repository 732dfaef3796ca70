//! A rigid body's state, and its outline in the world.

use serde::{Deserialize, Serialize};

use super::constants::{HULL_COM, HULL_CORNERS, LEG_CORNERS, Vec2};

/// Pose (as cosine and sine of its angle) and velocity of one body, taken at its centre of mass.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Body {
    pub(super) center: Vec2,
    pub(super) cos: f64,
    pub(super) sin: f64,
    pub(super) velocity: Vec2,
    pub(super) spin: f64,
}

impl Body {
    /// Places a body that does not move.
    pub(super) fn at_rest(center: Vec2, cos: f64, sin: f64) -> Self {
        Self { center, cos, sin, velocity: Vec2::zeros(), spin: 0.0 }
    }

    /// Returns whether every number of it is one.
    pub(super) fn is_finite(&self) -> bool {
        let Self { center, cos, sin, velocity, spin } = *self;
        let numbers = [center.x, center.y, cos, sin, velocity.x, velocity.y, spin];
        numbers.into_iter().all(f64::is_finite)
    }

    /// Returns the angle from another body's to this one's, in (-pi, pi].
    pub(super) fn angle_from(&self, other: &Self) -> f64 {
        let sin = self.sin * other.cos - self.cos * other.sin;
        let cos = self.cos * other.cos + self.sin * other.sin;
        libm::atan2(sin, cos)
    }

    /// Turns a vector of the body's frame into the world's.
    pub(super) fn turn(&self, v: Vec2) -> Vec2 {
        rotate(self.cos, self.sin, v)
    }

    /// Returns the hull's origin, which is what the original calls its position.
    pub(super) fn origin(&self) -> Vec2 {
        self.center + self.turn(Vec2::new(0.0, -HULL_COM))
    }

    /// Returns the body's outline, given whether it is the hull.
    pub(super) fn outline(&self, is_hull: bool) -> Outline {
        let local: &[[f64; 2]] = if is_hull { &HULL_CORNERS } else { &LEG_CORNERS };
        let mut corners = [Vec2::zeros(); HULL_CORNERS.len()];
        for (corner, &[x, y]) in corners.iter_mut().zip(local) {
            *corner = self.center + self.turn(Vec2::new(x, y));
        }
        Outline { corners, len: local.len() }
    }
}

/// Turns a vector by an angle given as cosine and sine.
pub(super) fn rotate(cos: f64, sin: f64, v: Vec2) -> Vec2 {
    Vec2::new(cos * v.x - sin * v.y, sin * v.x + cos * v.y)
}

/// The z component of a cross product.
pub(super) fn cross(a: Vec2, b: Vec2) -> f64 {
    a.x * b.y - a.y * b.x
}

/// The velocity that a spin gives to a point at `arm` from the centre.
pub(super) fn spin_velocity(spin: f64, arm: Vec2) -> Vec2 {
    Vec2::new(-spin * arm.y, spin * arm.x)
}

/// A convex polygon in the world, counter-clockwise.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outline {
    corners: [Vec2; HULL_CORNERS.len()],
    len: usize,
}

impl Outline {
    pub(super) fn corners(&self) -> &[Vec2] {
        &self.corners[..self.len]
    }

    /// Returns every edge as its start and its outward unit normal.
    pub(super) fn edges(&self) -> impl Iterator<Item = (Vec2, Vec2)> {
        let corners = self.corners();
        corners.iter().enumerate().map(|(i, &start)| {
            let along = corners[(i + 1) % corners.len()] - start;
            (start, Vec2::new(along.y, -along.x) / along.norm())
        })
    }

    /// Returns the smallest and the largest x, and the smallest y.
    pub(super) fn extent(&self) -> (f64, f64, f64) {
        let start = (f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY);
        self.corners().iter().fold(start, |(left, right, bottom), corner| {
            (left.min(corner.x), right.max(corner.x), bottom.min(corner.y))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outward_normals_point_away_from_the_centre() {
        let (sin, cos) = libm::sincos(0.7);
        let body = Body::at_rest(Vec2::new(3.0, 4.0), cos, sin);
        for is_hull in [true, false] {
            for (start, normal) in body.outline(is_hull).edges() {
                assert!((start - body.center).dot(&normal) > 0.0);
                assert!((normal.norm() - 1.0).abs() < 1e-12);
            }
        }
    }
}
