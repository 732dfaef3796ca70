//! What a report says.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::figure::{BandPanel, ShareRow};
use crate::measure::Comparison;

/// Everything in a report; what is empty is left out of the page.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// The page's title.
    pub title: String,
    /// A paragraph for somebody who knows nothing of the run: what was trained, what came out.
    pub lead: String,
    /// The run's claims and whether they hold.
    pub verdicts: Vec<Verdict>,
    /// The players side by side.
    pub comparison: Option<Comparison>,
    /// Playthroughs and other pictures.
    pub pictures: Vec<Picture>,
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
    /// Where the numbers come from: command, seed, versions, commit, digest of the weights.
    pub provenance: Vec<Fact>,
    /// What a reader should know before quoting a number.
    pub notes: Vec<String>,
}

/// A claim about the run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Verdict {
    /// Whether it holds.
    pub holds: bool,
    /// The claim with its numbers.
    pub sentence: String,
}

/// A picture with its words.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Its heading.
    pub title: String,
    /// What there is to see.
    pub caption: String,
    /// The SVG file, as this crate writes it; it becomes part of the page as it is.
    pub svg: String,
}

/// One account of the books.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Book {
    /// The account, such as `published` or `trained`.
    pub name: String,
    /// Rollouts in it.
    pub count: u64,
    /// What it means, in a few words.
    pub meaning: String,
}

/// A name and a value.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fact {
    /// What it is.
    pub name: String,
    /// Its value.
    pub value: String,
}

impl Fact {
    /// States a fact.
    pub fn new(name: impl Into<String>, value: impl Into<String>) -> Self {
        Self { name: name.into(), value: value.into() }
    }
}
