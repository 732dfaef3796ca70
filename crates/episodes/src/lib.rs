//! One way to play an episode, with observers.
//!
//! What this crate does not know: what is measured, drawn or learned from an episode, files, the network, the clock.
//!
//! ```text
//! Player (policy, script) ─► Lockstep ─► EnvSlot, EnvSlot, ...     act: one batched inference, an action per slot
//!                               │                                  advance: one step per slot
//!                               └──► an Observer per slot: records a rollout, measures, probes, keeps scenes
//! ```
//!
//! An actor drives [`Lockstep`] itself, because it stops at rollout boundaries; everybody else plays whole episodes with
//! [`play()`]. Both take observers as type parameters, so that a hook which is not wanted costs nothing in the hot loop.
//!
//! # Where to start
//!
//! [`Observer`], [`Lockstep`]; [`play()`] and [`EpisodeObserver`].

mod error;
mod lockstep;
mod play;
mod player;
mod scripted;
mod slot;

pub use error::{Error, known_players};
pub use lockstep::{Decision, Lockstep, Observer};
pub use play::{
    EpisodeCounter, EpisodeObserver, MakeEnvironment, PlaySettings, episode_seed, in_threads, play,
};
pub use player::{Choice, Decider, Player};
pub use scripted::Scripted;
pub use slot::EnvSlot;
