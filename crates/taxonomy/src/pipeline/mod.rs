//! Makes databases: from a description of a domain, through prompts and ratings, to a file of sentences.
//!
//! ```text
//! plan ─> summarise ─> generate ─> rules ─> rate word by word ─> place ─> embed ─> medoids ─> controls ─> file, report
//!             │            │                   │                            │           │
//!             └────────────┴─────── call log (append-only) ─────────────────┴───────────┘
//! ```
//!
//! Whatever costs money or time is a *call*: a prompt to a language model, a sentence to an embedder. Every call and
//! its reply is a line of the log, under a key that hashes everything the reply can depend on. A run that is cut off
//! goes on from its log without repeating a call, and a finished log makes the same file again, byte for byte,
//! without network or weights ([`job::Backend::Replay`]).
//!
//! Sentences are placed where they were *measured* to be understood, not where they were asked for; whatever is
//! turned down has a [`Reason`], and the report counts them.
//!
//! # Where to start
//!
//! [`build`] has all stages; [`job`] runs them from files, for the program; [`Model`] is what a new backend implements.
//!
//! # Source
//!
//! arXiv:2509.07438, appendix on offline generation: prompts of the same structure in our own words. Ours: one
//! rating call per prefix with later words hidden ([`RateForm::Prefix`]), the rules, the log.

mod annotator;
pub mod backend;
pub mod build;
mod caller;
pub mod candidate;
mod complete;
pub mod controls;
pub mod coverage;
pub mod curve;
pub mod embedding;
pub mod error;
mod export;
#[cfg(any(test, feature = "fakes"))]
pub mod fakes;
mod grammar;
pub mod http;
pub mod job;
mod lexical;
pub mod log;
mod medoids;
#[cfg(feature = "minilm")]
pub mod minilm;
pub mod plan;
mod presuppose;
mod progress;
mod prompts;
mod rating;
mod regular;
mod reply;
mod representatives;
mod rules;
mod structure;
mod template;

pub use backend::{Call, CallStage, Embedder, Finish, Input, Model, Reply, Sampling};
pub use build::Built;
pub use candidate::{Candidate, Reason};
pub use embedding::Embedding;
pub use error::PipelineError;
pub use plan::{DatabasePlan, RateForm};
