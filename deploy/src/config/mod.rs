//! Configuration in two stages: as written, then as checked.
//!
//! ```text
//! embedded default of the domain  <-  the person's file  <-  --set, --seed, --name, --runs
//!          (catalog)                      (raw)                     (table)
//!                              = effective table  ->  Config (checked)
//! ```
//!
//! The person's own text is read against the typed structs first, so that a typo is reported with its line. What is
//! passed on is only the checked [`Config`], and it is what a run writes beside its results.
//!
//! # Where to start
//!
//! [`checked::load`].

pub mod catalog;
pub mod checked;
pub mod numbers;
pub mod raw;
pub mod sections;
pub mod sizes;
pub mod table;

pub use catalog::Catalog;
pub use checked::{Config, load};

#[cfg(test)]
mod tests;
