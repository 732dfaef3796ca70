//! Contracts of worlds and listeners: environments, domains, the delayed human, and the notifier problem built from them.
//!
//! Everything here is a pure function of (state, action, seed): no clock, no file, no environment variable, no
//! network, no thread. What this crate does not know: how a policy is trained, where its actions come from, or any
//! world but the small ones of [`classic`]: the lander, the highway and the steakhouse are crates of their own.
//!
//! ```text
//! Domain (lander, highway, ...) + human      --notifier-->  Environment  <--  pilot task, classic control
//! ```
//!
//! Where to start: [`environment::Environment`] is what actors and evaluation see; [`domain::Domain`] is what a new world
//! implements to become a notifier problem; [`registry::DomainEntry`] is how it becomes known by name.

pub mod check;
pub mod classic;
pub mod description;
pub mod domain;
pub mod env_check;
pub mod environment;
mod error;
pub mod fact;
pub mod human;
pub mod message;
pub mod notifier;
pub mod registry;
pub mod scene;
pub mod scriptable;

pub use check::SettingError;
pub use description::{Description, NamedHead, ObservationLayout, Quantity, RewardTerm};
pub use domain::{Advance, Delivery, Domain};
pub use environment::{
    End, Entities, EntityHistory, Environment, EpisodeSeed, Insight, SharedOutcome, SnapshotError,
    StepOutcome, TwoPlayers,
};
pub use error::TaskError;
pub use fact::Fact;
pub use message::{Message, ReactionStatus, ReactionStep};
pub use notifier::NotifierEnv;
pub use registry::{DomainEntry, Registry};
pub use scene::{Gauge, Listener, Scene, Shape, Tone, View, Word};
pub use scriptable::Scriptable;
