//! The legend of a picture: each mark and its meaning, in as many lines as that needs.

use super::marker;
use crate::draw::{Area, Canvas, Ink, Paint, TextStyle, Weight, text_width, wrapped};
use crate::playthrough::Activity;

/// Size of the text.
const SIZE: f64 = 11.0;
/// From one entry to the next.
const GAP: f64 = 12.0;
/// From one line to the next.
const LINE: f64 = 16.0;
/// Length of a stroke.
const STROKE: f64 = 20.0;

/// A mark and its meaning.
#[derive(Clone, Copy, Debug)]
pub(super) struct LegendEntry {
    pub(super) mark: Mark,
    pub(super) label: &'static str,
}

/// What stands before its meaning.
#[derive(Clone, Copy, Debug)]
pub(super) enum Mark {
    /// A piece of a trajectory.
    Stroke(Paint),
    /// The same, with a dot in its middle.
    Dotted(Paint, Ink),
    /// The same, with a dot at its end.
    Ended(Paint, Ink),
    /// Where a message starts.
    Start,
    /// A filled area of this paint.
    Swatch(Paint),
}

impl Mark {
    /// Returns the room up to its meaning.
    fn room(self) -> f64 {
        match self {
            Self::Stroke(_) | Self::Dotted(..) => 26.0,
            Self::Ended(..) => 30.0,
            Self::Start => 16.0,
            Self::Swatch(_) => 20.0,
        }
    }

    fn draw(self, canvas: &mut Canvas, [x, y]: [f64; 2]) {
        let at = |along: f64| [x + along, y - 4.0];
        if let Self::Stroke(paint) | Self::Dotted(paint, _) | Self::Ended(paint, _) = self {
            canvas.line(&[at(0.0), at(STROKE)], paint);
        }
        match self {
            Self::Stroke(_) => {}
            Self::Dotted(_, ink) => canvas.circle(at(STROKE / 2.0), 2.6, Paint::fill(ink)),
            Self::Ended(_, ink) => canvas.circle(at(STROKE), 3.0, Paint::fill(ink)),
            Self::Start => marker::draw_marker(canvas, at(5.0)),
            Self::Swatch(paint) => canvas.rectangle(Area::new(x, y - 9.5, 14.0, 11.0), 1.0, paint),
        }
    }
}

impl LegendEntry {
    /// Explains the colour of a trajectory.
    pub(super) fn activity(activity: Activity) -> Self {
        Self { mark: Mark::Stroke(marker::stroke(activity)), label: activity.label() }
    }

    /// Returns its width with the gap behind it.
    fn width(&self) -> f64 {
        self.mark.room() + text_width(self.label, SIZE, Weight::Regular) + GAP
    }
}

/// Entries, split into lines.
#[derive(Clone, Debug)]
pub(super) struct Legend {
    lines: Vec<Vec<LegendEntry>>,
}

impl Legend {
    /// Splits entries into lines that are no wider than `room`.
    pub(super) fn new(entries: impl IntoIterator<Item = LegendEntry>, room: f64) -> Self {
        let entries: Vec<LegendEntry> = entries.into_iter().collect();
        // The gap behind the last entry of a line may lie outside.
        let lines = wrapped(entries.iter().map(LegendEntry::width).enumerate(), room + GAP);
        let line = |places: Vec<usize>| places.into_iter().map(|i| entries[i]).collect();
        Self { lines: lines.into_iter().map(line).collect() }
    }

    /// Returns the height that it needs beyond its first line.
    pub(super) fn extra_height(&self) -> f64 {
        LINE * self.lines.len().saturating_sub(1) as f64
    }

    /// Draws it, the first line on the height `y`.
    pub(super) fn draw(&self, canvas: &mut Canvas, [left, y]: [f64; 2]) {
        for (below, line) in self.lines.iter().enumerate() {
            let (mut x, y) = (left, y + LINE * below as f64);
            for entry in line {
                entry.mark.draw(canvas, [x, y]);
                let style = TextStyle::new(SIZE, Ink::Text);
                canvas.text([x + entry.mark.room(), y], entry.label, style);
                x += entry.width();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_legend_entry_that_does_not_fit_takes_another_line_and_its_height() {
        let entries = Activity::ALL.map(LegendEntry::activity);
        let whole: f64 = entries.iter().map(LegendEntry::width).sum::<f64>() - GAP;
        assert_eq!(Legend::new(entries, whole + 0.1).extra_height(), 0.0);
        let broken = Legend::new(entries, whole - 0.1);
        assert_eq!(broken.lines.iter().map(Vec::len).collect::<Vec<_>>(), [3, 1]);
        assert_eq!(broken.extra_height(), LINE);
        assert_eq!(Legend::new([], whole).extra_height(), 0.0);
    }
}
