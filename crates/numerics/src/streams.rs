//! Named random streams: every draw of a run comes from one of these.
//!
//! A stream is seeded by (run seed, purpose, environment id, index) and by nothing else, so it does not matter
//! which process draws from it, in which order environments are stepped, or what happened before. That is what
//! lets an environment move between actors, or come back after a crash, without a bit changing.
//!
//! # Source
//!
//! The mixing is numpy's `SeedSequence` over the listed words; see [`crate::pcg64`].

use crate::Pcg64;

/// What a stream is for; two purposes never share draws.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Purpose {
    /// Parameter initialisation (index: layer).
    Initialise = 1,
    /// The world: terrain, start state, wind, traffic (index: episode).
    World = 2,
    /// The listener: reaction delays, drift (index: episode).
    Human = 3,
    /// Sampling of the policy's actions (index: rollout of the environment).
    Act = 4,
    /// Shuffling of minibatches (index: update).
    Shuffle = 5,
    /// Resampling in statistics (index: statistic).
    Bootstrap = 6,
    /// What a task draws about itself before an episode: variants, curricula (index: episode).
    Task = 7,
    /// Which of a cell's sentences says a message (index: episode).
    Words = 8,
    /// Which step of a stage a probe looks at (index: episode).
    Probe = 9,
    /// Seeds of the episodes on which a run's policies are evaluated without being trained (index: what for).
    HeldOut = 10,
    /// What a search for a script proposes (index: none, 0).
    Search = 11,
    /// How long an actor waits for an answer and between hellos (index: start of the actor). Reaches no result.
    Greet = 12,
}

/// Opens the stream of one purpose, environment and index of a run.
///
/// # Example
///
/// ```
/// use leadtime_numerics::{Purpose, stream};
///
/// let mut a = stream(7, Purpose::World, 3, 0);
/// let mut again = stream(7, Purpose::World, 3, 0);
/// let mut other = stream(7, Purpose::Human, 3, 0);
/// let draw = a.next_u64();
/// assert_eq!(draw, again.next_u64());
/// assert_ne!(draw, other.next_u64());
/// ```
pub fn stream(run_seed: u64, purpose: Purpose, env_id: u32, index: u64) -> Pcg64 {
    Pcg64::from_entropy(&[
        run_seed as u32,
        (run_seed >> 32) as u32,
        purpose as u32,
        env_id,
        index as u32,
        (index >> 32) as u32,
    ])
}
