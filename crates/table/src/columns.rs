//! Columns of a terminal: a letter takes one, of Chinese, Japanese and Korean two, and an accent by itself none.

use unicode_width::UnicodeWidthStr as _;

/// Returns how many columns a text takes.
///
/// # Example
///
/// ```
/// assert_eq!(["ahead", "日本", "e\u{301}"].map(leadtime_table::columns), [5, 4, 1]);
/// ```
pub fn columns(text: &str) -> usize {
    text.width()
}

/// Returns as much of a text's beginning as has room in so many columns.
///
/// # Example
///
/// ```
/// assert_eq!(leadtime_table::beginning("日本", 3), "日");
/// ```
pub fn beginning(text: &str, most: usize) -> &str {
    let ends = text.char_indices().map(|(start, c)| start + c.len_utf8());
    let end = ends.take_while(|end| columns(&text[..*end]) <= most).last();
    &text[..end.unwrap_or(0)]
}

/// Returns as much of a text's ending as has room in so many columns.
pub(crate) fn ending(text: &str, most: usize) -> &str {
    let starts = text.char_indices().rev().map(|(start, _)| start);
    let start = starts.take_while(|start| columns(&text[*start..]) <= most).last();
    &text[start.unwrap_or(text.len())..]
}

/// Fills a text with spaces up to so many columns.
///
/// # Example
///
/// ```
/// assert_eq!(leadtime_table::padded("日本", 6), "日本  ");
/// ```
pub fn padded(text: &str, width: usize) -> String {
    format!("{text}{}", " ".repeat(width.saturating_sub(columns(text))))
}
