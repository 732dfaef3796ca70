//! The notifier problem: a world with a delayed human in it, seen by a policy that may only speak.
//!
//! ```text
//! policy --(initiate, topic, k, l)--> NotifierEnv --speech act--> Human --reaction--> Domain
//!    ↑                                    │                                        │
//!    └── last n (observation, action) ────┘ <───── observation, reward, end ───────┘
//! ```
//!
//! One step is one word. Its order is that of [`human::machine`](crate::human::machine): a due reaction starts, the
//! notifier acts, the human acts, the world advances, a word is heard; then reward, observation and metrics.
//!
//! A [`Session`] is the half of it that speaks. It knows what a notifier at work knows, and no world and no listener: the
//! same code decides in training and at work.
//!
//! Where to start: [`NotifierEnv`] is the environment; [`NotifierSettings`] what can be chosen about it; [`TaskSettings`] a whole task.

mod actions;
mod cells;
mod environment;
mod history;
mod session;
mod settings;
mod task;
mod two_players;

pub use actions::initial_bias;
pub use cells::{CellTable, SayableCell};
pub use environment::NotifierEnv;
pub use session::{Session, SessionState};
pub use settings::{NotificationType, NotifierSettings};
pub use task::{NotifierWorld, TaskSettings};
pub(crate) use two_players::PlayedByTwo;
