//! Small tasks with known answers: for parity with published learning curves, and for a first look around.
//!
//! | task | what it shows |
//! |---|---|
//! | [`CartPole`] | Gymnasium's `CartPole-v1`, number for number: the learner learns |
//! | [`CueRecall`] | a cue is shown once and asked for later: without memory, chance |

mod cartpole;
mod cue_recall;
mod entries;

pub use cartpole::{CartPole, CartPoleSettings};
pub use cue_recall::{CueRecall, CueRecallSettings};
pub use entries::entries;
