//! The delayed human: hears words one by one, understands late, reacts later, and keeps at it for a while.
//!
//! Nothing here knows a world, a notifier or a reward: what is said and how a reaction went goes in, which reaction is
//! due comes out.
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
//! Where to start: [`machine`] holds the transition table; [`HumanSettings`] every choice that bends it.
//!
//! # Source
//!
//! Hsu et al., *Timing the Message: Language-Based Notifications for Time-Critical Assistive
//! Settings* (arXiv:2509.07438), section on the listener model.

mod delay;
pub mod machine;
mod reasons;
mod settings;
mod speech;
mod tally;

pub use machine::{Human, HumanState, Initiation, SpeechAct};
pub use reasons::{ReasonTable, StatedReason};
pub use settings::{
    BlockedInitiation, Comprehension, DelayDraw, FollowThrough, FollowThroughEnd, HumanSettings,
    Informativeness, Interrupt, MAX_WORDS, PendingRule, ReactionDelay, ReactionReward, Repeat,
    RunningRule,
};
pub use speech::SpokenMessage;
pub use tally::Tally;
