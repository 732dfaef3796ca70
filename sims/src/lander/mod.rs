//! The lander: Gymnasium's `LunarLander-v3` rebuilt on rapier2d, and the pilots that fly it.
//!
//! The same seed gives the same episode as in the original (ground, start, wind, dispersion), and recorded episodes
//! of the original are the test of the physics. Two gears move the lander:
//!
//! ```text
//!            near the ground                        clear of it for four frames
//! Flight ------------------------> ContactWorld ------------------------------> Flight
//! exact momenta, 0.2 us a frame    rapier2d, 7 us a frame
//! ```
//!
//! What this module does not know: zones, notifications, people. Those are the piloting domain's.
//!
//! | file | what |
//! |---|---|
//! | `constants`, `settings` | numbers of the original; what can be set |
//! | `terrain`, `start`, `engines` | the ground, the state after the hidden first frame, what pushes |
//! | `flight`, `contact` (`contact_template`) | the two gears |
//! | `touch`, `sleep`, `observe` | leg flags and nearness, coming to rest, observation and reward |
//! | `world` | one frame from beginning to end; snapshot and restore |
//! | `heuristic`, `pilot`, `evaluate` | the scripted pilot, the trained one, and how well either flies |
//! | `task` | the trained pilot's own training task |
//! | [`conformance`] | recorded episodes of the original, replayed |
//! | `draw` | the world as a picture's ingredients |
//!
//! # Where to start
//!
//! [`Lander::step`].

mod body;
pub mod conformance;
mod constants;
mod contact;
mod contact_template;
mod draw;
mod engines;
mod evaluate;
mod flight;
mod heuristic;
mod observe;
mod pilot;
mod settings;
mod sleep;
mod start;
mod task;
mod terrain;
mod touch;
mod world;

pub use draw::{VIEW, caption};
pub use engines::{Engine, NoSuchEngine};
pub use evaluate::{Evaluation, Flown, Flyer, MAX_FRAMES, Tally, evaluate, fly};
pub use heuristic::heuristic;
pub use pilot::{Pilot, PilotError, engines_off};
pub use settings::{LanderSettings, Physics};
pub use task::{PilotTask, PilotTaskSettings};
pub use world::{Frame, Lander, LanderSnapshot, Outcome};
