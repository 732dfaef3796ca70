//! A client's reports about its loudspeaker: `{"utterance":5,"event":"word","word":2,"t":13.05}`.

use serde::{Deserialize, Serialize};

use crate::json_fault::{FieldRule, JsonFault, no_choice, no_number, no_small_count, or_null};

/// The longest report, in bytes; one takes some 60. A sentence about a long one would take the time of other sessions.
const MAX_REPORT: usize = 1024;

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

/// The fields of a report, for the sentence about what is wrong with one.
const RULES: [FieldRule; 4] = [
    FieldRule::required("utterance", "the number of the utterance, a whole number", no_small_count),
    FieldRule::required("event", "start, word, end or cut", |value| {
        no_choice(value, &["start", "word", "end", "cut"])
    }),
    FieldRule::optional("word", "the word that begins, a whole number from 0", no_small_count),
    FieldRule::optional("t", "the client's time, in seconds", |value| or_null(value, no_number)),
];

impl HeardReport {
    /// Reads a report.
    ///
    /// # Errors
    ///
    /// [`JsonFault`] if the bytes are no JSON of a report, have an unknown field, or are more than 1024.
    pub fn read(bytes: &[u8]) -> Result<Self, JsonFault> {
        if bytes.len() > MAX_REPORT {
            let told = format!("it has {} bytes; {MAX_REPORT} at most", bytes.len());
            return Err(JsonFault::Other(told));
        }
        serde_json::from_slice(bytes).map_err(|error| JsonFault::find(bytes, &RULES, &error))
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
        for (text, told) in [
            (r#"{"event":"end"}"#, "`utterance` is missing: the number of the utterance"),
            (
                r#"{"utterance":1,"event":"sad"}"#,
                "`event` has to be start, word, end or cut; it is",
            ),
            (r#"{"utterance":1,"event":"word","words":1}"#, "did you mean `word`?"),
            (r#"{"utterance":4294967296,"event":"end"}"#, "a whole number; it is 4294967296"),
        ] {
            let fault = read(text).unwrap_err().to_string();
            assert!(fault.contains(told), "{fault}");
        }
        // Nothing of a long one is looked at.
        let long = read(&format!(r#"{{"utterance":1,"event":"end","x":[{}0]}}"#, "0,".repeat(600)));
        assert_eq!(long.unwrap_err().to_string(), "it has 1237 bytes; 1024 at most");
    }
}
