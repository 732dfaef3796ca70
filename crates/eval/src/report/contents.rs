//! What a report says.

use std::collections::BTreeMap;

use leadtime_table::Table;
use serde::{Deserialize, Serialize};

use crate::figure::{BandPanel, ShareRow};
use crate::measure::Comparison;
use crate::playthrough::Spoken;

/// Everything in a report; what is empty is left out of the page.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// Title at the head of the page.
    pub title: String,
    /// A paragraph for somebody who knows nothing of the run: what was trained, what came out. Text between backticks
    /// is set as code.
    pub lead: String,
    /// The run's claims and whether they hold.
    pub verdicts: Vec<Verdict>,
    /// What a reader should know before quoting a number.
    pub notes: Vec<String>,
    /// Playthroughs and other pictures.
    pub pictures: Vec<Picture>,
    /// The players side by side.
    pub comparison: Option<Comparison>,
    /// Returns, success, ... over environment steps.
    pub curves: Vec<BandPanel>,
    /// Rollouts per staleness, in policy versions.
    pub staleness: BTreeMap<u64, u64>,
    /// What each process spent its time on.
    pub phases: Vec<ShareRow>,
    /// What became of the rollouts.
    pub books: Vec<Book>,
    /// Whether the books balance; `None` if that was not checked.
    pub books_balance: Option<bool>,
    /// Where the numbers come from, per run: seed, versions, commit, digest of the weights.
    pub provenance: Vec<Provenance>,
    /// The settings that differ from the built-in ones, and how.
    pub changed: Option<Table>,
}

/// A claim about the run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Verdict {
    /// Whether the numbers bear the claim out.
    pub holds: bool,
    /// The claim with its numbers.
    pub sentence: String,
}

/// A picture with its words.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// The heading above it.
    pub title: String,
    /// What there is to see.
    pub caption: String,
    /// The SVG file, as this crate writes it; it becomes part of the page as it is.
    pub svg: String,
    /// The same in words; may be empty.
    pub transcript: String,
}

impl Picture {
    /// Draws an episode for a page. `id` must be unique on it.
    pub fn playthrough(spoken: &Spoken, id: &str) -> Self {
        Self {
            title: spoken.played.title(),
            caption: spoken.numbers(),
            svg: spoken.svg_untitled(id).text,
            transcript: spoken.transcript(),
        }
    }
}

/// Where the numbers of one run come from, and how to get them again.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Provenance {
    /// Name of the run that the numbers are of.
    pub run: String,
    /// What is known of it.
    pub details: Vec<ProvenanceDetail>,
    /// The command that trains it.
    pub command: String,
    /// The whole configuration, as TOML.
    pub settings: String,
}

/// One account of the books.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Book {
    /// The account, such as `published` or `trained`.
    pub name: String,
    /// How many rollouts it holds.
    pub count: u64,
    /// What it means, in a few words.
    pub meaning: String,
}

/// A name and a value.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ProvenanceDetail {
    /// What is stated, such as `seed`.
    pub name: String,
    /// Its value, as text.
    pub value: String,
}

impl ProvenanceDetail {
    /// States a value under a name.
    pub fn new(name: impl Into<String>, value: impl Into<String>) -> Self {
        Self { name: name.into(), value: value.into() }
    }
}
