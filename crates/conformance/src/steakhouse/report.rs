//! What a replay found, or why there is nothing to find.

use std::fmt;

use leadtime_sims::TaskError;
use leadtime_steakhouse::world::LayoutError;
use serde::Serialize;
use thiserror::Error;

use crate::section::Section;

/// Why a text cannot be replayed.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the sentence of each variant names its fields")]
pub enum SteakhouseReplayError {
    /// It is of no known format.
    #[error("recordings cannot be read")]
    Format(#[from] serde_json::Error),
    /// A recorded kitchen has no legal layout.
    #[error("the kitchen of `{run}` is impossible: {source}")]
    Layout { run: String, source: LayoutError },
    /// A recorded value is impossible.
    #[error("`{run}` holds an impossible {what}")]
    Impossible { run: String, what: &'static str },
    /// Recorded settings are impossible.
    #[error("the settings of `{run}` are impossible: {source}")]
    Settings { run: String, source: TaskError },
    /// There is nothing to compare.
    #[error("the recordings hold nothing to compare")]
    Empty,
}

/// One recording and what became of it here.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RecordingReport {
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
pub struct SteakhouseReport {
    /// What recorded it.
    pub source: String,
    /// By recording.
    pub comparisons: Vec<RecordingReport>,
    /// Whether nothing differs.
    pub passed: bool,
}

impl SteakhouseReport {
    pub(crate) fn sections(&self) -> Vec<Section> {
        let row = |found: &RecordingReport| {
            vec![found.name.clone(), found.n_compared.to_string(), found.n_differences.to_string()]
        };
        let note = |found: &RecordingReport| {
            let first = found.first_difference.as_ref()?;
            Some(format!("first difference of {}: {first}", found.name))
        };
        vec![Section {
            title: "values that differ".to_owned(),
            head: vec!["recording", "compared", "differences"],
            rows: self.comparisons.iter().map(row).collect(),
            notes: self.comparisons.iter().filter_map(note).collect(),
        }]
    }
}

impl RecordingReport {
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
