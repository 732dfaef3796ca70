//! A report as tables: what was compared, row by row, and what is beyond its bound.

/// One table of a report.
#[derive(Clone, Debug, Default)]
pub struct Section {
    /// What was compared.
    pub title: String,
    /// Titles of the columns.
    pub head: Vec<&'static str>,
    /// The cells, row by row.
    pub rows: Vec<Vec<String>>,
    /// What the rows have no room for.
    pub notes: Vec<String>,
}

/// Marks what is beyond its bound.
pub(crate) fn mark(passed: bool) -> String {
    if passed { String::new() } else { "beyond the bound".to_owned() }
}
