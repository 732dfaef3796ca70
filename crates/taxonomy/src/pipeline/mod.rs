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
//! without network or weights ([`CallMode::Replay`]).
//!
//! Sentences are placed where they were *measured* to be understood, not where they were asked for; whatever is
//! turned down has a [`Reason`], and the report counts them.
//!
//! # Where to start
//!
//! [`build()`] runs all stages; [`job`] does the same from files, for the program; [`Model`] is what a new backend
//! implements.
//!
//! # Source
//!
//! arXiv:2509.07438, appendix on offline generation: prompts of the same structure in our own words. Ours: one
//! rating call per prefix with later words hidden ([`RateForm::Prefix`]), the rules, the log.

pub mod annotator;
pub mod backend;
pub mod build;
pub mod caller;
pub mod candidate;
pub mod controls;
pub mod coverage;
pub mod curve;
pub mod embedding;
pub mod error;
pub mod export;
#[cfg(any(test, feature = "fakes"))]
pub mod fakes;
pub mod grammar;
pub mod http;
pub mod job;
pub mod lexical;
pub mod log;
pub mod medoids;
#[cfg(feature = "minilm")]
pub mod minilm;
pub mod plan;
mod progress;
pub mod prompts;
pub mod rating;
pub mod reply;
mod representatives;
pub mod rules;
pub mod structure;
pub mod template;

pub use backend::{Call, CallStage, Embedder, Finish, Input, Model, Reply, Sampling};
pub use build::{Built, build};
pub use caller::{CallMode, Caller};
pub use candidate::{Candidate, Reason};
pub use embedding::Embedding;
pub use error::PipelineError;
pub use log::CallLog;
pub use plan::{DatabasePlan, RateForm};
