//! Panels above each other that share the horizontal axis.

use crate::draw::{Area, Canvas, Ink, Panel, TextStyle};

const WIDTH: f64 = 760.0;
const LEFT: f64 = 68.0;
const RIGHT: f64 = 18.0;
const BOTTOM: f64 = 46.0;
/// Width of every panel.
pub(super) const PLOT_WIDTH: f64 = WIDTH - LEFT - RIGHT;

/// How panels stand above each other.
pub(super) struct Stack {
    pub(super) panel_height: f64,
    /// Room above the first panel.
    pub(super) top: f64,
    /// Room between two.
    pub(super) gap: f64,
}

/// The horizontal axis: its name, its number of ticks, what it holds.
pub(super) struct Axis<'a> {
    pub(super) label: &'a str,
    pub(super) n_ticks: usize,
    pub(super) range: Option<[f64; 2]>,
}

impl Stack {
    /// Makes room above every panel.
    pub(super) fn with_room(self, height: f64) -> Self {
        Self { top: self.top + height, gap: self.gap + height, ..self }
    }

    /// Draws frames with their axes, and into each what `paint` makes of its panel; `vertical` names a panel's axis and
    /// says what it holds.
    pub(super) fn draw<P>(
        &self,
        [id, title]: [&str; 2],
        axis: &Axis<'_>,
        panels: &[P],
        vertical: impl Fn(&P) -> (&str, [f64; 2]),
        paint: impl Fn(&mut Canvas, &Panel, &P),
    ) -> String {
        let n = panels.len().max(1) as f64;
        let height = self.top + n * self.panel_height + (n - 1.0) * self.gap + BOTTOM;
        let mut canvas = Canvas::new(id, WIDTH, height);
        canvas.text([LEFT, 20.0], title, TextStyle::new(14.0, Ink::Text).bold());
        let x_range = axis.range.unwrap_or([0.0, 1.0]);
        for (i, panel) in panels.iter().enumerate() {
            let top = self.top + i as f64 * (self.panel_height + self.gap);
            let area = Area::new(LEFT, top, PLOT_WIDTH, self.panel_height);
            let (label, y_range) = vertical(panel);
            let frame = Panel::new(area, x_range, y_range);
            frame.draw_y(&mut canvas, 4, label);
            let last = i + 1 == panels.len();
            frame.draw_x(&mut canvas, axis.n_ticks, last.then_some(axis.label));
            paint(&mut canvas, &frame, panel);
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
