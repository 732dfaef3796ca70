//! The delayed human: hears words one by one, understands late, reacts later, and keeps at it for a while.
//!
//! Nothing here knows a world, a notifier or a reward; a [`Human`] is told what is said and how its reactions
//! went, and tells which reaction is due.
//!
//! ```text
//! message (c, k = 2, l = 5) starts at t = 0; reaction delay 2; follow-through 5 steps
//!
//! step       0     1     2     3     4     5     6     7     8
//! words      1     2     3     4     5
//! speech     ├───────────┼─────────────────┤
//!                        ↑ k words heard at time 2: comprehended
//! pending                ├───────────┤ reaction delay
//! reaction                           ├─────────────────────────────┤
//! ```
//!
//! # Where to start
//!
//! [`machine`] holds the transition table; [`HumanSettings`] every choice that bends it.
//!
//! # Source
//!
//! Hsu et al., *Timing the Message: Language-Based Notifications for Time-Critical Assistive
//! Settings* (arXiv:2509.07438), section on the listener model.

mod delay;
pub mod machine;
mod settings;
mod tally;

pub use machine::{Heard, Human, HumanState, Initiation, Order, Reacted};
pub use settings::{
    BlockedInitiation, Comprehension, Drawn, FollowThrough, FollowThroughEnd, HumanSettings,
    Informativeness, Interrupt, PendingRule, ReactionDelay, ReactionReward, Repeat, RunningRule,
};
pub use tally::Tally;
