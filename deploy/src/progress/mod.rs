//! What a learner's progress becomes: lines, a bar, `metrics.jsonl`, TensorBoard events, policy files.
//!
//! [`metrics`] names every number once; [`journal`] writes them; [`display`] shows a few; [`sink`] is what the learner
//! calls. `docs/metrics.md` explains each name, and a test holds the two together.

pub mod display;
pub mod journal;
pub mod metrics;
pub mod sink;

pub use sink::RunSink;
