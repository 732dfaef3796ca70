//! One episode as a picture: where the listener went, which messages they heard, how they reacted.
//!
//! ```text
//! whole, frames, animation   a [`Spoken`](crate::playthrough::Spoken) episode as SVG and PNG, as a strip of moments, as GIF
//! trajectories               many episodes over one map, and one over several maps
//! world_view, strip          the world with the trajectory in it; the listener's gauge over time
//! tiles, labels              where worlds and labels stand      marker, legend: marks and what they mean
//! ```
//!
//! Everything is drawn from [`Scene`](leadtime_sims::Scene)s, so a road or a kitchen draws as a lander does.

mod animation;
mod frames;
mod labels;
mod legend;
mod marker;
mod strip;
mod tiles;
mod trajectories;
mod whole;
mod world_view;

pub use animation::Pixels;
pub(crate) use animation::Still;
pub use trajectories::{TrajectoryPanel, maps, trajectories};
