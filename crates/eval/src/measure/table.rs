//! A table as plain text, for terminals and logs.

use serde::{Deserialize, Serialize};

/// A head and rows of equally many cells.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Table {
    /// Titles of the columns.
    pub head: Vec<String>,
    /// The rows; short ones are filled with empty cells.
    pub rows: Vec<Vec<String>>,
}

impl Table {
    /// Starts a table.
    pub fn new(head: impl IntoIterator<Item = String>) -> Self {
        Self { head: head.into_iter().collect(), rows: Vec::new() }
    }

    /// Adds a row.
    pub fn push(&mut self, cells: impl IntoIterator<Item = String>) {
        let mut row: Vec<String> = cells.into_iter().collect();
        row.resize(self.head.len(), String::new());
        self.rows.push(row);
    }

    /// Writes the table with aligned columns: the first to the left, the others to the right.
    pub fn text(&self) -> String {
        let width = |i: usize| {
            let cells = std::iter::once(&self.head).chain(&self.rows).map(|row| &row[i]);
            cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..self.head.len()).map(width).collect();
        let line = |row: &Vec<String>| {
            let cells = row.iter().zip(&widths).enumerate().map(|(i, (cell, &width))| {
                if i == 0 { format!("{cell:<width$}") } else { format!("{cell:>width$}") }
            });
            let text = cells.collect::<Vec<_>>().join("  ");
            format!("{}\n", text.trim_end())
        };
        let rule =
            "\u{2500}".repeat(widths.iter().sum::<usize>() + 2 * widths.len().saturating_sub(1));
        let rows: String = self.rows.iter().map(line).collect();
        format!("{}{rule}\n{rows}", line(&self.head))
    }

    /// Writes the table as Markdown.
    pub fn markdown(&self) -> String {
        let line = |row: &Vec<String>| {
            let cells = row.iter().map(|cell| cell.replace('|', "\\|").replace('\n', " "));
            format!("| {} |\n", cells.collect::<Vec<_>>().join(" | "))
        };
        let rule = "|---".repeat(self.head.len());
        let rows: String = self.rows.iter().map(line).collect();
        format!("{}{rule}|\n{rows}", line(&self.head))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_align_whatever_the_cells() {
        let mut table = Table::new(["", "a"].map(str::to_owned));
        table.push(["long name", "1"].map(str::to_owned));
        table.push(["−", "12.5"].map(str::to_owned));
        table.push(["short"].map(str::to_owned));
        let expected =
            "              a\n───────────────\nlong name     1\n−          12.5\nshort\n";
        assert_eq!(table.text(), expected);
    }

    #[test]
    fn a_cell_of_a_page_stays_one_cell() {
        let mut table = Table::new(["", "a"].map(str::to_owned));
        table.push(["x|y", "1\n2"].map(str::to_owned));
        assert_eq!(table.markdown(), "|  | a |\n|---|---|\n| x\\|y | 1 2 |\n");
    }
}
