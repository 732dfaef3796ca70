//! Head and rows, and their three forms.

use crate::escape;

/// A head and rows of equally many cells.
///
/// # Example
///
/// ```
/// use leadtime_table::Table;
///
/// let mut table = Table::new(["run", "steps"]);
/// table.push(["one", "2048"]);
/// assert_eq!(table.text(), "run  steps\n──────────\none   2048\n");
/// assert_eq!(table.markdown(), "| run | steps |\n|---|---|\n| one | 2048 |\n");
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Table {
    head: Vec<TableCell>,
    rows: Vec<Vec<TableCell>>,
    /// Columns whose text is aligned to the left.
    left: Vec<usize>,
}

/// What stands in one place of a table.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TableCell {
    text: String,
    /// Follows the text, and stands back where the form allows it.
    note: String,
}

impl TableCell {
    /// Writes a value with a note that stands back, such as a mean with its interval.
    pub fn noted(text: impl Into<String>, note: impl Into<String>) -> Self {
        Self { text: text.into(), note: note.into() }
    }

    fn plain(&self) -> String {
        let gap = if self.note.is_empty() { "" } else { " " };
        format!("{}{gap}{}", self.text, self.note)
    }

    fn html(&self) -> String {
        let (text, note) = (escape(&self.text), escape(&self.note));
        if note.is_empty() { text.into_owned() } else { format!("{text} <span>{note}</span>") }
    }
}

impl<T: Into<String>> From<T> for TableCell {
    fn from(text: T) -> Self {
        Self::noted(text, "")
    }
}

impl Table {
    /// Starts a table whose first column is aligned to the left and whose others are aligned to the right.
    ///
    /// A table with an empty head has none where the form allows it.
    pub fn new<C: Into<TableCell>>(head: impl IntoIterator<Item = C>) -> Self {
        Self { head: head.into_iter().map(Into::into).collect(), rows: Vec::new(), left: vec![0] }
    }

    /// Aligns these columns to the left, and all others to the right.
    pub fn left(self, columns: &[usize]) -> Self {
        Self { left: columns.to_vec(), ..self }
    }

    /// Adds a row; a short one is filled with empty cells.
    pub fn push<C: Into<TableCell>>(&mut self, cells: impl IntoIterator<Item = C>) {
        let mut row: Vec<TableCell> = cells.into_iter().map(Into::into).collect();
        row.resize(self.head.len(), TableCell::default());
        self.rows.push(row);
    }

    /// Writes the table as plain text; every column is as wide as its widest cell.
    pub fn text(&self) -> String {
        let plain = |row: &Vec<TableCell>| row.iter().map(TableCell::plain).collect::<Vec<_>>();
        let head = plain(&self.head);
        let rows: Vec<Vec<String>> = self.rows.iter().map(plain).collect();
        let all = || std::iter::once(&head).chain(&rows);
        let width = |i: usize| all().map(|row| row[i].chars().count()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..head.len()).map(width).collect();
        let line = |row: &Vec<String>| {
            let cells = row.iter().zip(&widths).enumerate().map(|(i, (cell, &width))| {
                let left = self.left.contains(&i);
                if left { format!("{cell:<width$}") } else { format!("{cell:>width$}") }
            });
            let text = cells.collect::<Vec<_>>().join("  ");
            format!("{}\n", text.trim_end())
        };
        let width = widths.iter().sum::<usize>() + 2 * widths.len().saturating_sub(1);
        let rule = "\u{2500}".repeat(width);
        let rows: String = rows.iter().map(line).collect();
        format!("{}{rule}\n{rows}", line(&head))
    }

    /// Writes the table as Markdown.
    pub fn markdown(&self) -> String {
        let cell = |cell: &TableCell| cell.plain().replace('|', "\\|").replace('\n', " ");
        let line = |row: &Vec<TableCell>| {
            format!("| {} |\n", row.iter().map(cell).collect::<Vec<_>>().join(" | "))
        };
        let rule = "|---".repeat(self.head.len());
        let rows: String = self.rows.iter().map(line).collect();
        format!("{}{rule}|\n{rows}", line(&self.head))
    }

    /// Writes the table as HTML of a class; every row is headed by its first cell.
    pub fn html(&self, class: &str) -> String {
        let heads = self.head.iter().map(|cell| format!("<th scope=\"col\">{}</th>", cell.html()));
        let mut head = format!("<thead><tr>{}</tr></thead>\n", heads.collect::<String>());
        if self.head.iter().all(|cell| cell.text.is_empty()) {
            head.clear();
        }
        let row = |row: &Vec<TableCell>| {
            let cells = row.iter().enumerate().map(|(i, cell)| match i {
                0 => format!("<th scope=\"row\">{}</th>", cell.html()),
                _ => format!("<td>{}</td>", cell.html()),
            });
            format!("<tr>{}</tr>\n", cells.collect::<String>())
        };
        let rows: String = self.rows.iter().map(row).collect();
        let class = escape(class);
        format!("<table class=\"{class}\">\n{head}<tbody>\n{rows}</tbody>\n</table>\n")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_as_wide_as_their_contents() {
        let mut table = Table::new(["", "a", "state"]).left(&[0, 2]);
        table.push(["a name of some length", "1", "x"]);
        table.push(["−", "12.5", "finished"]);
        table.push(["short"]);
        let expected = "                          a  state\n─────────────────────────────────────\n\
                        a name of some length     1  x\n−                      12.5  finished\nshort\n";
        assert_eq!(table.text(), expected);
    }

    #[test]
    fn a_cell_of_a_page_stays_one_cell() {
        let mut table = Table::new(["", "a"]);
        table.push([TableCell::from("x|y"), TableCell::noted("1\n2", "[0, 3]")]);
        assert_eq!(table.markdown(), "|  | a |\n|---|---|\n| x\\|y | 1 2 [0, 3] |\n");
    }

    #[test]
    fn html_has_a_head_where_there_is_one_and_no_markup_of_others() {
        let mut table = Table::new(["", "<b>"]);
        table.push([TableCell::from("&"), TableCell::noted("1", "[0, 3]")]);
        let row = "<tbody>\n<tr><th scope=\"row\">&amp;</th><td>1 <span>[0, 3]</span></td></tr>\n</tbody>\n</table>\n";
        let head =
            "<thead><tr><th scope=\"col\"></th><th scope=\"col\">&lt;b&gt;</th></tr></thead>\n";
        assert_eq!(table.html("numbers"), format!("<table class=\"numbers\">\n{head}{row}"));
        let headless = Table { head: vec![TableCell::default(); 2], ..table };
        assert_eq!(headless.html("numbers"), format!("<table class=\"numbers\">\n{row}"));
    }
}
