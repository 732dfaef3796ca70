//! The legend above a panel, in as many lines as its names need.

use crate::draw::{Canvas, Ink, Paint, Panel, TextStyle, Weight, text_width, wrapped};

const SIZE: f64 = 11.5;
/// Height of a line.
const LINE: f64 = 16.0;
/// Room of a name beyond its own width: the stroke before it and the gap behind it.
const AROUND: f64 = 34.0;

/// Writes the names of a panel's series above it, line by line, each up to the right end.
pub(super) fn draw(canvas: &mut Canvas, frame: &Panel, labels: &[&str], lines: &[Vec<usize>]) {
    for (above, line) in lines.iter().rev().enumerate() {
        let y = frame.area.y - 8.0 - LINE * above as f64;
        let mut x = frame.area.right() - line.iter().map(|i| width(labels[*i])).sum::<f64>();
        for &i in line {
            let ends = [[x, y - 4.0], [x + 16.0, y - 4.0]];
            canvas.line(&ends, Paint::stroke(Ink::series(i), 2.5));
            canvas.text([x + 22.0, y], labels[i], TextStyle::new(SIZE, Ink::Text));
            x += width(labels[i]);
        }
    }
}

/// Returns the height that a legend needs beyond its first line.
pub(super) fn extra_height(lines: &[Vec<usize>]) -> f64 {
    LINE * lines.len().saturating_sub(1) as f64
}

/// Splits names, by their places, into lines that are no wider than `room`; an empty name is left out.
pub(super) fn lines(labels: &[&str], room: f64) -> Vec<Vec<usize>> {
    let named = labels.iter().enumerate().filter(|(_, label)| !label.is_empty());
    wrapped(named.map(|(i, label)| (i, width(label))), room)
}

fn width(label: &str) -> f64 {
    text_width(label, SIZE, Weight::Regular) + AROUND
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROOM: f64 = 674.0;

    #[test]
    fn names_that_do_not_fit_go_to_another_line() {
        let name = "twenty-one characters";
        assert_eq!(lines(&[name, "", name], ROOM), [vec![0, 2]]);
        assert_eq!(extra_height(&lines(&[name, name], ROOM)), 0.0);
        let broken = lines(&[name; 8], ROOM);
        assert!(broken.len() > 1 && broken.concat() == (0..8).collect::<Vec<_>>());
        let widest = broken.iter().map(|line| line.len() as f64 * width(name)).fold(0.0, f64::max);
        assert!(widest <= ROOM);
        assert_eq!(extra_height(&broken), LINE * (broken.len() - 1) as f64);
        assert!(lines(&["", ""], ROOM).is_empty() && extra_height(&[]) == 0.0);
    }
}
