//! `leadtime taxonomy`: the sentences of a domain, from the plan to the file that the program reads.
//!
//! ```text
//! plan --build--> calls.jsonl, taxonomy.toml, coverage.md, candidates.jsonl     (or by --replay from calls.jsonl)
//! calls.jsonl --report--> coverage.md      taxonomy.toml --validate, export--> findings, tables
//! taxonomy.toml --speak--> sound.wav, voice.json
//! ```
//!
//! Where to start: [`mod@build`]; whose fault an error is: [`source`].

mod backend;
mod build;
mod look;
mod rate;
mod source;
mod speak;

pub(super) use build::run as build;
pub(super) use look::{export, report, validate};
pub(super) use rate::run as rate;
pub(super) use source::database;
pub(super) use speak::run as speak;
