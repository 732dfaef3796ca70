//! The steakhouse: a kitchen, a cook who does not know which stations are occupied, and the notifier task of telling them.
//!
//! | module | what |
//! |---|---|
//! | [`world`] | the kitchen as a gridworld, and its cook with what they believe and plan |
//! | [`task`] | what a topic asks of the cook or discloses, rewards: the [`Domain`](leadtime_sims::Domain) |
//!
//! # Where to start
//!
//! [`entry()`] is what the rest of the program knows; [`task::SteakhouseDomain`] the notifier task.

pub mod task;
pub mod world;

pub use task::entry;
