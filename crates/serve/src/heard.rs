//! A client's reports about its loudspeaker: `{"utterance":5,"event":"word","word":2,"t":13.05}`.

use serde::{Deserialize, Serialize};

/// What the loudspeaker did.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HeardEvent {
    /// The first word begins.
    Start,
    /// A further word begins, so all before it have ended.
    Word,
    /// The last word has ended.
    End,
    /// It fell silent before that.
    Cut,
}

/// A client's report about an utterance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeardReport {
    /// The utterance, by its number.
    pub utterance: u32,
    /// What the loudspeaker did.
    pub event: HeardEvent,
    /// The word that begins, counted from 0.
    #[serde(default)]
    pub word: u32,
    /// The client's time, in seconds; it is kept in recordings and used for nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub t: Option<f64>,
}

impl HeardReport {
    /// Reads a report.
    ///
    /// # Errors
    ///
    /// [`serde_json::Error`] if the bytes are no JSON of a report, or have an unknown field.
    pub fn read(bytes: &[u8]) -> Result<Self, serde_json::Error> {
        serde_json::from_slice(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_is_read_as_people_write_it() {
        let read = |text: &str| HeardReport::read(text.as_bytes());
        let report = read(r#"{"utterance":5,"event":"word","word":2,"t":13.05}"#).unwrap();
        assert_eq!((report.utterance, report.event, report.word), (5, HeardEvent::Word, 2));
        assert_eq!(read(r#"{"utterance":5,"event":"end"}"#).unwrap().event, HeardEvent::End);
        for text in
            ["", "{}", r#"{"utterance":5,"event":"said"}"#, r#"{"utterance":-1,"event":"end"}"#]
        {
            read(text).unwrap_err();
        }
    }
}
