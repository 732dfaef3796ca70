//! Our worlds against recorded traces of their public originals: same start, same actions, same trajectory.
//!
//! A tool: no other part of the program needs it, and it knows only the worlds.
//!
//! # Where to start
//!
//! [`Original::replay`] takes a text of traces; [`Replay`] is what came out.

mod error;
pub mod highway;
pub mod lander;
mod replay;
mod section;
pub mod steakhouse;

pub use error::ReplayError;
pub use replay::{Original, Replay};
pub use section::Section;
