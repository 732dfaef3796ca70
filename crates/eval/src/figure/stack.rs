//! Panels above each other that share the horizontal axis.

use super::legend;
use crate::draw::{Area, Canvas, Ink, Panel, Svg, TextStyle};

const WIDTH: f64 = 760.0;
const LEFT: f64 = 68.0;
const RIGHT: f64 = 18.0;
const BOTTOM: f64 = 46.0;
/// Width of every panel.
const PLOT_WIDTH: f64 = WIDTH - LEFT - RIGHT;

/// A panel of a stack.
pub(super) trait Stacked {
    /// Returns the vertical axis' label and range.
    fn vertical(&self) -> (&str, [f64; 2]);

    /// Lists the names of its series, for the legend; an empty one is left out.
    fn labels(&self) -> Vec<&str>;

    /// Draws it into its frame.
    fn paint(&self, canvas: &mut Canvas, frame: &Panel);
}

/// How panels stand above each other.
pub(super) struct PanelStack {
    pub(super) panel_height: f64,
    /// Room above the first panel, with a legend of one line.
    pub(super) top: f64,
    /// Room between two, likewise.
    pub(super) gap: f64,
}

/// The horizontal axis: its name, its number of ticks, what it holds.
pub(super) struct Axis<'a> {
    pub(super) label: &'a str,
    pub(super) n_ticks: usize,
    pub(super) range: Option<[f64; 2]>,
}

impl PanelStack {
    /// Draws frames with their axes and legends, and into each its panel.
    pub(super) fn draw(
        &self,
        id: &str,
        title: &str,
        axis: &Axis<'_>,
        panels: &[impl Stacked],
    ) -> Svg {
        let legends: Vec<_> =
            panels.iter().map(|panel| legend::lines(&panel.labels(), PLOT_WIDTH)).collect();
        let room = legends.iter().map(|lines| legend::extra_height(lines)).fold(0.0, f64::max);
        let (above, gap) = (self.top + room, self.gap + room);
        let n = panels.len().max(1) as f64;
        let height = above + n * self.panel_height + (n - 1.0) * gap + BOTTOM;
        let mut canvas = Canvas::new(id, WIDTH, height);
        canvas.text([LEFT, 20.0], title, TextStyle::new(14.0, Ink::Text).bold());
        let x_range = axis.range.unwrap_or([0.0, 1.0]);
        for (i, (panel, lines)) in panels.iter().zip(&legends).enumerate() {
            let top = above + i as f64 * (self.panel_height + gap);
            let area = Area::new(LEFT, top, PLOT_WIDTH, self.panel_height);
            let (label, y_range) = panel.vertical();
            let frame = Panel::new(area, x_range, y_range);
            frame.draw_y(&mut canvas, 4, label);
            let last = i + 1 == panels.len();
            frame.draw_x(&mut canvas, axis.n_ticks, last.then_some(axis.label));
            panel.paint(&mut canvas, &frame);
            legend::draw(&mut canvas, &frame, &panel.labels(), lines);
        }
        canvas.finish(title)
    }
}

/// Returns the least and the greatest of some values.
pub(super) fn extent(values: impl Iterator<Item = f64>) -> Option<[f64; 2]> {
    values.fold(None, |range: Option<[f64; 2]>, value| {
        let [low, high] = range.unwrap_or([value, value]);
        Some([low.min(value), high.max(value)])
    })
}

/// Takes the fixed range, or that of the data, with a small margin.
pub(super) fn with_margin(fixed: Option<[f64; 2]>, values: impl Iterator<Item = f64>) -> [f64; 2] {
    let [low, high] = fixed.or_else(|| extent(values)).unwrap_or([0.0, 1.0]);
    let margin = 0.05 * (high - low);
    [low - margin, high + margin]
}
