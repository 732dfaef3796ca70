//! Lines for a width: broken between words, or cut between parts.

use crate::columns;

/// Breaks a line so that no piece takes more than `width` columns, unless a word has; all but the first are indented.
///
/// # Example
///
/// ```
/// assert_eq!(leadtime_table::wrapped("  a: one, two", 10, 4), "  a: one,\n    two");
/// ```
pub fn wrapped(line: &str, width: usize, indent: usize) -> String {
    let mut text = String::new();
    let mut used = 0;
    // What stands in front of the first word belongs to it.
    let start = line.len() - line.trim_start().len();
    let n_first = line[start..].find(' ').map_or(line.len(), |at| start + at);
    let (first, rest) = line.split_at(n_first);
    for word in std::iter::once(first).chain(rest.split_whitespace()) {
        let n = columns(word);
        if text.is_empty() {
            used = n;
        } else if used + 1 + n <= width {
            text.push(' ');
            used += 1 + n;
        } else {
            text.push('\n');
            text.extend(std::iter::repeat_n(' ', indent));
            used = indent + n;
        }
        text.push_str(word);
    }
    text
}

/// Joins the first parts that have room on one line, with two spaces between them.
///
/// # Example
///
/// ```
/// let line = |width| leadtime_table::fitted(["300 updates", "1m left"].map(str::to_owned), width);
/// assert_eq!([line(80), line(19), line(3)], ["300 updates  1m left", "300 updates", ""]);
/// ```
pub fn fitted(parts: impl IntoIterator<Item = String>, width: usize) -> String {
    let mut text = String::new();
    for part in parts {
        let gap = if text.is_empty() { "" } else { "  " };
        if columns(&text) + gap.len() + columns(&part) > width {
            break;
        }
        text = format!("{text}{gap}{part}");
    }
    text
}
