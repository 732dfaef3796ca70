//! What can be wrong with a floor plan, and what would do instead.

use thiserror::Error;

/// Why rows of characters are no kitchen. Rows and columns count from 1.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the sentence of each variant names its fields")]
pub enum LayoutError {
    /// Too small or too large.
    #[error("there are {rows} rows and {columns} columns")]
    Size { rows: usize, columns: usize },
    /// A row of another length than the first.
    #[error("row {row} has {columns} columns and row 1 has {expected}")]
    Ragged { row: usize, columns: usize, expected: usize },
    /// A character that stands for nothing.
    #[error("row {row}, column {column} is `{character}`")]
    Character { row: usize, column: usize, character: char },
    /// Floor on the outermost ring.
    #[error("row {row}, column {column} on the border is floor")]
    OpenBorder { row: usize, column: usize },
    /// A start that was there before.
    #[error("row {row}, column {column} is a second start `{number}`")]
    RepeatedStart { row: usize, column: usize, number: usize },
    /// A start that is missing below a higher one.
    #[error("there is no start `{number}`, and a higher one")]
    StartGap { number: usize },
    /// No start at all.
    #[error("no tile is a start")]
    NoStart,
    /// Something without which nothing can be cooked or served.
    #[error("there is no {what}")]
    Missing { what: &'static str },
    /// More stations than are counted.
    #[error("there are {n_stations} grills, boards and sinks")]
    Stations { n_stations: usize },
    /// Something that nobody can stand in front of.
    #[error("row {row}, column {column}, a {what}, cannot be reached from the start")]
    Unreachable { row: usize, column: usize, what: &'static str },
}

impl LayoutError {
    /// Tells what would do instead.
    pub fn allowed(&self) -> &'static str {
        match self {
            Self::Size { .. } => "3 to 32 rows and columns",
            Self::Ragged { .. } => "rows of one length",
            Self::Character { .. } => "space, X, O, M, D, P, B, W, S and 1 to 9",
            Self::OpenBorder { .. } => "a border without floor",
            Self::RepeatedStart { .. } | Self::StartGap { .. } => {
                "starts numbered from 1 without a gap, each once"
            }
            Self::NoStart => "a start tile `1`",
            Self::Missing { .. } => "at least one each of O, M, D, P, B, W and S",
            Self::Stations { .. } => "at most 16 of them",
            Self::Unreachable { .. } => "floor beside it that is joined to the start",
        }
    }
}
