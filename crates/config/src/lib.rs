//! Configuration: as written, resolved, checked.
//!
//! ```text
//! built-in files  <-  the person's file  <-  --set, --seed, --name, --runs      texts (layers, catalog)
//!        = one table that remembers where each value was written                resolved (layers)
//!        = typed sections                                                       read once (written, sections)
//!        = Config: complete, in range, consistent; also as the table that a run writes beside its results
//! ```
//!
//! Defaults live in the built-in TOML files: no typed section that is read has a default. Every file but `general` has a
//! `base` and writes only what differs, so that a default stands in one place; so may a person's own file. A world of one's
//! own brings the defaults of its code instead; for what it does not choose itself, a test holds them equal to the files.
//!
//! # What it does not know
//!
//! The command line, files, the clock, how to print: it takes texts and gives values.
//!
//! # Where to start
//!
//! [`Config::load`]; what identifies a run: [`identity`].

mod catalog;
mod checked;
mod edit;
mod error;
pub mod identity;
mod layers;
mod nesting;
mod overrides;
mod sections;
mod written;

pub use catalog::Catalog;
pub use checked::{Config, ConfigSource, EvaluationSettings, MAX_EPISODES, RunSettings};
pub use error::ConfigError;
pub use layers::{Layer, read};
pub use overrides::{Alternatives, Override};

#[cfg(test)]
mod tests;
