//! Worlds and people: environments, the delayed human, and the notifier problem built from both.
//!
//! Everything here is a pure function of (state, action, seed): no clock, no file, no environment variable, no
//! network, no thread. What this crate does not know: how a policy is trained, or where its actions come from.
//!
//! ```text
//! Domain (lander with zones, ...) + human  --notifier-->  Environment  <--  pilot task, classic control
//! ```
//!
//! # Where to start
//!
//! [`environment::Environment`] is what actors and evaluation see; [`domain::Domain`] is what a new world
//! implements to become a notifier problem.

pub mod classic;
pub mod cooking;
pub mod domain;
pub mod driving;
pub mod environment;
pub mod highway;
pub mod human;
pub mod lander;
pub mod notifier;
pub mod piloting;
pub mod registry;
pub mod scene;
pub mod setting;
pub mod steakhouse;
#[cfg(test)]
mod test_support;
pub mod vectorized;

pub use domain::{Advance, Delivery, Domain, Entities, Message, ReactionStatus, ReactionStep};
pub use environment::{
    End, EntityHistory, Environment, EpisodeSeed, Insight, SnapshotError, StepOutcome,
};
pub use notifier::NotifierEnv;
pub use registry::{Registry, TaskError};
pub use scene::{Gauge, Listener, Scene, Shape, Speech, Tone, View};
pub use setting::SettingError;
pub use vectorized::Vectorized;
