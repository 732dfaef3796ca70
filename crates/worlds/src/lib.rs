//! The built-in worlds, registered: the one place that names them all.
//!
//! Who acts or learns does not know this crate; they are handed a [`Registry`](leadtime_sims::Registry).

mod builtin;

pub use builtin::builtin;
