//! What a study found, as data.

use leadtime_numerics::stats::Bootstrap;
use serde::{Deserialize, Serialize};

use crate::measure::{Choice, Difference, Summary};
use crate::report::Fact;

/// Everything that a study found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StudyResult {
    /// Its short name.
    pub study: String,
    /// Its title.
    pub title: String,
    /// What is compared and why, for somebody who knows nothing of it.
    pub lead: String,
    /// What a reader must know before quoting a number: that training was cut short, that rows are missing.
    pub warnings: Vec<String>,
    /// How intervals were made.
    pub bootstrap: Bootstrap,
    /// Where the numbers come from.
    pub provenance: Vec<Fact>,
    /// The tables.
    pub parts: Vec<PartResult>,
}

/// How a part is laid out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Layout {
    /// A line per policy and person, a column per measure.
    #[default]
    Lines,
    /// A table per measure: a line per policy, a column per person.
    Grid,
}

/// One table of a study: policies of one profile.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PartResult {
    /// Its short name.
    pub name: String,
    /// Its title.
    pub title: String,
    /// Which configuration it starts from, and how that was chosen.
    pub profile: String,
    /// How it is laid out.
    pub layout: Layout,
    /// Measures of the main table.
    pub columns: Vec<String>,
    /// The policies.
    pub rows: Vec<RowResult>,
    /// Differences between policies.
    pub differences: Vec<Difference>,
    /// Pictures.
    pub pictures: Vec<Shown>,
}

/// A picture in a file beside the table.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Shown {
    /// The file's name.
    pub file: String,
    /// What there is to see.
    pub caption: String,
}

/// One policy, or the policies of several training seeds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RowResult {
    /// Its short name.
    pub name: String,
    /// Its title; neighbours with the same title share a line of a grid.
    pub title: String,
    /// The type of its notifications, or that it is a script.
    pub notification: String,
    /// Settings in which it differs from the profile, as `key = value`.
    pub settings: Vec<String>,
    /// What was published about it.
    pub published: Vec<Published>,
    /// What was measured.
    pub judged: Vec<Judged>,
    /// Where its policies come from; none for a script.
    pub runs: Vec<TrainedRun>,
}

/// A published figure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Published {
    /// The person it is about, by the name of an evaluation; `None` where the source does not say.
    pub evaluation: Option<String>,
    /// The measure.
    pub measure: String,
    /// Its mean over training seeds.
    pub mean: f64,
    /// Its standard deviation over training seeds, if given.
    pub deviation: Option<f64>,
}

/// A policy on one person.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Judged {
    /// The evaluations that this is: several where they come to the same settings.
    pub evaluations: Vec<String>,
    /// Their titles.
    pub title: String,
    /// How the policy chose.
    pub choice: Choice,
    /// What came out.
    pub summary: Summary,
}

/// A training run behind a row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainedRun {
    /// Its name, which is that of its directory.
    pub name: String,
    /// Training seed.
    pub seed: u64,
    /// First digits of the hash over everything that decides what it computes, the seed excepted.
    pub configuration: String,
    /// Environment steps.
    pub steps: u64,
    /// Minutes of training.
    pub minutes: f64,
    /// First digits of the digest of its final weights.
    pub weights: String,
    /// Whether the same seed would give the same weights again.
    pub reproducible: bool,
    /// The program that trained it.
    pub program: String,
}

impl PartResult {
    /// Returns a row by name.
    pub fn row(&self, name: &str) -> Option<&RowResult> {
        self.rows.iter().find(|row| row.name == name)
    }
}

impl RowResult {
    /// Returns what was measured on a person under a way of choosing.
    pub fn judged(&self, evaluation: &str, choice: Choice) -> Option<&Judged> {
        self.judged.iter().find(|judged| judged.choice == choice && judged.is(evaluation))
    }

    /// Returns a published figure.
    pub fn published(&self, evaluation: Option<&str>, measure: &str) -> Option<&Published> {
        self.published.iter().find(|published| {
            published.measure == measure && published.evaluation.as_deref() == evaluation
        })
    }
}

impl Judged {
    /// Tells whether this is the evaluation of that name.
    pub fn is(&self, evaluation: &str) -> bool {
        self.evaluations.iter().any(|name| name == evaluation)
    }
}
