//! The lander: its physics, the pilot that flies it, and the notifier task of the danger zones in its way.
//!
//! | module | what |
//! |---|---|
//! | [`world`] | Gymnasium's `LunarLander-v3` rebuilt on rapier2d |
//! | [`pilot`] | the scripted and the trained pilot, how well they fly, and the task that the latter is trained on |
//! | [`task`] | danger zones, what a topic asks of the pilot, rewards: the [`Domain`](leadtime_sims::Domain) |
//!
//! Where to start: [`entries()`] is what the rest of the program knows; [`task::LanderDomain`] the notifier task.

mod entries;
pub mod pilot;
pub mod task;
pub mod world;

pub use entries::entries;
