//! One self-contained HTML file about a run: it needs no other file, no network and no script.
//!
//! [`Report`] is plain data that the program fills; [`Report::html`] writes it. Every text is escaped. Pictures are
//! inline SVG whose colours follow the reader's light or dark setting.

mod contents;
mod html;
mod sections;

pub use contents::{Book, Fact, Picture, Report, Verdict};
