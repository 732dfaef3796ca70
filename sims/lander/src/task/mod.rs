//! The task: a lander flown by a trained pilot who does not see the danger zones in the way.
//!
//! ```text
//!     ·────────────────────── 1.4 start
//!  ▒▒▒▒▒▒▒▒▒▒                     top-left zone
//!
//!              ▒▒▒▒▒▒  ▒▒▒▒▒▒▒▒▒  overhead and right zones
//!
//!  ~~~~~~~~~~~~|_pad_|~~~~~~~~~~
//! ```
//!
//! A topic asks for a direction. The pilot follows it with a small tilt-and-hover controller (`maneuver`), or by
//! holding one engine (`raw`); near the ground and on it they do not listen.
//!
//! Where to start: [`LanderDomain`] is the domain; [`LanderWorldSettings`] what can be chosen about it; `maneuver` how a topic is followed.
//!
//! # Source
//!
//! Hsu et al. (arXiv:2509.07438), the task of piloting. It gives no coordinates: zones, path and
//! controller are ours.

mod describe;
mod domain;
mod facts;
mod maneuver;
mod safe_path;
mod settings;
mod zone;

pub use domain::{ENTERED, LanderDomain, LanderTaskSettings};
pub use settings::{
    EntryPenalty, LanderWorldSettings, NearCharge, NearPenalty, PilotKind, ReactionKind,
};
pub use zone::{DEFAULT_ZONES, Zone};
