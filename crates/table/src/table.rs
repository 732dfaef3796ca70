//! Head and rows, and their three forms.

use std::ops::Range;

use crate::columns::ending;
use crate::{beginning, columns, escape, padded, wrapped};

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
    /// The column whose texts may be shortened in their middle.
    elastic: Option<usize>,
    /// The column whose texts may take several lines.
    flowing: Option<usize>,
    /// The columns that are left out where there is no room, the first one first.
    dispensable: Vec<usize>,
}

/// The fewest columns that a text keeps which is shortened, or a line of one that takes several.
const SHORTEST: usize = 16;

/// One cell of a table.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TableCell {
    text: String,
    /// Follows the text, and stands back where the form allows it.
    note: String,
}

impl TableCell {
    /// Writes a value with a less prominent note, such as a mean with its interval.
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
        let head = head.into_iter().map(Into::into).collect();
        let (rows, dispensable) = (Vec::new(), Vec::new());
        Self { head, rows, left: vec![0], elastic: None, flowing: None, dispensable }
    }

    /// Aligns these columns to the left, and all others to the right.
    pub fn left(self, columns: &[usize]) -> Self {
        Self { left: columns.to_vec(), ..self }
    }

    /// Lets the texts of a column be shortened in their middle where the table is too wide.
    pub fn elastic(self, column: usize) -> Self {
        Self { elastic: Some(column), ..self }
    }

    /// Lets the texts of a column take several lines where the table is too wide.
    pub fn flowing(self, column: usize) -> Self {
        Self { flowing: Some(column), ..self }
    }

    /// Lets columns be left out where the table is too wide: the first of these first, and no more of them than need be.
    pub fn dispensable(self, columns: &[usize]) -> Self {
        Self { dispensable: columns.to_vec(), ..self }
    }

    /// Adds a row; a short one is filled with empty cells.
    pub fn push<C: Into<TableCell>>(&mut self, cells: impl IntoIterator<Item = C>) {
        let mut row: Vec<TableCell> = cells.into_iter().map(Into::into).collect();
        row.resize(self.head.len(), TableCell::default());
        self.rows.push(row);
    }

    /// Writes the table as plain text; every column is as wide as its widest cell.
    pub fn text(&self) -> String {
        self.texts().block(0..self.head.len())
    }

    /// Writes the table as plain text with lines of at most `width` columns of a terminal, as far as possible: where it is
    /// too wide, dispensable columns are left out, notes stand below their texts, the elastic column is shortened, the flowing
    /// one takes several lines, and what still does not fit follows in further blocks that repeat the first column.
    pub fn text_within(&self, width: usize) -> String {
        let mut texts = self.texts();
        if let Some(&column) = self.dispensable.first()
            && texts.width() > width
        {
            return self.without(column).text_within(width);
        }
        if texts.width() > width {
            texts = Texts { rows: self.stacked(), ..texts };
        }
        if let Some(column) = self.elastic {
            texts.shorten(column, texts.room_for(column, width));
        }
        if let Some(column) = self.flowing {
            texts.flow(column, texts.room_for(column, width));
        }
        let texts = texts.measured();
        let (mut blocks, mut from) = (Vec::new(), 1);
        while from < self.head.len() || blocks.is_empty() {
            let mut room = width.saturating_sub(texts.widths.first().copied().unwrap_or(0));
            let fits = |&&column: &&usize| {
                let (wanted, left) = (column + GAP.len(), room);
                room = room.saturating_sub(wanted);
                wanted <= left
            };
            let n = texts.widths.iter().skip(from).take_while(fits).count().max(1);
            let to = (from + n).min(self.head.len());
            blocks.push(texts.block(from..to));
            from = to;
        }
        blocks.join("\n")
    }

    /// Returns the same without a column.
    fn without(&self, column: usize) -> Self {
        let others = |cells: &[TableCell]| {
            let kept = cells.iter().enumerate().filter(|(i, _)| *i != column);
            kept.map(|(_, cell)| cell.clone()).collect::<Vec<_>>()
        };
        let moved = |i: &usize| (*i != column).then(|| if *i > column { i - 1 } else { *i });
        Self {
            head: others(&self.head),
            rows: self.rows.iter().map(|row| others(row)).collect(),
            left: self.left.iter().filter_map(moved).collect(),
            elastic: self.elastic.as_ref().and_then(moved),
            flowing: self.flowing.as_ref().and_then(moved),
            dispensable: self.dispensable.iter().filter_map(moved).collect(),
        }
    }

    fn texts(&self) -> Texts<'_> {
        let plain = |row: &Vec<TableCell>| row.iter().map(TableCell::plain).collect::<Vec<_>>();
        let (head, rows) = (plain(&self.head), self.rows.iter().map(plain).collect());
        Texts { head, rows, left: &self.left, widths: Vec::new() }.measured()
    }

    /// Lists the rows with their notes in rows of their own.
    fn stacked(&self) -> Vec<Vec<String>> {
        let split = |row: &Vec<TableCell>| {
            let texts = row.iter().map(|cell| cell.text.clone()).collect();
            let notes: Vec<String> = row.iter().map(|cell| cell.note.clone()).collect();
            let has_notes = notes.iter().any(|note| !note.is_empty());
            [Some(texts), has_notes.then_some(notes)].into_iter().flatten()
        };
        self.rows.iter().flat_map(split).collect()
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

/// What separates two columns.
const GAP: &str = "  ";

/// The cells as plain texts, and how wide each column is.
struct Texts<'a> {
    head: Vec<String>,
    rows: Vec<Vec<String>>,
    left: &'a [usize],
    widths: Vec<usize>,
}

