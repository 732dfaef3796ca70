//! What a replay found.

use std::fmt;

use serde::Serialize;

use crate::section::Section;

/// One recording and what became of it here.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RecordingReport {
    /// The name of the recording.
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
    /// What recorded it: a repository at a commit, or our own cook.
    pub source: String,
    /// What became of each recording.
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
        Self { name: name.to_owned(), ..Self::default() }
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
