//! The file as written: keys, types, nothing checked but the form.

use serde::Deserialize;

use crate::error::TaxonomyError;
use crate::utterance::{Fidelity, WordSpan};

/// The schema that this crate reads and writes.
pub(crate) const SCHEMA: u32 = 1;

/// A whole file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawDatabase {
    pub(crate) schema: u32,
    pub(crate) domain: String,
    pub(crate) fidelity: Fidelity,
    pub(crate) generator: String,
    pub(crate) rater: String,
    pub(crate) embedder: String,
    pub(crate) theta: u8,
    pub(crate) words: [u32; 2],
    pub(crate) topics: Vec<String>,
    pub(crate) config: String,
    #[serde(default)]
    pub(crate) utterance: Vec<RawUtterance>,
}

/// One sentence.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawUtterance {
    pub(crate) topic: String,
    pub(crate) comprehension: u32,
    pub(crate) conveyance: u32,
    pub(crate) text: String,
    pub(crate) spans: Vec<WordSpan>,
    pub(crate) curve: Vec<u8>,
    #[serde(default)]
    pub(crate) clamped: bool,
    #[serde(default)]
    pub(crate) word_end_ms: Vec<u32>,
    #[serde(default)]
    pub(crate) medoid: u32,
    #[serde(default)]
    pub(crate) source: String,
}

/// Reads the form of a file.
pub(crate) fn read(text: &str) -> Result<RawDatabase, TaxonomyError> {
    toml::from_str(text).map_err(|error| TaxonomyError::Form {
        line: line_of(text, &error),
        message: error.message().replace('\n', ", "),
    })
}

/// Finds the line, from 1, that a reader complains about.
pub(crate) fn line_of(text: &str, error: &toml::de::Error) -> usize {
    let at = error.span().map_or(0, |span| span.start);
    1 + text.bytes().take(at).filter(|byte| *byte == b'\n').count()
}
