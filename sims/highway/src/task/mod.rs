//! The task: a listener on a highway with three merges, who counts on merging cars to yield. They do not.
//!
//! ```text
//!  0 m        230 m      310 m         540 m      620 m         850 m      930 m    990 m
//!  ═══════════════════════════════════╱══════════════════════════════════════════════|
//!  ══▭▸═══════╲═════════════════════════════════════════════════╲════════════════════| goal
//! ```
//!
//! The listener drives by IDM and MOBIL and does not see cars on ramps, nor those cars the listener. A topic asks them
//! to slow down, speed up or change lanes; they do it blindly while their reaction lasts.
//!
//! # Where to start
//!
//! [`HighwayDomain`] is the domain; [`HighwayWorldSettings`] what can be chosen about it.
//!
//! # Source
//!
//! Hsu et al. (arXiv:2509.07438), the task of driving, on highway-env's merge roads. It gives no coordinates: the road
//! with three merges and the timing of merging cars are ours.

mod admit;
mod domain;
mod facts;
mod heuristic;
mod overview;
mod picture;
mod progress;
mod reaction;
mod settings;

pub use domain::{HighwayDomain, HighwayTaskSettings, entry};
pub use settings::{
    CarSettings, EgoSettings, HeuristicSettings, HighwayWorldSettings, MergingSettings, StartLane,
    TrafficSettings, UnsafeChanges,
};
