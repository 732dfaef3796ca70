//! Playing episodes, and what they say about a policy.
//!
//! ```text
//! Player (policy, untrained network, scripted) + environments --evaluate--> Evaluation (one row per episode)
//!     --Summary--> means with intervals    --Comparison--> table, JSON, differences
//! ```

mod compare;
mod episodes;
mod lead;
mod player;
mod summary;
mod table;

pub(crate) use compare::written;
pub use compare::{Comparison, Difference};
pub use episodes::{
    Episode, EvaluateSettings, Evaluation, MakeEnvironment, episode_seed, evaluate,
};
pub(crate) use episodes::{Numbered, in_threads};
pub(crate) use lead::hazards;
pub use lead::lead_times;
pub(crate) use player::Acting;
pub use player::{Choice, Player};
pub use summary::{Measure, Summary, title};
pub use table::Table;
