//! Curves over training: panels above each other that share the horizontal axis.

use serde::{Deserialize, Serialize};

use super::stack::{Axis, PanelStack, Stacked, extent, with_margin};
use crate::draw::{Anchor, Canvas, Ink, Paint, Panel, Svg, TextStyle};

const STACK: PanelStack = PanelStack { panel_height: 170.0, top: 34.0, gap: 32.0 };

/// One quantity over training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Series {
    /// What it is, for the legend; empty if the panel's label suffices.
    pub label: String,
    /// Points (environment steps, value) in order; points that are no numbers are left out.
    pub points: Vec<[f64; 2]>,
}

/// Quantities of one unit, drawn into one frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CurvePanel {
    /// The vertical axis' label.
    pub label: String,
    /// Fixed range of the axis, such as 0 to 1 for a rate; `None`: that of the data.
    pub range: Option<[f64; 2]>,
    /// A level to compare with, such as the unaided person's, and its name.
    pub reference: Option<(f64, String)>,
    /// The quantities.
    pub series: Vec<Series>,
}

/// Averages every point with its neighbours, `half` on each side where there are as many.
///
/// The window shrinks towards both ends and stays centred, so that a curve does not lag behind its data.
pub fn smoothed(points: &[[f64; 2]], half: usize) -> Vec<[f64; 2]> {
    let n = points.len();
    let average = |i: usize| {
        let reach = half.min(i).min(n - 1 - i);
        let window = &points[i - reach..=i + reach];
        let sum: f64 = window.iter().map(|p| p[1]).sum();
        [points[i][0], sum / window.len() as f64]
    };
    (0..n).map(average).collect()
}

/// Draws panels of curves above each other. `id` must be unique on the page.
pub fn curves(id: &str, title: &str, x_label: &str, panels: &[CurvePanel]) -> Svg {
    let panels: Vec<CurvePanel> = panels.iter().map(without_gaps).collect();
    let range = extent(points(&panels).map(|p| p[0]));
    let axis = Axis { label: x_label, n_ticks: 7, range };
    STACK.draw(id, title, &axis, &panels)
}

impl Stacked for CurvePanel {
    fn vertical(&self) -> (&str, [f64; 2]) {
        (&self.label, y_range(self))
    }

    fn labels(&self) -> Vec<&str> {
        self.series.iter().map(|series| series.label.as_str()).collect()
    }

    fn paint(&self, canvas: &mut Canvas, frame: &Panel) {
        draw_panel(canvas, frame, self);
    }
}

fn without_gaps(panel: &CurvePanel) -> CurvePanel {
    let mut panel = panel.clone();
    for series in &mut panel.series {
        series.points.retain(|p| p.iter().all(|v| v.is_finite()));
    }
    panel
}

fn points(panels: &[CurvePanel]) -> impl Iterator<Item = &[f64; 2]> {
    panels.iter().flat_map(|panel| &panel.series).flat_map(|series| &series.points)
}

/// Takes the fixed range, or that of the data and the reference.
fn y_range(panel: &CurvePanel) -> [f64; 2] {
    let values = panel.series.iter().flat_map(|s| &s.points).map(|point| point[1]);
    with_margin(panel.range, values.chain(panel.reference.iter().map(|(level, _)| *level)))
}

fn draw_panel(canvas: &mut Canvas, frame: &Panel, panel: &CurvePanel) {
    canvas.clipped(frame.area, |canvas| {
        if let Some((level, _)) = &panel.reference {
            let y = frame.y.at(*level);
            let ends = [[frame.area.x, y], [frame.area.right(), y]];
            canvas.line(&ends, Paint::stroke(Ink::Muted, 1.2).dashed(5.0, 4.0));
        }
        for (i, series) in panel.series.iter().enumerate() {
            let half = (series.points.len() / 40).max(1);
            let place = |points: &[[f64; 2]]| -> Vec<[f64; 2]> {
                points.iter().map(|p| frame.at(*p)).collect()
            };
            let ink = Ink::series(i);
            let raw = thinned(&place(&series.points));
            canvas.line(&raw, Paint::stroke(ink, 1.0).opacity(0.35));
            let smooth = thinned(&place(&smoothed(&series.points, half)));
            canvas.line(&smooth, Paint::stroke(ink, 2.2));
            if let [only] = series.points.as_slice() {
                canvas.circle(frame.at(*only), 3.0, Paint::fill(ink));
            }
        }
    });
    if let Some((level, name)) = &panel.reference {
        // On the right, where a curve that has learned is far from where it began.
        let style = TextStyle::new(11.0, Ink::Muted).anchored(Anchor::End).haloed(Ink::Paper);
        canvas.text([frame.area.right() - 6.0, frame.y.at(*level) - 5.0], name, style);
    }
}

/// Keeps the file small: at most about two points per pixel.
fn thinned(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let every = points.len() / 1500 + 1;
    let last = points.len().saturating_sub(1);
    let kept = points.iter().enumerate().filter(|(i, _)| i % every == 0 || *i == last);
    kept.map(|(_, point)| *point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::Rasterizer;

    fn panel(points: Vec<[f64; 2]>) -> CurvePanel {
        let series = vec![Series { label: "a <b>".to_owned(), points }];
        let reference = Some((0.1, "unaided & alone".to_owned()));
        CurvePanel { label: "success".to_owned(), range: Some([0.0, 1.0]), reference, series }
    }

    #[test]
    fn smoothing_keeps_a_straight_line_and_halves_noise() {
        let line: Vec<[f64; 2]> = (0..9).map(|i| [f64::from(i), 2.0 * f64::from(i)]).collect();
        for (got, expected) in smoothed(&line, 3).iter().zip(&line) {
            assert!((got[1] - expected[1]).abs() < 1e-12);
        }
        let zigzag: Vec<[f64; 2]> = (0..9).map(|i| [f64::from(i), f64::from(i % 2)]).collect();
        let middle = smoothed(&zigzag, 2)[4];
        assert_eq!(middle, [4.0, 0.4]);
    }

    #[test]
    fn curves_survive_no_data_one_point_and_points_that_are_no_numbers() {
        let odd = vec![[0.0, f64::NAN], [1.0, 0.5], [f64::INFINITY, 0.2]];
        for points in [vec![], vec![[5.0, 0.5]], odd] {
            let svg = curves("c", "t & t", "steps", &[panel(points)]).text;
            assert!(!svg.contains("NaN") && !svg.contains("inf"));
            Rasterizer::new().png(&svg, 1.0).unwrap();
        }
        Rasterizer::new().png(&curves("c", "nothing", "steps", &[]).text, 1.0).unwrap();
    }

    #[test]
    fn names_are_escaped() {
        let svg = curves("c", "t", "steps", &[panel(vec![[0.0, 0.1], [1.0, 0.2]])]).text;
        assert!(svg.contains("a &lt;b&gt;") && svg.contains("unaided &amp; alone"));
    }
}
