//! The link over real sockets: learner, actors, observers and intruders in one process.
//!
//! Hermetic: every test has a socket of its own in a temporary directory (or a port that the kernel chooses), and
//! waits for events with a limit instead of sleeping.

#![expect(clippy::unwrap_used, reason = "the tests' helpers fail as their tests do")]

mod access;
mod certificates;
mod joining;
mod messages;
mod presence;
mod refusals;
mod regions;
mod relaying;
mod support;
mod weights;
