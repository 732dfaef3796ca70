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
    #[error("{what} cannot be read")]
    Format { what: &'static str, source: serde_json::Error },
    #[error(
        "the traces are of `{found}`, not of `{asked}`: `leadtime conformance {found}` replays them"
    )]
    OtherWorld { asked: &'static str, found: &'static str },
    /// There is nothing to compare.
    #[error("the {what} to compare")]
    Empty { what: &'static str },
    #[error("episode {episode} of the traces has an impossible action")]
    Action { episode: usize, source: NoSuchEngine },
    #[error("the road of scenario `{scenario}` is impossible")]
    Road { scenario: &'static str, source: SettingError },
    #[error("scenario `{scenario}` has the unknown {what} `{given}`")]
    Unknown { scenario: &'static str, what: &'static str, given: String },
    #[error("the kitchen of `{run}` is impossible")]
    Layout { run: String, source: LayoutError },
    #[error("`{run}` holds an impossible {what}")]
    Impossible { run: String, what: &'static str },
    #[error("the settings of `{run}` are impossible")]
    Settings { run: String, source: TaskError },
}
