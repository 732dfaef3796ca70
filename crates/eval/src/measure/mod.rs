//! Playing episodes, and what they say about a policy.
//!
//! ```text
//! Player (policy, untrained network, scripted) + environments --evaluate--> Evaluation (one row per episode)
//!     --Summary--> means with intervals    --Comparison--> table, JSON, differences
//! ```

mod compare;
mod episodes;
mod lead;
mod summary;
mod table;
mod utterance;

pub(crate) use compare::written;
pub use compare::{Comparison, Difference};
pub use episodes::{Episode, Evaluation, evaluate, evaluate_with};
pub use lead::{hazards, lead_times};
pub use leadtime_episodes::{Choice, MakeEnvironment, PlaySettings, Player, episode_seed};
pub use summary::{Measure, Summary, title};
pub use table::Table;
pub use utterance::{SpeechLog, Utterance};
