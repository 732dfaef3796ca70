//! Why a text cannot be replayed.

use leadtime_lander::world::NoSuchEngine;
use leadtime_sims::TaskError;
use leadtime_sims::check::SettingError;
use leadtime_steakhouse::world::LayoutError;
use thiserror::Error;

/// Why a text cannot be replayed.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the sentence of each variant names its fields")]
pub enum ReplayError {
    /// It is of no known format.
    #[error("{what} cannot be read")]
    Format { what: &'static str, source: serde_json::Error },
    /// It is of another world than the one that was asked for.
    #[error(
        "the traces are of `{found}`, not of `{asked}`: `leadtime conformance {found}` replays them"
    )]
    OtherWorld { asked: &'static str, found: &'static str },
    /// There is nothing to compare.
    #[error("the {what} to compare")]
    Empty { what: &'static str },
    /// The lander: a recorded action is no engine.
    #[error("episode {episode} of the traces has an impossible action")]
    Action { episode: usize, source: NoSuchEngine },
    /// The highway: a recorded road is malformed.
    #[error("the road of scenario `{scenario}` is impossible")]
    Road { scenario: &'static str, source: SettingError },
    /// The highway: a recorded action or class of vehicle that does not exist.
    #[error("scenario `{scenario}` has the unknown {what} `{given}`")]
    Unknown { scenario: &'static str, what: &'static str, given: String },
    /// The steakhouse: a recorded kitchen has no legal layout.
    #[error("the kitchen of `{run}` is impossible")]
    Layout { run: String, source: LayoutError },
    /// The steakhouse: a recorded value is impossible.
    #[error("`{run}` holds an impossible {what}")]
    Impossible { run: String, what: &'static str },
    /// The steakhouse: recorded settings are impossible.
    #[error("the settings of `{run}` are impossible")]
    Settings { run: String, source: TaskError },
}
