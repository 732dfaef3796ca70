//! The legend above a panel, in as many lines as its names need.

use super::stack::PLOT_WIDTH;
use crate::draw::{Canvas, Ink, Paint, Panel, TextStyle, Weight, text_width};

const SIZE: f64 = 11.5;
/// Height of a line.
const LINE: f64 = 16.0;
/// Room of a name beyond its own width: the stroke before it and the gap behind it.
const AROUND: f64 = 34.0;

/// Writes the names of a panel's series above it, each line up to the right end; an empty name is left out.
pub(super) fn draw(canvas: &mut Canvas, frame: &Panel, labels: &[&str]) {
    let lines = lines(labels);
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
pub(super) fn extra_height(labels: &[&str]) -> f64 {
    LINE * lines(labels).len().saturating_sub(1) as f64
}

/// Splits names, by their places, into lines that are no wider than a panel.
fn lines(labels: &[&str]) -> Vec<Vec<usize>> {
    let mut lines: Vec<Vec<usize>> = Vec::new();
    let mut room = 0.0;
    for (i, label) in labels.iter().enumerate().filter(|(_, label)| !label.is_empty()) {
        let width = width(label);
        match lines.last_mut() {
            Some(line) if width <= room => line.push(i),
            _ => {
                lines.push(vec![i]);
                room = PLOT_WIDTH;
            }
        }
        room -= width;
    }
    lines
}

fn width(label: &str) -> f64 {
    text_width(label, SIZE, Weight::Regular) + AROUND
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_do_not_fit_go_to_another_line() {
        let name = "twenty-one characters";
        assert_eq!(lines(&[name, "", name]), [vec![0, 2]]);
        assert_eq!(extra_height(&[name, name]), 0.0);
        let many = [name; 8];
        let broken = lines(&many);
        assert!(broken.len() > 1 && broken.concat() == (0..8).collect::<Vec<_>>());
        let widest = broken.iter().map(|line| line.len() as f64 * width(name)).fold(0.0, f64::max);
        assert!(widest <= PLOT_WIDTH);
        assert_eq!(extra_height(&many), LINE * (broken.len() - 1) as f64);
    }

    #[test]
    fn a_name_wider_than_the_panel_has_a_line_of_its_own() {
        let long = "x".repeat(400);
        assert_eq!(lines(&["a", &long, "b"]), [vec![0], vec![1], vec![2]]);
        assert!(lines(&["", ""]).is_empty() && extra_height(&[]) == 0.0);
    }
}
