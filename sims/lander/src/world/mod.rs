//! The lander: Gymnasium's `LunarLander-v3` rebuilt on rapier2d.
//!
//! The same seed gives the same episode as in the original (ground, start, wind, dispersion), and recorded episodes
//! of the original are the test of the physics. Two integrators move the lander:
//!
//! ```text
//!            near the ground                        clear of it for four frames
//! Flight ------------------------> ContactWorld ------------------------------> Flight
//! exact momenta, 0.2 us a frame    rapier2d's arithmetic, 1.5 us a frame
//! ```
//!
//! What this module does not know: pilots, zones, notifications, people.
//!
//! Where to start: [`Lander::step`]: one frame from beginning to end.

mod body;
mod constants;
mod contact;
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
pub(crate) use observe::quantities;
pub(crate) use settings::START_IMPULSES;
pub use settings::{Physics, PhysicsSettings};
