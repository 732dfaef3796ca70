//! The file as written: keys, types, nothing checked but the form.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::error::TaxonomyError;
use crate::utterance::{Fidelity, WordSpan};

/// The schema that this crate reads and writes.
pub(crate) const SCHEMA: u32 = 1;

/// A whole file, as it is written.
#[derive(Debug, Serialize, Deserialize)]
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

/// One sentence. What a person who adds one need not write is 0 or empty where it is missing.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawUtterance {
    pub(crate) topic: String,
    #[serde(default)]
    pub(crate) comprehension: u32,
    #[serde(default)]
    pub(crate) conveyance: u32,
    pub(crate) text: String,
    #[serde(default)]
    pub(crate) spans: Vec<WordSpan>,
    /// What it presupposes; left out, nobody has said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) facts: Option<Vec<String>>,
    #[serde(default)]
    pub(crate) curve: Vec<u8>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub(crate) clamped: bool,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(crate) word_end_ms: Vec<u32>,
    #[serde(default)]
    pub(crate) medoid: u32,
    #[serde(default)]
    pub(crate) source: String,
}

impl RawDatabase {
    /// Reads a file; an error names the line.
    pub(crate) fn read(text: &str) -> Result<Self, TaxonomyError> {
        read(text, "utterance database").map_err(TaxonomyError)
    }
}

impl RawUtterance {
    /// Names the keys that are missing.
    pub(crate) fn lacks(&self) -> Vec<&'static str> {
        let keys = [
            ("comprehension", self.comprehension == 0),
            ("conveyance", self.conveyance == 0),
            ("spans", self.spans.is_empty()),
            ("curve", self.curve.is_empty()),
        ];
        keys.into_iter().filter_map(|(key, is_missing)| is_missing.then_some(key)).collect()
    }

    /// Says which sentence of a file is wrong, and what is.
    pub(crate) fn wrong(&self, index: usize, defect: &str) -> TaxonomyError {
        let (n, Self { topic, text, .. }) = (index + 1, self);
        TaxonomyError(format!("utterance {n} of topic `{topic}`, \"{text}\": {defect}"))
    }
}

/// Reads a file of some form; what is wrong with it is said with the line and with `what` it is.
pub(crate) fn read<T: DeserializeOwned>(text: &str, what: &str) -> Result<T, String> {
    toml::from_str(text).map_err(|error: toml::de::Error| {
        let at = error.span().map_or(0, |span| span.start);
        let line = 1 + text.bytes().take(at).filter(|byte| *byte == b'\n').count();
        format!("line {line} of the {what}: {}", error.message().replace('\n', ", "))
    })
}
