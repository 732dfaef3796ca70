//! Reading either format.

use serde::Deserialize;

use super::report::SteakhouseReport;
use super::{golden, public};
use crate::error::ReplayError;

#[derive(Deserialize)]
struct Recordings {
    #[serde(default)]
    source: Origin,
    #[serde(flatten)]
    public: public::PublicRecordings,
    #[serde(default)]
    episodes: Vec<golden::CookEpisode>,
}

#[derive(Default, Deserialize)]
struct Origin {
    repository: String,
    commit: String,
}

/// Replays recordings of either format.
///
/// # Errors
///
/// [`ReplayError`] if the text is of no known format, or holds nothing to compare.
pub fn replay(json: &str) -> Result<SteakhouseReport, ReplayError> {
    let recordings: Recordings = serde_json::from_str(json)
        .map_err(|source| ReplayError::Format { what: "recordings", source })?;
    let mut comparisons = recordings.public.replay()?;
    for episode in &recordings.episodes {
        comparisons.push(episode.replay()?);
    }
    if comparisons.iter().all(|comparison| comparison.n_compared == 0) {
        return Err(ReplayError::Empty { what: "recordings hold nothing" });
    }
    let passed = comparisons.iter().all(|comparison| comparison.n_differences == 0);
    let Origin { repository, commit } = recordings.source;
    let source = if repository.is_empty() {
        "our own cook".to_owned()
    } else {
        format!("{repository} at {commit}")
    };
    Ok(SteakhouseReport { source, comparisons, passed })
}
