//! What a session took in, and when by the notifier's own clock: everything that its decisions depend on beside the
//! observations themselves. With it a recorded session can be replayed exactly, whatever its clock.
//!
//! ```text
//! {"session":"c52e5475","n":12,"now":3600412000000,"said":57,"what":"observation","seq":17,"at":3600411990000}
//! {"session":"c52e5475","n":13,"now":3600700000000,"said":58,"what":"tick"}
//! ```

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use crate::heard::HeardReport;

/// Something that a session took in.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "what", rename_all = "snake_case")]
pub enum TakenInput {
    /// An observation.
    Observation {
        /// Its number.
        seq: u64,
        /// When it arrived, in nanoseconds.
        at: u64,
    },
    /// A report of what the loudspeaker did.
    Heard {
        /// The report.
        report: HeardReport,
    },
    /// The client is there, or not any more.
    Presence {
        /// It is there.
        is_here: bool,
    },
    /// The passing of time: a step by the clock, staleness, a status.
    Tick,
}

/// One line about what was taken in, put after everything that was said on account of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TakenLine<'a> {
    /// The session's name.
    pub session: Cow<'a, str>,
    /// The line's number in the session, from 1; where a restarted notifier goes on with a session, from 2.
    pub n: u64,
    /// The notifier's time, in nanoseconds.
    pub now: u64,
    /// How many events have been said since the session was opened, or went on.
    pub said: u64,
    /// What was taken in.
    #[serde(flatten)]
    pub input: TakenInput,
}

/// Numbers the lines of a session, and counts what is said.
#[derive(Clone, Debug)]
pub(crate) struct TakenLog {
    n: u64,
    said: u64,
    line: Vec<u8>,
}

impl TakenLog {
    /// Begins with a session; one that goes on after a restart has had a beginning that nobody hears of any more.
    pub(crate) fn new(goes_on: bool) -> Self {
        Self { n: u64::from(goes_on), said: 0, line: Vec::with_capacity(256) }
    }

    /// Counts an event that is said.
    pub(crate) fn count_said(&mut self) {
        self.said += 1;
    }

    /// Writes the next line.
    pub(crate) fn write(&mut self, session: &str, now: u64, input: TakenInput) -> &[u8] {
        self.n += 1;
        let session = Cow::Borrowed(session);
        let line = TakenLine { session, n: self.n, now, said: self.said, input };
        self.line.clear();
        // Plain data into memory: it cannot fail.
        drop(serde_json::to_writer(&mut self.line, &line));
        &self.line
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::heard::HeardEvent;

    #[test]
    fn a_line_is_read_as_it_is_written() {
        let report = HeardReport { utterance: 5, event: HeardEvent::Word, word: 2, t: None };
        let inputs = [
            TakenInput::Observation { seq: 17, at: u64::MAX },
            TakenInput::Heard { report },
            TakenInput::Presence { is_here: false },
            TakenInput::Tick,
        ];
        let mut log = TakenLog::new(false);
        for (n, input) in (1..).zip(inputs) {
            log.count_said();
            let line = log.write("c52e5475", 7, input);
            let read: TakenLine<'_> = serde_json::from_slice(line).unwrap();
            let session = Cow::Borrowed("c52e5475");
            assert_eq!(read, TakenLine { session, n, now: 7, said: n, input });
        }
        let line = TakenLog::new(true).write("a", 9, TakenInput::Tick).to_vec();
        let text = r#"{"session":"a","n":2,"now":9,"said":0,"what":"tick"}"#;
        assert_eq!(String::from_utf8(line).unwrap(), text);
    }
}
