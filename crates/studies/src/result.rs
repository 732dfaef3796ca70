//! What a study found, as data.

use leadtime_eval::measure::{Choice, Difference, Summary};
use leadtime_eval::report::ProvenanceDetail;
use leadtime_numerics::stats::Bootstrap;
use serde::{Deserialize, Serialize};

use crate::study::{Layout, Published};
use crate::trainings::RowTrainings;

/// Everything that a study found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct StudyResult {
    pub(crate) study: String,
    pub(crate) title: String,
    /// What is compared and why, for somebody who knows nothing of it.
    pub(crate) lead: String,
    /// What a reader must know before quoting a number: that training was cut short, that rows are missing.
    pub(crate) warnings: Vec<String>,
    /// How intervals were made.
    pub(crate) bootstrap: Bootstrap,
    /// Where the numbers come from.
    pub(crate) provenance: Vec<ProvenanceDetail>,
    pub(crate) parts: Vec<PartResult>,
}

/// One table of a study: policies of one profile.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct PartResult {
    pub(crate) name: String,
    pub(crate) title: String,
    /// Which configuration it starts from, and how that was chosen.
    pub(crate) profile: String,
    pub(crate) layout: Layout,
    pub(crate) columns: Vec<String>,
    pub(crate) rows: Vec<RowResult>,
    pub(crate) differences: Vec<Difference>,
    pub(crate) pictures: Vec<FigureLink>,
}

/// A figure in a file next to the table.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct FigureLink {
    pub(crate) file: String,
    pub(crate) caption: String,
}

/// A figure that is drawn and not yet written.
#[derive(Clone, Debug)]
pub(crate) struct StudyFigure {
    pub(crate) file: String,
    pub(crate) caption: String,
    pub(crate) png: Vec<u8>,
}

/// One policy, or the policies of several training seeds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct RowResult {
    pub(crate) name: String,
    /// Its title; neighbours with the same title share a line of a grid.
    pub(crate) title: String,
    /// The type of its notifications, or that it is a script.
    pub(crate) notification: String,
    /// Settings in which it differs from the profile, as `key = value`.
    pub(crate) settings: Vec<String>,
    pub(crate) published: Vec<Published>,
    /// What was measured, by condition and way of choosing.
    #[serde(rename = "judged")]
    pub(crate) results: Vec<ConditionResult>,
    /// How its trainings came out; `None` for a script, a single training, or a task without success.
    #[serde(default)]
    pub(crate) trainings: Option<RowTrainings>,
    /// Where its policies come from; none for a script.
    pub(crate) runs: Vec<TrainedRun>,
}

/// A policy under one condition.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ConditionResult {
    /// The evaluations that this is: several where they come to the same settings.
    pub(crate) evaluations: Vec<String>,
    pub(crate) title: String,
    pub(crate) choice: Choice,
    pub(crate) summary: Summary,
}

/// A training run behind a row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct TrainedRun {
    /// Its name, which is that of its directory.
    pub(crate) name: String,
    pub(crate) seed: u64,
    /// First digits of the hash over everything that decides what it computes, the seed excepted.
    pub(crate) configuration: String,
    pub(crate) steps: u64,
    pub(crate) minutes: f64,
    /// First digits of the digest of its final weights.
    pub(crate) weights: String,
    /// Whether the same seed would give the same weights again.
    pub(crate) reproducible: bool,
    /// The program that trained it.
    pub(crate) program: String,
}

impl RowResult {
    /// Returns what was measured under a condition with a way of choosing.
    pub(crate) fn result(&self, evaluation: &str, choice: Choice) -> Option<&ConditionResult> {
        self.results.iter().find(|result| result.choice == choice && result.is(evaluation))
    }

    pub(crate) fn published(&self, evaluation: Option<&str>, measure: &str) -> Option<&Published> {
        self.published.iter().find(|published| {
            published.measure == measure && published.evaluation.as_deref() == evaluation
        })
    }
}

impl ConditionResult {
    pub(crate) fn is(&self, evaluation: &str) -> bool {
        self.evaluations.iter().any(|name| name == evaluation)
    }
}