impl Texts<'_> {
    fn measured(mut self) -> Self {
        let all = || std::iter::once(&self.head).chain(&self.rows);
        let width = |i: usize| all().map(|row| columns(&row[i])).max().unwrap_or(0);
        self.widths = (0..self.head.len()).map(width).collect();
        self
    }

    fn width(&self) -> usize {
        self.widths.iter().sum::<usize>() + GAP.len() * self.widths.len().saturating_sub(1)
    }

    /// Returns how wide a column may be to leave room for the others in lines of `width`.
    fn room_for(&self, column: usize, width: usize) -> usize {
        let excess = self.width().saturating_sub(width);
        self.widths[column].saturating_sub(excess).max(SHORTEST)
    }

    /// Breaks a column's texts that are wider than `most` between words; what follows gets rows of its own.
    fn flow(&mut self, column: usize, most: usize) {
        let n_columns = self.head.len();
        let broken = |mut row: Vec<String>| {
            let text = wrapped(&row[column], most, 0);
            let mut lines = text.lines().map(str::to_owned);
            row[column] = lines.next().unwrap_or_default();
            let more = lines.map(|line| {
                let mut row = vec![String::new(); n_columns];
                row[column] = line;
                row
            });
            let more: Vec<_> = more.collect();
            std::iter::once(row).chain(more)
        };
        self.rows = std::mem::take(&mut self.rows).into_iter().flat_map(broken).collect();
    }

    /// Cuts the middle out of a column's texts that are wider than `most`.
    fn shorten(&mut self, column: usize, most: usize) {
        for row in &mut self.rows {
            let text = &row[column];
            if columns(text) > most {
                let tail = ending(text, most / 2);
                let head = beginning(text, most - columns(tail) - 1);
                row[column] = format!("{head}\u{2026}{tail}");
            }
        }
    }

    /// Writes some columns, with the first one in front of them.
    fn block(&self, range: Range<usize>) -> String {
        let first = (0..self.head.len()).take(1);
        let shown: Vec<usize> = first.chain(range.filter(|&i| i > 0)).collect();
        let line = |row: &Vec<String>| {
            let cells = shown.iter().map(|&i| {
                let (cell, width) = (&row[i], self.widths[i]);
                let gap = || " ".repeat(width.saturating_sub(columns(cell)));
                if self.left.contains(&i) { padded(cell, width) } else { gap() + cell }
            });
            format!("{}\n", cells.collect::<Vec<_>>().join(GAP).trim_end())
        };
        let sum: usize = shown.iter().map(|&i| self.widths[i]).sum();
        let rule = "\u{2500}".repeat(sum + GAP.len() * shown.len().saturating_sub(1));
        let rows: String = self.rows.iter().map(line).collect();
        format!("{}{rule}\n{rows}", line(&self.head))
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
    fn wide_characters_take_two_columns_and_accents_none() {
        let mut table = Table::new(["word", "k", "in Japan"]).left(&[0]).elastic(2);
        table.push(["日本", "1", "右"]);
        table.push(["e\u{301}t\u{e9}", "12", "up"]);
        table.push(["abcdef", "3", ""]);
        let expected = "word     k  in Japan\n────────────────────\n日本     1        右\n\
                        e\u{301}t\u{e9}     12        up\nabcdef   3\n";
        assert_eq!(table.text(), expected);
        let long = "右".repeat(20);
        table.push(["", "", long.as_str()]);
        let text = table.text_within(30);
        assert!(text.ends_with("  右右右右\u{2026}右右右右\n"), "{text}");
        assert!(text.lines().all(|line| columns(line) <= 30), "{text}");
        assert_eq!(wrapped("右 左 上", 5, 0), "右 左\n上");
    }

    #[test]
    fn a_table_that_is_too_wide_stacks_its_notes_and_then_breaks_between_columns() {
        let mut table = Table::new(["", "a", "b"]);
        table.push(["one", "two", "three"].map(|text| TableCell::noted(text, "[note]")));
        let rows = "one        two   three\n[note]  [note]  [note]\n";
        let text = table.text_within(22);
        assert!(text.ends_with(rows) && text.lines().all(|l| l.chars().count() <= 22), "{text}");
        assert_eq!(table.text_within(80), table.text());
        let blocks = table.text_within(14);
        assert_eq!(blocks.split("\n\n").count(), 2, "{blocks}");
        assert!(blocks.lines().all(|line| line.chars().count() <= 14), "{blocks}");
    }

    #[test]
    fn an_elastic_column_loses_the_middle_of_long_texts() {
        let mut table = Table::new(["run", "steps"]).elastic(0);
        table.push(["table1-piloting-convey-react-0123456789ab-s201", "1600000"]);
        table.push(["short", "1"]);
        let text = table.text_within(30);
        assert!(text.contains("table1-pil\u{2026}789ab-s201  1600000"), "{text}");
        assert!(text.lines().all(|line| line.chars().count() <= 30), "{text}");
        assert!(text.contains("\nshort "), "{text}");
    }

    #[test]
    fn a_flowing_column_takes_lines_and_loses_nothing() {
        let mut table = Table::new(["name", "meaning", "unit"]).left(&[0, 1, 2]).flowing(1);
        table.push(["wet", "the floor in front of the person is wet", "0 or 1"]);
        table.push(["dry", "", "m"]);
        assert_eq!(table.text_within(80), table.text());
        let rows = "wet   the floor in front of  0 or 1\n      the person is wet\ndry                          m\n";
        let text = table.text_within(36);
        assert!(text.ends_with(rows) && text.lines().all(|l| l.chars().count() <= 36), "{text}");
    }

    #[test]
    fn dispensable_columns_are_left_out_one_after_the_other_and_texts_stay_whole() {
        let mut table =
            Table::new(["run", "domain", "state", "steps"]).left(&[0, 1, 2]).dispensable(&[1, 3]);
        let name = "table1-piloting-convey-react-0123456789ab-s201";
        table.push([name, "lander", "finished", "1600000"]);
        table.push(["short", "lander", "unfinished", "1"]);
        assert_eq!(table.text_within(80), table.text());
        let text = table.text_within(70);
        let head = format!("{:46}  state         steps", "run");
        assert_eq!(text.lines().next(), Some(head.as_str()));
        assert!(text.contains(&format!("{name}  finished    1600000\n")), "{text}");
        let text = table.text_within(60);
        assert!(text.contains(&format!("{name}  finished\n")) && !text.contains("steps"), "{text}");
        let text = table.text_within(20);
        assert!(text.contains(name), "{text}");
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
