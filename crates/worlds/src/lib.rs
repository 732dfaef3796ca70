//! The built-in worlds, registered: the one place that names them all; and what a world of your own starts from.
//!
//! What acts or learns does not know this crate; it is handed a [`Registry`](leadtime_sims::Registry).

mod builtin;
mod new_crate;
mod template;

pub use builtin::builtin;
pub use new_crate::{NewCrateError, new_crate};
pub use template::first_commands;
