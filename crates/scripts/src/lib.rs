//! Notifiers without a network: what a trained one is to be compared with.
//!
//! ```text
//! Script (rules, TOML) ──bind──► BoundScript ──► ScriptPlayer ─┐
//!    ▲                                                         ├──► leadtime_episodes::Player
//! search (random, with mutation, raced)    bases ──► Oracle ───┘
//! ```
//!
//! A *script* is a short list of threshold rules on numbers that have names. The *search* finds a good one with as many
//! environment steps as a training gets. The *oracle* knows the listener and the world: it tries messages on a copy of the
//! episode, its random draws included, and says what works. No notifier without that knowledge can be expected to reach it.
//!
//! What this crate does not know: files, the command line, how success is tabulated, any world by name.
//!
//! # Where to start
//!
//! [`Script`], [`search()`], [`Oracle`].

mod arena;
mod bound;
mod error;
mod oracle;
mod propose;
mod script;
mod search;
#[cfg(test)]
mod test_support;

pub use bound::{BoundScript, ScriptPlayer};
pub use error::Error;
pub use oracle::{Oracle, OracleBase};
pub use script::{Script, ScriptCondition, ScriptMessage, ScriptRule};
pub use search::{FoundScript, SearchProgress, SearchSettings, search};
