//! Placing labels next to markers so that no two overlap.

use crate::draw::{Area, Weight, text_width};

/// Size of label text in pixels.
pub(super) const SIZE: f64 = 11.5;

/// Keep this much free around labels.
const MARGIN: f64 = 3.0;

/// Distances between marker and label that are tried, nearest first.
const DISTANCES: [f64; 4] = [12.0, 24.0, 40.0, 60.0];

/// Directions that are tried; to the sides first, because text is wide.
const DIRECTIONS: [[f64; 2]; 8] = [
    [1.0, 0.0],
    [-1.0, 0.0],
    [0.8, -0.6],
    [-0.8, -0.6],
    [0.8, 0.6],
    [-0.8, 0.6],
    [0.0, -1.0],
    [0.0, 1.0],
];

/// What labels must avoid.
#[derive(Clone, Debug)]
pub(super) struct Placer {
    /// Labels stay inside of it.
    pub(super) bounds: Area,
    /// They never overlap these.
    pub(super) taken: Vec<Area>,
    /// They keep off these points where possible.
    pub(super) path: Vec<[f64; 2]>,
}

impl Placer {
    /// Finds the best free place for a text near `at`, and takes it; `None` if there is none.
    pub(super) fn place(&mut self, at: [f64; 2], text: &str) -> Option<Area> {
        let (width, height) = (text_width(text, SIZE, Weight::Regular), SIZE * 1.2);
        let mut best: Option<(f64, Area)> = None;
        for (reach, distance) in DISTANCES.into_iter().enumerate() {
            for (turn, [dx, dy]) in DIRECTIONS.into_iter().enumerate() {
                let x = at[0] + dx * (distance + width / 2.0 * dx.abs().ceil());
                let y = at[1] + dy * (distance + height / 2.0);
                let area = Area::new(x - width / 2.0, y - height / 2.0, width, height);
                let [x, y] = [area.x - MARGIN, area.y - MARGIN];
                let grown = Area::new(x, y, width + 2.0 * MARGIN, height + 2.0 * MARGIN);
                let is_taken = self.taken.iter().any(|taken| taken.overlaps(&grown));
                if is_taken || !self.bounds.encloses(&grown) {
                    continue;
                }
                let hits = self.path.iter().filter(|point| inside(&grown, **point)).count();
                let cost = 4.0 * reach as f64 + 0.3 * turn as f64 + 2.0 * hits as f64;
                if best.is_none_or(|(least, _)| cost < least) {
                    best = Some((cost, area));
                }
            }
        }
        let (_, area) = best?;
        self.taken.push(area);
        Some(area)
    }
}

fn inside(area: &Area, point: [f64; 2]) -> bool {
    area.overlaps(&Area::new(point[0], point[1], 1e-6, 1e-6))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_never_overlap_and_stay_inside() {
        let bounds = Area::new(0.0, 0.0, 400.0, 300.0);
        let mut placer = Placer { bounds, taken: Vec::new(), path: vec![[200.0, 150.0]] };
        let at = |i: usize| [190.0 + 3.0 * i as f64, 150.0 + 2.0 * i as f64];
        let placed: Vec<Area> = (0..30).filter_map(|i| placer.place(at(i), "shift left")).collect();
        assert!(placed.len() >= 8, "{}", placed.len());
        for (i, a) in placed.iter().enumerate() {
            assert!(bounds.encloses(a));
            assert!(placed[i + 1..].iter().all(|b| !a.overlaps(b)));
        }
    }

    #[test]
    fn a_label_keeps_off_the_path_if_it_can() {
        let bounds = Area::new(0.0, 0.0, 400.0, 300.0);
        let path: Vec<[f64; 2]> = (0..100).map(|i| [150.0 + 2.0 * f64::from(i), 150.0]).collect();
        let mut placer = Placer { bounds, taken: Vec::new(), path };
        let area = placer.place([150.0, 150.0], "ascend").unwrap();
        assert!(!placer.path.iter().any(|point| inside(&area, *point)), "{area:?}");
    }
}
