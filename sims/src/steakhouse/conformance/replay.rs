//! Reading either format, and the book of what was compared.

use std::fmt;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{golden, public};
use crate::registry::TaskError;
use crate::steakhouse::LayoutError;

/// Why a text cannot be replayed.
#[derive(Debug, Error)]
pub enum ReplayError {
    /// It is of no known format.
    #[error("recordings cannot be read")]
    Format(#[from] serde_json::Error),
    /// A recorded kitchen is none.
    #[error("the kitchen of `{run}` is impossible: {source}")]
    Layout {
        /// The recording.
        run: String,
        /// What is wrong with it.
        source: LayoutError,
    },
    /// A recorded value is impossible.
    #[error("`{run}` holds an impossible {what}")]
    Impossible {
        /// The recording.
        run: String,
        /// What.
        what: &'static str,
    },
    /// Recorded settings are impossible.
    #[error("the settings of `{run}` are impossible: {source}")]
    Settings {
        /// The recording.
        run: String,
        /// Which, and why.
        source: TaskError,
    },
    /// There is nothing to compare.
    #[error("the recordings hold nothing to compare")]
    Empty,
}

/// One recording and what became of it here.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Comparison {
    /// Its name.
    pub name: String,
    /// Number of steps, interactions or views.
    pub n_compared: usize,
    /// Number of values that differ.
    pub n_differences: usize,
    /// The first of them.
    pub first_difference: Option<String>,
}

/// What a replay found.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Report {
    /// What recorded it.
    pub source: String,
    /// By recording.
    pub comparisons: Vec<Comparison>,
    /// Whether nothing differs.
    pub passed: bool,
}

impl Comparison {
    pub(super) fn new(name: &str) -> Self {
        let name = name.to_owned();
        Self { name, n_compared: 0, n_differences: 0, first_difference: None }
    }

    /// Compares one value; `at` says where it stands.
    pub(super) fn check<T: PartialEq + fmt::Debug>(
        &mut self,
        at: fmt::Arguments<'_>,
        ours: &T,
        theirs: &T,
    ) {
        if ours == theirs {
            return;
        }
        self.n_differences += 1;
        self.first_difference
            .get_or_insert_with(|| format!("{at}: {ours:?} here, {theirs:?} recorded"));
    }
}

#[derive(Deserialize)]
struct Recordings {
    #[serde(default)]
    source: Source,
    #[serde(flatten)]
    public: public::Recordings,
    #[serde(default)]
    episodes: Vec<golden::Episode>,
}

#[derive(Default, Deserialize)]
struct Source {
    repository: String,
    commit: String,
}

/// Replays recordings of either format.
///
/// # Errors
///
/// [`ReplayError`] if the text is of no known format, or holds nothing to compare.
pub fn replay(json: &str) -> Result<Report, ReplayError> {
    let recordings: Recordings = serde_json::from_str(json)?;
    let mut comparisons = recordings.public.replay()?;
    for episode in &recordings.episodes {
        comparisons.push(episode.replay()?);
    }
    if comparisons.iter().all(|comparison| comparison.n_compared == 0) {
        return Err(ReplayError::Empty);
    }
    let passed = comparisons.iter().all(|comparison| comparison.n_differences == 0);
    let Source { repository, commit } = recordings.source;
    let source = if repository.is_empty() {
        "our own cook".to_owned()
    } else {
        format!("{repository} at {commit}")
    };
    Ok(Report { source, comparisons, passed })
}
