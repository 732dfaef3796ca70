//! Who touches the ground, and how near it is.
//!
//! The contact world's own contacts come one frame late and include speculative ones, so touch is decided here, on
//! the poses at the end of the frame, by the original's test between a polygon and a terrain edge.
//!
//! The leg flags of the original are made of **events**: a contact that begins sets the flag, a contact that ends
//! clears it, whichever edge it is with. A leg that crosses a corner of the ground therefore stands there without a
//! flag. That costs reward and lets the wind blow on the ground, so it is reproduced.

use serde::{Deserialize, Serialize};

use super::body::{Body, Outline};
use super::constants::{HULL, TOUCH_GAP, Vec2};
use super::terrain::{N_POINTS, SPACING, Terrain};

/// No part of the lander is further below its hull's centre of mass.
const REACH: f64 = 0.9;
/// Slack of the nearness rule, and its growth with linear and angular speed: a frame's motion and a little more.
const NEAR_GAP: f64 = 0.05;
const NEAR_PER_SPEED: f64 = 0.021;
const NEAR_PER_SPIN: f64 = 0.3;

/// The touching state of hull and legs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Touch {
    /// Per body, one bit per terrain edge that it touches.
    edges: [u16; 3],
    /// The original's leg flags.
    pub(super) legs: [bool; 2],
    /// The hull has touched the ground: the lander has crashed.
    pub(super) hull: bool,
    /// Some part may reach the ground within a frame: contact must be simulated.
    pub(super) near: bool,
}

impl Touch {
    /// Takes in the poses at the end of a frame.
    pub(super) fn update(&mut self, bodies: &[Body; 3], terrain: &Terrain) {
        if bodies[HULL].center.y - REACH > terrain.top {
            *self = Self { hull: self.hull, ..Self::default() };
            return;
        }
        self.near = false;
        for (i, body) in bodies.iter().enumerate() {
            let outline = body.outline(i == HULL);
            let reach = NEAR_GAP
                + NEAR_PER_SPEED * (body.velocity.norm() + NEAR_PER_SPIN * body.spin.abs());
            self.near |= clearance(&outline, terrain) < reach;
            let edges = touched_edges(&outline, terrain);
            let began = edges & !self.edges[i] != 0;
            let ended = self.edges[i] & !edges != 0;
            self.edges[i] = edges;
            if i == HULL {
                self.hull |= edges != 0;
            } else if began || ended {
                self.legs[i - 1] = began && !ended;
            }
        }
    }

    pub(super) fn any(&self) -> bool {
        self.edges != [0; 3]
    }
}

/// Returns the signed clearance of a polygon over the ground: over its own corners and the ground's.
fn clearance(outline: &Outline, terrain: &Terrain) -> f64 {
    let corners = outline.corners().iter();
    let over_corners =
        corners.map(|&corner| terrain.above_edge(Terrain::edge_at(corner.x), corner));
    let (left, right, _) = outline.extent();
    let first = (left / SPACING).ceil().max(0.0) as usize;
    let last = (right / SPACING).floor().min((N_POINTS - 1) as f64);
    // At most one corner of the ground fits under a shape; none if `last` lies before `first`.
    let under = (first..N_POINTS).take_while(|&i| i as f64 <= last);
    let over_ground = under.map(|i| outside(outline, terrain.point(i)));
    over_corners.chain(over_ground).fold(f64::INFINITY, f64::min)
}

/// Returns the signed distance of a point to the nearest side of a polygon, positive outside.
fn outside(outline: &Outline, point: Vec2) -> f64 {
    let sides = outline.edges().map(|(start, normal)| (point - start).dot(&normal));
    sides.fold(f64::NEG_INFINITY, f64::max)
}

fn touched_edges(outline: &Outline, terrain: &Terrain) -> u16 {
    let (left, right, bottom) = outline.extent();
    let (first, last) = (Terrain::edge_at(left - TOUCH_GAP), Terrain::edge_at(right + TOUCH_GAP));
    let touches = |&edge: &usize| {
        let top = terrain.heights[edge].max(terrain.heights[edge + 1]);
        bottom - TOUCH_GAP < top && separation(outline, terrain, edge) <= TOUCH_GAP
    };
    (first..=last).filter(touches).fold(0, |bits, edge| bits | 1 << edge)
}

/// Computes the largest separation of a polygon and a terrain edge over the normals of both.
fn separation(outline: &Outline, terrain: &Terrain, edge: usize) -> f64 {
    let (from, to) = (terrain.point(edge), terrain.point(edge + 1));
    let corners = outline.corners().iter();
    let over_edge = corners.map(|&corner| terrain.above_edge(edge, corner));
    let sides = outline.edges();
    sides
        .map(|(start, normal)| (from - start).dot(&normal).min((to - start).dot(&normal)))
        .fold(over_edge.fold(f64::INFINITY, f64::min), f64::max)
}

#[cfg(test)]
mod tests {
    use super::super::constants::LEG_HALF;
    use super::*;

    fn leg_at(x: f64, y: f64) -> [Body; 3] {
        [[10.0, 2.85], [x, y], [10.0, 9.0]].map(|center| Body::at_rest(center.into(), 1.0, 0.0))
    }

    fn flat() -> Terrain {
        Terrain::new([2.0; N_POINTS])
    }

    #[test]
    fn a_leg_touches_within_the_skin_and_not_above_it() {
        let half = LEG_HALF[1];
        let mut touch = Touch::default();
        touch.update(&leg_at(9.0, 2.0 + half + 0.019), &flat());
        assert_eq!((touch.legs, touch.hull), ([true, false], false));
        touch.update(&leg_at(9.0, 2.0 + half + 0.021), &flat());
        assert_eq!(touch.legs, [false, false]);
        assert!(touch.near);
    }

    #[test]
    fn leaving_one_of_two_edges_clears_the_flag_although_the_leg_stands() {
        let y = 2.0 + LEG_HALF[1] + 0.01;
        let mut touch = Touch::default();
        touch.update(&leg_at(8.0, y), &flat());
        assert!(touch.legs[0], "touching the edges on both sides of x = 8");
        touch.update(&leg_at(8.5, y), &flat());
        assert!(!touch.legs[0] && touch.any());
    }

    #[test]
    fn a_peak_under_the_hull_counts_although_no_corner_is_near() {
        let mut heights = [1.0; N_POINTS];
        heights[5] = 3.0;
        let mut bodies = leg_at(2.0, 8.0);
        bodies[HULL].center = Vec2::new(10.0, 3.0 + 10.0 / 30.0 + 0.101_307_19 + 0.01);
        let mut touch = Touch::default();
        touch.update(&bodies, &Terrain::new(heights));
        assert!(touch.hull && touch.near);
    }
}
