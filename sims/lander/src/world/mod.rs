//! The lander: Gymnasium's `LunarLander-v3` rebuilt on rapier2d.
//!
//! The same seed gives the same episode as in the original (ground, start, wind, dispersion), and recorded episodes
//! of the original are the test of the physics. Two integrators move the lander:
//!
//! ```text
//!            near the ground                        clear of it for four frames
//! Flight ------------------------> ContactWorld ------------------------------> Flight
//! exact momenta, 0.2 us a frame    rapier2d, 7 us a frame
//! ```
//!
//! What this module does not know: pilots, zones, notifications, people.
//!
//! | file | what |
//! |---|---|
//! | `constants`, `settings` | numbers of the original; what can be set |
//! | `terrain`, `start`, `engines` | the ground, the state after the hidden first frame, what pushes |
//! | `flight`, `contact` (`contact_template`) | the two integrators |
//! | `touch`, `sleep`, `observe` | leg flags and nearness, coming to rest, observation and reward |
//! | `lander` | one frame from beginning to end; snapshot and restore |
//! | `draw` | the world as a picture's ingredients |
//!
//! # Where to start
//!
//! [`Lander::step`].

mod body;
mod constants;
mod contact;
mod contact_template;
mod draw;
mod engines;
mod flight;
mod lander;
mod observe;
mod settings;
mod sleep;
mod start;
mod terrain;
mod touch;

pub use draw::{VIEW, caption};
pub use engines::{Engine, NoSuchEngine};
pub(crate) use lander::SNAPSHOT_MARGIN;
pub use lander::{Frame, Lander, LanderOutcome, LanderSnapshot};
pub use settings::{Physics, PhysicsSettings};
pub(crate) use settings::{check_impulse, check_powers};
