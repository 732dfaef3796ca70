//! Numerics: seeded random streams, row-invariant dense kernels, elementary functions, small statistics.
//!
//! Everything here is a pure function of its arguments: the same arguments give the same bits on every machine of one
//! class of CPU.
//!
//! # What it does not know
//!
//! Anything of Leadtime: no policy, environment or message. No clock, file, environment variable or global generator.
//! It is the lowest layer of the workspace; every other crate may use it.
//!
//! # Where to start
//!
//! [`streams::stream`] is where every random draw of the project begins.

pub mod dense;
pub mod elementary;
pub mod kernel;
pub mod lstm;
pub mod orthogonal;
pub mod pcg64;
pub mod proportion;
pub mod stats;
pub mod streams;
pub mod thin;

pub use dense::{Dense, DenseError};
pub use kernel::{Activation, Panels};
pub use orthogonal::orthogonal;
pub use pcg64::Pcg64;
pub use streams::{Purpose, stream};
