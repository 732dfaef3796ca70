//! The highway: traffic with merging ramps, and the notifier task of a listener who counts on merging cars to yield.
//!
//! | module | what |
//! |---|---|
//! | [`world`] | lanes, cars, drivers and collisions, as in highway-env |
//! | [`task`] | the listener at the wheel, what a topic asks of them, rewards: the [`Domain`](leadtime_sims::Domain) |
//!
//! # Where to start
//!
//! [`entry()`] is what the rest of the program knows; [`task::HighwayDomain`] the notifier task.

pub mod task;
pub mod world;

pub use task::entry;
