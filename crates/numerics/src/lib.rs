//! Numbers that know nothing of Leadtime: seeded random streams, row-invariant dense kernels, small statistics.
//!
//! Everything here is a pure function of its arguments: no clock, no file, no environment, no global
//! generator. The crate is the lowest layer of the workspace; every other crate may use it.
//!
//! # Where to start
//!
//! [`streams::stream`] is where every random draw of the project begins.

pub mod dense;
pub mod kernel;
pub mod lstm;
pub mod orthogonal;
pub mod pcg64;
pub mod stats;
pub mod streams;
pub mod tanh;

pub use dense::{Dense, DenseError};
pub use kernel::{Activation, Panels};
pub use orthogonal::orthogonal;
pub use pcg64::Pcg64;
pub use streams::{Purpose, stream};
pub use tanh::tanh_inplace;
