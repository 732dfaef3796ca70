//! A study's results: policies from several training seeds, judged on several people, beside published figures.
//!
//! ```text
//! evaluations per (row, evaluation, choice, training seed) --Summary::over_seeds--> StudyResult --> JSON
//!                                                                                       |---------> Markdown
//! ```
//!
//! What was trained, and by which processes, is not known here: a result is data, and its tables can be written again
//! from its JSON.
//!
//! # Where to start
//!
//! [`StudyResult`]; [`StudyResult::markdown`].

mod cells;
mod claims;
mod markdown;
mod result;

pub use claims::with_claims;
pub use result::{
    Judged, Layout, PartResult, Published, RowResult, Shown, StudyResult, TrainedRun,
};
