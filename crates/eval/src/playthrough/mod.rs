//! One episode as a picture: where the person went, what was said, what they did about it.
//!
//! ```text
//! record: Environment + Player --> Playthrough (a scene per step)
//! story:  scenes --> what the person was doing in each step, utterances and reactions as spans of time
//! voice:  topic, k, l of each utterance --> the sentence that says it
//! picture, frames, animation: SVG, PNG, GIF     transcript: text
//! flights: the ways of many episodes over one map, and of one over several maps
//! tiles: where the worlds of frames and flights stand     legend: what their marks mean
//! ```
//!
//! Everything is drawn from [`Scene`](leadtime_sims::Scene)s, so a road or a kitchen draws as a lander does.

mod animation;
mod demonstration;
mod flights;
mod frames;
mod labels;
mod legend;
mod picture;
mod record;
mod story;
mod strip;
mod tiles;
mod transcript;
mod voice;
mod world;

pub use flights::{FlightEnd, FlightPanel, maps, trajectories};
pub use record::Playthrough;
pub use story::{Doing, Span, Story};
pub use voice::{Sentence, Voice};

#[cfg(test)]
pub(crate) mod synthetic;
