//! `leadtime compare`: the paper's tables, from training to the page.
//!
//! ```text
//! study (TOML: parts, rows, evaluations, published figures)          deploy/studies/*.toml
//!   --plan-->  trainings: a run each, named by what it computes      reused wherever they lie finished
//!   --train--> `leadtime up` for each, some at a time                resumable, interruptible
//!   --judge--> every policy on every person, sampled and greedy        kept beside the runs, played once
//!   --write--> docs/results/<study>.md, .json, figures, and the index
//! ```
//!
//! # Where to start
//!
//! [`study::Study`] is the data; [`run::run`] the way through.

mod catalog;
mod cells;
mod configure;
mod contender;
mod differences;
mod figures;
mod flights;
mod index;
mod judging;
mod naming;
mod plan;
mod progress;
mod provenance;
mod run;
mod study;
#[cfg(test)]
mod test_support;
mod train;
mod write;

pub(super) use run::run;
