//! The encoder in front of actor and critic, as actors run it: without a graph and without allocation.
//!
//! ```text
//! none        observation ─────────────────────────────────────────────────────────► features
//! lstm        observation, state of the step before ─► gates ─► state ─────────────► features = its hidden half
//! attention   history of entities ─► per frame: attention of the ego (file `attention`) ─► features
//! ```

mod fast;
mod lstm;

pub(crate) use fast::FastEncoder;
pub use lstm::LstmEncoder;
