//! The pilots: a scripted one, a trained one, how well either flies, and the task that the latter is trained on.

mod evaluate;
mod heuristic;
mod network;
mod training;

pub use evaluate::{Flown, Flyer, MAX_FRAMES, PilotEvaluation, evaluate, fly};
pub use heuristic::heuristic;
pub(crate) use heuristic::strongest;
pub use network::{Pilot, PilotError, engines_off};
pub use training::{PilotTask, PilotTaskSettings};
