//! One sentence on its way: what was asked for, what was measured, and why it was turned down if it was.

use std::fmt;

use serde::Serialize;

use crate::utterance::{Cell, WordSpan};

/// Why a sentence is turned down.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// Its rating could not be read, however often it was asked for.
    Malformed,
    /// The reply that proposed it was cut off in the middle of it.
    Truncated,
    /// It has no words.
    Empty,
    /// It has too few or too many words.
    WordCount,
    /// It has a digit: numbers are spelled as they are spoken.
    Digit,
    /// It has a character that is neither a letter nor plain punctuation.
    Charset,
    /// It is a question.
    Question,
    /// It says what not to do.
    Negation,
    /// Nobody should have to hear it.
    Profanity,
    /// It says the same word twice in a row.
    Repetition,
    /// It does not say what to do.
    NoDirective,
    /// It says two things to do.
    TwoDirectives,
    /// It says another thing to do.
    WrongAction,
    /// A person turned it down.
    HumanReject,
    /// The same words were there already.
    Duplicate,
    /// The same words came for two topics: neither gets them.
    AmbiguousTopic,
    /// A later word made it much less clear.
    NonMonotone,
    /// No word made it clear enough.
    NeverUnderstood,
    /// When it is understood, another action is nearly as clear.
    LowMargin,
    /// It means almost the same as another sentence of its cell.
    NearDuplicate,
}

/// Writes it as files spell it.
impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// A sentence that was proposed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Candidate {
    /// Index of the topic it was asked for.
    pub topic: usize,
    /// Where it should land.
    pub requested: Cell,
    /// The sentence as it was proposed.
    pub text: String,
    /// What, How, Why; empty if it has no structure.
    pub spans: Vec<WordSpan>,
    /// As rated. Shape `[l]`, or `[0]` if it was not.
    pub rated: Vec<u8>,
    /// The rating's running maximum. Shape as `rated`.
    pub curve: Vec<u8>,
    /// The cell in which it landed, by its rating.
    pub landed: Option<Cell>,
    /// It was understood before the least k.
    pub clamped: bool,
    /// Why it was turned down; none: accepted.
    pub reason: Option<Reason>,
    /// Rank among the representatives of its cell.
    pub medoid: Option<u32>,
    /// Key of the call that proposed it.
    pub source: String,
}

impl Candidate {
    /// Begins with a text as it was proposed for a topic and a cell by the call `source`.
    pub(super) fn new(topic: usize, requested: Cell, text: String, source: &str) -> Self {
        Self {
            topic,
            requested,
            text,
            spans: Vec::new(),
            rated: Vec::new(),
            curve: Vec::new(),
            landed: None,
            clamped: false,
            reason: None,
            medoid: None,
            source: source.to_owned(),
        }
    }

    /// Returns whether it passed rules and rating.
    pub(super) fn is_accepted(&self) -> bool {
        self.reason.is_none() && self.landed.is_some()
    }
}
