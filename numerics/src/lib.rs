//! Numbers that know nothing of Leadtime: seeded random streams, row-invariant dense kernels, small statistics.
//!
//! Everything here is a pure function of its arguments: no clock, no file, no environment, no global
//! generator. The crate is the lowest layer of the workspace; every other crate may use it.
//!
//! # Where to start
//!
//! [`streams::stream`] is where every random draw of the project begins.

pub mod pcg64;
pub mod streams;

pub use pcg64::Pcg64;
pub use streams::{Purpose, stream};
