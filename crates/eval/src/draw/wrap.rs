//! Breaking a row of things, such as a legend's entries, into lines.

/// Splits things, each given by its index and its width, into lines of indices that are no wider than `room`; what is
/// wider has a line of its own.
pub fn wrapped(widths: impl Iterator<Item = (usize, f64)>, room: f64) -> Vec<Vec<usize>> {
    let mut lines: Vec<Vec<usize>> = Vec::new();
    let mut left = 0.0;
    for (i, width) in widths {
        match lines.last_mut() {
            Some(line) if width <= left => line.push(i),
            _ => {
                lines.push(vec![i]);
                left = room;
            }
        }
        left -= width;
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_filled_in_order_and_what_is_too_wide_stands_alone() {
        let lines = |widths: &[f64]| wrapped(widths.iter().copied().enumerate(), 10.0);
        assert_eq!(lines(&[4.0, 6.0, 0.5, 9.0]), [vec![0, 1], vec![2, 3]]);
        assert_eq!(lines(&[1.0, 11.0, 1.0]), [vec![0], vec![1], vec![2]]);
        assert!(lines(&[]).is_empty());
    }
}
