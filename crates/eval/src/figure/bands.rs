//! Means with bands: several training runs as one line, with how far they spread.

use serde::{Deserialize, Serialize};

use super::stack::{Axis, PanelStack, Stacked, extent, with_margin};
use crate::draw::{Canvas, Ink, Paint, Panel, Svg};

const STACK: PanelStack = PanelStack { panel_height: 190.0, top: 56.0, gap: 40.0 };

/// One line with its band.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Band {
    /// What it is, for the legend.
    pub label: String,
    /// Points (x, mean, lower, upper) in order; those that are no numbers are left out.
    pub points: Vec<[f64; 4]>,
    /// Published points (x, mean) of the same thing, drawn dashed.
    pub published: Vec<[f64; 2]>,
}

/// Lines of one unit in one frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BandPanel {
    /// The vertical axis' label.
    pub label: String,
    /// Fixed range of the axis, such as 0 to 1 for a rate; `None`: that of the data.
    pub range: Option<[f64; 2]>,
    /// The lines.
    pub bands: Vec<Band>,
}

/// Draws panels of lines with bands above each other, that share the horizontal axis and its number of ticks.
///
/// `id` must be unique on the page.
pub fn bands(id: &str, title: &str, x_label: &str, n_ticks: usize, panels: &[BandPanel]) -> Svg {
    let panels: Vec<BandPanel> = panels.iter().map(without_gaps).collect();
    let lines = || panels.iter().flat_map(|panel| &panel.bands);
    let xs =
        lines().flat_map(|b| b.points.iter().map(|p| p[0]).chain(b.published.iter().map(|p| p[0])));
    let axis = Axis { label: x_label, n_ticks, range: extent(xs) };
    STACK.draw(id, title, &axis, &panels)
}

impl Stacked for BandPanel {
    fn vertical(&self) -> (&str, [f64; 2]) {
        (&self.label, y_range(self))
    }

    fn labels(&self) -> Vec<&str> {
        self.bands.iter().map(|band| band.label.as_str()).collect()
    }

    fn paint(&self, canvas: &mut Canvas, frame: &Panel) {
        canvas.clipped(frame.area, |canvas| draw(canvas, frame, &self.bands));
    }
}

fn draw(canvas: &mut Canvas, frame: &Panel, bands: &[Band]) {
    for (i, band) in bands.iter().enumerate() {
        let upper = band.points.iter().map(|p| frame.at([p[0], p[3]]));
        let lower = band.points.iter().rev().map(|p| frame.at([p[0], p[2]]));
        let outline: Vec<[f64; 2]> = upper.chain(lower).collect();
        canvas.polygon(&outline, Paint::fill(Ink::series(i)).opacity(0.16));
    }
    for (i, band) in bands.iter().enumerate() {
        let ink = Ink::series(i);
        let published: Vec<[f64; 2]> = band.published.iter().map(|p| frame.at(*p)).collect();
        canvas.line(&published, Paint::stroke(ink, 1.6).dashed(5.0, 4.0));
        for point in &published {
            canvas.circle(*point, 3.2, Paint::fill(Ink::Paper).outlined(ink, 1.4));
        }
        let mean: Vec<[f64; 2]> = band.points.iter().map(|p| frame.at([p[0], p[1]])).collect();
        canvas.line(&mean, Paint::stroke(ink, 2.2));
        if mean.len() <= FEW {
            for point in &mean {
                canvas.circle(*point, 3.2, Paint::fill(ink));
            }
        }
    }
}

/// So few points are shown one by one.
const FEW: usize = 12;

fn without_gaps(panel: &BandPanel) -> BandPanel {
    let mut panel = panel.clone();
    for band in &mut panel.bands {
        band.points.retain(|p| p.iter().all(|v| v.is_finite()));
        band.published.retain(|p| p.iter().all(|v| v.is_finite()));
    }
    panel
}

fn y_range(panel: &BandPanel) -> [f64; 2] {
    let points = panel.bands.iter().flat_map(|band| &band.points).flat_map(|p| [p[2], p[3]]);
    let published = panel.bands.iter().flat_map(|band| &band.published).map(|p| p[1]);
    with_margin(panel.range, points.chain(published))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::Rasterizer;

    fn panel(points: Vec<[f64; 4]>) -> BandPanel {
        let published = vec![[0.0, 0.4], [1.0, f64::NAN]];
        let bands = vec![Band { label: "a <b>".to_owned(), points, published }];
        BandPanel { label: "success".to_owned(), range: None, bands }
    }

    #[test]
    fn bands_survive_no_data_one_point_and_points_that_are_no_numbers() {
        let odd = vec![[0.0, f64::NAN, 0.0, 1.0], [1.0, 0.5, 0.4, f64::INFINITY]];
        for points in [vec![], vec![[5.0, 0.5, 0.4, 0.6]], odd] {
            let svg = bands("b", "t & t", "steps", 5, &[panel(points)]).text;
            assert!(!svg.contains("NaN") && !svg.contains("inf") && svg.contains("a &lt;b&gt;"));
            Rasterizer::new().png(&svg, 1.0).unwrap();
        }
        Rasterizer::new().png(&bands("b", "nothing", "steps", 5, &[]).text, 1.0).unwrap();
    }

    #[test]
    fn the_axis_holds_the_bands_and_what_was_published() {
        let [low, high] = y_range(&panel(vec![[0.0, 0.5, 0.45, 0.8]]));
        assert!(low < 0.4 && high > 0.8);
    }
}
