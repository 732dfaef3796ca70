//! A table as aligned text, as Markdown and as HTML.
//!
//! Commands, result pages and reports say what stands in a table; how wide a column is and what must be escaped is
//! decided here alone. What this crate does not know: numbers. The caller writes a number with the digits that it
//! deserves.
//!
//! # Where to start
//!
//! [`Table`].

mod columns;
mod escape;
mod table;
mod wrap;

pub use columns::{beginning, columns, padded};
pub use escape::escape;
pub use table::{Table, TableCell};
pub use wrap::{fitted, wrapped};

/// Columns of a line of text: those of a usual terminal.
pub const WIDTH: usize = 80;
