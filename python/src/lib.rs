//! The native half of the Python package `leadtime`: built-in worlds, one at a time or many with one call per step.
//!
//! It knows no Gymnasium: `leadtime/gym.py` makes environments of these. Errors are `ValueError` with the sentence that the
//! program would print.
//!
//! Where to start: `world.rs` is one environment, `vector.rs` many in lockstep, `pair.rs` one for a notifier and a person;
//! `film.rs` draws, `task.rs` reads a configuration.

#![expect(clippy::needless_pass_by_value, reason = "what Python hands over is owned")]

mod film;
mod module;
mod pair;
mod task;
mod vector;
mod world;
