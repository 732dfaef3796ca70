//! Axes: nice ticks, scales from data to pixels, and the frame of a chart.

use super::canvas::{Anchor, Area, Canvas, Paint, TextStyle, trimmed};
use super::palette::Ink;

const TICK_SIZE: f64 = 11.0;

/// Returns round numbers that cover `low..high`, about `n` of them, in steps of 1, 2 or 5 times a power of ten.
///
/// An empty or broken range gives a single tick.
fn nice_ticks(low: f64, high: f64, n: usize) -> Vec<f64> {
    let width = high - low;
    if !width.is_finite() || width <= 0.0 {
        return vec![if low.is_finite() { low } else { 0.0 }];
    }
    let raw = width / n.max(1) as f64;
    let power = 10_f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|s| *s >= raw * 0.999);
    let step = step.unwrap_or(10.0 * power);
    let (first, last) = ((low / step - 1e-9).ceil() as i64, (high / step + 1e-9).floor() as i64);
    (first..=last).map(|i| i as f64 * step).collect()
}

/// Writes a number for an axis or a table: `250`, `1.5k`, `2M`, `0.25`.
pub fn compact(value: f64) -> String {
    let (scaled, suffix) = match value.abs() {
        a if a >= 1e9 => (value / 1e9, "G"),
        a if a >= 1e6 => (value / 1e6, "M"),
        a if a >= 1e4 => (value / 1e3, "k"),
        _ => (value, ""),
    };
    let digits = match scaled.abs() {
        a if a >= 100.0 => 0,
        a if a >= 10.0 => 1,
        a if a >= 0.1 || a == 0.0 => 2,
        _ => 3,
    };
    format!("{}{suffix}", trimmed(&format!("{scaled:.digits$}")).replace('-', "\u{2212}"))
}

/// Maps data to pixels along one direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    low: f64,
    high: f64,
    start: f64,
    end: f64,
}

impl Scale {
    /// Maps the lowest and highest value to two pixels; an empty range is widened.
    pub fn new(data: [f64; 2], pixels: [f64; 2]) -> Self {
        let [mut low, mut high] = data.map(|v| if v.is_finite() { v } else { 0.0 });
        if high - low < 1e-12 {
            let margin = if low == 0.0 { 1.0 } else { low.abs() * 0.1 };
            (low, high) = (low - margin, low + margin);
        }
        Self { low, high, start: pixels[0], end: pixels[1] }
    }

    /// Returns the pixel of a value.
    pub fn at(&self, value: f64) -> f64 {
        self.start + (value - self.low) / (self.high - self.low) * (self.end - self.start)
    }
}

/// The frame of a chart: an area with two scales.
#[derive(Clone, Copy, Debug)]
pub struct Panel {
    /// The part of the canvas, in pixels.
    pub area: Area,
    /// The horizontal axis, from data to pixels.
    pub x: Scale,
    /// The vertical axis, from data to pixels.
    pub y: Scale,
}

impl Panel {
    /// Spans an area with data ranges.
    pub fn new(area: Area, x_range: [f64; 2], y_range: [f64; 2]) -> Self {
        let x = Scale::new(x_range, [area.x, area.right()]);
        let y = Scale::new(y_range, [area.bottom(), area.y]);
        Self { area, x, y }
    }

    /// Returns the pixel of a data point.
    pub fn at(&self, point: [f64; 2]) -> [f64; 2] {
        [self.x.at(point[0]), self.y.at(point[1])]
    }

    /// Draws horizontal grid lines with their numbers, and the vertical axis' label.
    pub fn draw_y(&self, canvas: &mut Canvas, n_ticks: usize, label: &str) {
        for tick in nice_ticks(self.y.low, self.y.high, n_ticks) {
            let y = self.y.at(tick);
            let ends = [[self.area.x, y], [self.area.right(), y]];
            canvas.line(&ends, Paint::stroke(Ink::Grid, 1.0));
            let style = TextStyle::new(TICK_SIZE, Ink::Muted).anchored(Anchor::End);
            canvas.text([self.area.x - 7.0, y + 4.0], &compact(tick), style);
        }
        let middle = self.area.y + self.area.height / 2.0;
        let style = TextStyle::new(12.0, Ink::Muted).anchored(Anchor::Middle);
        canvas.text_upward([self.area.x - 48.0, middle], label, style);
    }

    /// Draws the horizontal axis' line and ticks; numbers and label are for the lowest of several panels.
    pub fn draw_x(&self, canvas: &mut Canvas, n_ticks: usize, label: Option<&str>) {
        let bottom = self.area.bottom();
        let ends = [[self.area.x, bottom], [self.area.right(), bottom]];
        canvas.line(&ends, Paint::stroke(Ink::Axis, 1.0));
        let style = TextStyle::new(TICK_SIZE, Ink::Muted).anchored(Anchor::Middle);
        for tick in nice_ticks(self.x.low, self.x.high, n_ticks) {
            let x = self.x.at(tick);
            canvas.line(&[[x, bottom], [x, bottom + 4.0]], Paint::stroke(Ink::Axis, 1.0));
            if label.is_some() {
                canvas.text([x, bottom + 17.0], &compact(tick), style);
            }
        }
        if let Some(label) = label {
            let middle = self.area.x + self.area.width / 2.0;
            canvas.text([middle, bottom + 35.0], label, TextStyle { size: 12.0, ..style });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(nice_ticks(0.0, 1.0, 2), [0.0, 0.5, 1.0]);
        assert_eq!(nice_ticks(-317.0, 280.0, 4), [-200.0, 0.0, 200.0]);
        assert_eq!(nice_ticks(3.0, 3.0, 5), [3.0]);
        assert_eq!(nice_ticks(f64::NAN, 3.0, 5), [0.0]);
    }

    #[test]
    fn numbers_are_written_short() {
        let values = [0.0, 0.25, -120.0, 1500.0, 15_000.0, 2_500_000.0, 0.012];
        let texts = ["0", "0.25", "−120", "1500", "15k", "2.5M", "0.012"];
        assert_eq!(values.map(compact), texts);
    }

    #[test]
    fn a_panel_puts_low_values_at_the_bottom_and_widens_an_empty_range() {
        let panel = Panel::new(Area::new(10.0, 20.0, 100.0, 50.0), [0.0, 10.0], [-1.0, 1.0]);
        assert_eq!(panel.at([0.0, -1.0]), [10.0, 70.0]);
        assert_eq!(panel.at([10.0, 1.0]), [110.0, 20.0]);
        assert_eq!(Scale::new([5.0, 5.0], [0.0, 100.0]).at(5.0), 50.0);
    }
}
