//! One self-contained HTML file about a run or an episode: it needs no other file and no network.
//!
//! [`Report`] is plain data that the program fills; [`Report::html`] writes it, without a script. [`player()`] is a page
//! that plays one episode. Every text is escaped. Pictures are inline SVG whose colours follow the reader's light or
//! dark setting.

mod contents;
mod html;
mod player;
mod sections;

pub use contents::{Book, Picture, Provenance, ProvenanceDetail, Report, Verdict};
pub use player::player;
