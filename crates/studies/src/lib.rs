//! Studies: from a question in TOML to tables, figures and a page.
//!
//! ```text
//! study       as written: parts, rows, evaluations, published figures          studies/*.toml, or a file of one's own
//!   plan      trainings named by what they compute, conditions, measures       checked before anything is trained
//!   train     a learner and its actors for each, some at a time                resumable, interruptible
//!   evaluate  every policy under every condition, sampled and greedy           every episode once, cached next to the runs
//!   draw      curves, maps, trajectories, playthroughs
//!   write     <study>.md, <study>.json, figures, and the index
//! ```
//!
//! What this crate does not know: the command line, how to print (a [`StudyObserver`] gets what goes on), exit codes,
//! and any domain by name.
//!
//! # Where to start
//!
//! [`StudySession`] is the way through; a study as its author writes it is a [`Study`].

mod cache;
mod candidate;
mod catalog;
mod draw;
mod error;
mod estimate;
mod evaluate;
mod index;
mod markdown;
mod plan;
mod profile;
mod progress;
mod provenance;
mod request;
mod result;
mod script;
mod session;
mod study;
#[cfg(test)]
mod test_support;
mod train;
mod trainings;
mod write;

pub use cache::EvalCache;
pub use catalog::{NamedStudy, find, names};
pub use error::Error;
pub use estimate::TrainingEstimate;
pub use plan::PlannedTraining;
pub use progress::{StudyObserver, TrainingProgress};
pub use provenance::program_details;
pub use request::{EPISODES, EVAL_SEED, StudyRequest};
pub use session::StudySession;
pub use study::{Study, StudyPart, StudyRow};
pub use train::Crew;
