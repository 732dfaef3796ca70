//! Ego attention: a history of observations of entities becomes features of a width that does not depend on how many
//! entities there are.
//!
//! ```text
//! presence   frames without the entities that are absent        shares    how much of each entity the ego takes
//! folded     the four maps, multiplied out to two               encoder   all of it, as actors run it
//! ```
//!
//! The learner runs the same `presence` and `shares` in a graph with gradients, so that both compute the same bits.

mod encoder;
mod folded;
mod presence;
mod shares;

pub use encoder::AttentionEncoder;
#[cfg(test)]
pub(crate) use presence::TWO_FRAMES;
pub use presence::{FramePresence, PresentEntities, presence_flags};
pub use shares::{Attention, dot};
