//! The native half of the Python package `leadtime`: built-in worlds, one at a time or many with one call per step.
//!
//! What a step returns has Gymnasium's form; `leadtime/gym.py` makes environments of it. Errors are `ValueError` with the sentence
//! that the program would print.
//!
//! Where to start: `world.rs` is one environment, `vector.rs` many in lockstep (`lanes.rs`), `pair.rs` one for a
//! notifier and a listener; `action.rs` reads what is done, `choices.rs` which
//! choices there are, `info.rs` says what accompanies an observation, `film.rs`
//! draws, `task.rs` reads a configuration.

#![expect(clippy::needless_pass_by_value, reason = "what Python hands over is owned")]

mod action;
mod choices;
mod film;
mod info;
mod lanes;
mod module;
mod pair;
mod task;
mod vector;
mod world;
