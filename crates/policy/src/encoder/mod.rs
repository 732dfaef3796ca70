//! What stands between observation and stacks, as actors run it: without a graph and without allocation.
//!
//! ```text
//! none        observation ─────────────────────────────────────────────────────────► features
//! lstm        observation, state of the step before ─► gates ─► state ─────────────► features = its hidden half
//! attention   history of entities ─► per frame: what the ego pays attention to ────► features
//! ```

mod attention;
mod fast;
mod folded;
mod lstm;

pub use attention::AttentionEncoder;
pub(crate) use fast::FastEncoder;
pub use lstm::LstmEncoder;
