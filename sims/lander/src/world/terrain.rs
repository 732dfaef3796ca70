//! The ground: ten straight edges between eleven heights, level at the pad.

use leadtime_numerics::Pcg64;
use serde::{Deserialize, Serialize};

use super::constants::{HEIGHT, Vec2};

pub(super) const N_POINTS: usize = 11;
/// Distance between them along x.
pub(super) const SPACING: f64 = 2.0;
const N_EDGES: usize = N_POINTS - 1;

/// The ground of one episode.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Terrain {
    /// Heights at x = 0, 2, ... 20.
    pub(super) heights: [f64; N_POINTS],
    /// The largest of them.
    pub(super) top: f64,
}

impl Terrain {
    /// Draws a ground as the original does: twelve heights, the pad's levelled, three-point smoothing.
    ///
    /// The smoothing's weight is 0.33, not a third, so the pad lies at 3.30 and not at 3.33; and the point before
    /// the first one is the twelfth height, by Python's negative index.
    pub(super) fn draw(rng: &mut Pcg64) -> Self {
        let mut raw: [f64; N_POINTS + 1] = std::array::from_fn(|_| rng.uniform(0.0, HEIGHT / 2.0));
        raw[3..=7].fill(HEIGHT / 4.0);
        Self::new(std::array::from_fn(|i| {
            let before = if i == 0 { raw[N_POINTS] } else { raw[i - 1] };
            0.33 * (before + raw[i] + raw[i + 1])
        }))
    }

    pub(super) fn new(heights: [f64; N_POINTS]) -> Self {
        Self { heights, top: heights.iter().fold(0.0, |top, &height| height.max(top)) }
    }

    /// Returns whether it can have been drawn.
    pub(super) fn is_possible(&self) -> bool {
        let drawn = 0.0..=HEIGHT / 2.0;
        self.heights.iter().all(|height| drawn.contains(height)) && *self == Self::new(self.heights)
    }

    pub(super) fn point(&self, i: usize) -> Vec2 {
        Vec2::new(SPACING * i as f64, self.heights[i])
    }

    /// Returns the edge under (or nearest to) `x`.
    pub(super) fn edge_at(x: f64) -> usize {
        // A float-to-integer cast saturates, so everything left of the world is edge 0.
        ((x / SPACING) as usize).min(N_EDGES - 1)
    }

    /// Returns the signed distance of a point above the line through an edge.
    pub(super) fn above_edge(&self, edge: usize, point: Vec2) -> f64 {
        let slope = (self.heights[edge + 1] - self.heights[edge]) / SPACING;
        let start = self.point(edge);
        (point.y - start.y - slope * (point.x - start.x)) / (1.0 + slope * slope).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pad_is_level_and_the_first_height_wraps_round_to_the_twelfth_draw() {
        let terrain = Terrain::draw(&mut Pcg64::seed_from_u64(0));
        assert!(terrain.heights[4..=6].iter().all(|height| (height - 3.3).abs() < 1e-12));
        // The draws of seed 0 as recorded from the original: see the conformance traces.
        let (first, second, twelfth) =
            (4.246_411_248_809_696, 1.798_578_091_759_155_1, 0.018_256_667_800_987_3);
        assert!((terrain.heights[0] - 0.33 * (first + second + twelfth)).abs() < 1e-9);
    }

    #[test]
    fn every_x_has_an_edge() {
        let edges = [-1.0, 0.0, 1.99, 2.0, 19.9, 20.0, 25.0].map(Terrain::edge_at);
        assert_eq!(edges, [0, 0, 0, 1, 9, 9, 9]);
    }
}
