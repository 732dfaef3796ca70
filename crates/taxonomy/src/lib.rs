//! Words: which sentence says a topic so that it is understood after k words and over after l.
//!
//! A notifier chooses (c, k, l): a topic, a comprehension time and a conveyance time. A listener hears words. This
//! crate holds the database between the two, and how it is made.
//!
//! ```text
//! (merge_left, k = 2, l = 5)  --retrieve-->  "Merge left, truck ahead slowing."
//!                                             ├─ what ──┤├───── why ──────┤
//!                                             word 2: understood           word 5: over
//! ```
//!
//! At run time it reads text that is given to it and nothing else: no file, no clock, no network, no language
//! model. What it does not know: worlds, delays of listeners, policies; a topic is a name and a number here.
//!
//! # Where to start
//!
//! [`Taxonomy`] is the database, [`Taxonomy::retrieve_true`] its one question: which sentences say this message, and are
//! true now. [`Rotation`] lets them take turns. With the feature `pipeline`,
//! [`pipeline`] makes databases from a language model, from an annotator's log or from a grammar.
//!
//! # Source
//!
//! Hsu et al., *Timing the Message: Language-Based Notifications for Time-Critical Assistive Settings*
//! (arXiv:2509.07438), section on the taxonomy of notifications and its appendix.

pub mod check;
pub mod database;
pub mod error;
pub mod facts;
#[cfg(feature = "pipeline")]
pub mod pipeline;
mod raw;
pub mod retrieve;
pub mod rotation;
pub mod shipped;
#[cfg(test)]
mod test_support;
pub mod utterance;
pub mod words;

pub use check::{Finding, check, check_facts};
pub use database::{DatabaseHeader, Taxonomy, Topic};
pub use error::TaxonomyError;
pub use facts::{FactSet, MAX_FACTS};
pub use retrieve::{Request, Retrieved};
pub use rotation::Rotation;
pub use shipped::shipped;
pub use utterance::{Cell, Fidelity, SpanKind, Utterance, WordSpan};
