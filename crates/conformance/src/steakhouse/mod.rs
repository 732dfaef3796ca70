//! Is our kitchen the original's, and our cook the recorded one? Recorded runs, replayed, every number exact.
//!
//! Two formats are known, distinguished by what they hold:
//!
//! * states of the public environment (FOV-aware-planner): runs of two cooks with every action and the full state after
//!   it, single interactions over every held item and station state, and the tiles that are in view;
//! * episodes of our own cook and its listener, with ties broken by the first: subtasks, beliefs, rewards and
//!   observations, to six digits. They were recorded by a separate program in Python that shares no code with this.

mod golden;
mod public;
mod replay;
mod report;

pub use replay::replay;
pub use report::{RecordingReport, SteakhouseReport};
