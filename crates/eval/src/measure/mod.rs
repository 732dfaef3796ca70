//! Measuring a policy by the episodes that it plays.
//!
//! ```text
//! Player (policy, untrained network, scripted) + environments --evaluate--> Evaluation (one row per episode)
//!     --Summary--> means with intervals    --Comparison--> table, JSON, differences
//! ```

mod compare;
mod evaluation;
mod lead;
mod meaning;
mod outcome;
mod said;
mod summary;
mod utterance;

pub(crate) use compare::cell;
pub use compare::{Comparison, Difference, written};
pub use evaluation::{EpisodeResult, Evaluation, evaluate, evaluate_with};
pub use lead::with_lead_times;
pub use leadtime_episodes::{Choice, MakeEnvironment, PlaySettings, Player, episode_seed};
pub use meaning::meaning;
pub use outcome::with_outcomes;
pub use said::with_said;
pub use summary::{
    Measure, Summary, evaluated_measures, known_measures, main_measures, measure_names, names_in,
    title,
};
pub use utterance::{LoggedMessage, SpeechLog};
