//! What a session took in, and when by the notifier's own clock: everything that its decisions depend on besides the
//! observations themselves. With it a recorded session can be replayed exactly, whatever its clock.
//!
//! ```text
//! [{"session":"c52e5475","start":"9f0c2a7de1b84563","n":12,"now":3600412000000,"said":57,"seq":17,"step":9,"what":"observation","at":3600411990000},
//!  {"session":"c52e5475","start":"9f0c2a7de1b84563","n":13,"now":3600700000000,"said":58,"seq":17,"step":10,"what":"tick"}]
//! ```
//!
//! Every message repeats the lines before its last, so that a lost one heals with the next.

use std::borrow::Cow;
use std::collections::VecDeque;

use leadtime_proto::Incarnation;
use serde::{Deserialize, Serialize};

use crate::heard::HeardReport;

/// How many lines a message has at most.
const N_REPEATED: usize = 8;

/// Something that a session took in.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "what", rename_all = "snake_case")]
pub enum TakenInput {
    /// An observation, the newest now.
    Observation {
        /// When it arrived, in nanoseconds.
        at: u64,
        /// Another program of a robot sends it: its time cannot be compared with times before.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        is_other_clock: bool,
    },
    /// A report of what the loudspeaker did.
    Heard {
        /// What the loudspeaker did.
        report: HeardReport,
    },
    /// The client is there, or not any more.
    Presence {
        /// Whether it is there.
        is_here: bool,
    },
    /// The passing of time: a step by the clock, staleness, a status.
    Tick,
}

/// One line about what was taken in, put after everything that was said in response.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TakenLine<'a> {
    /// Name of the session, as its answer gave it.
    pub session: Cow<'a, str>,
    /// This start of the notifier, 16 hexadecimal digits; empty where a recording does not state it. Numbers, times and
    /// counts are those of one start.
    #[serde(default, skip_serializing_if = "str::is_empty")]
    pub start: Cow<'a, str>,
    /// The line's number in the session, from 1; where a restarted notifier goes on with a session, from 2.
    pub n: u64,
    /// The notifier's time, in nanoseconds.
    pub now: u64,
    /// How many events have been said since the session was opened, or went on.
    pub said: u64,
    /// The newest observation, by its number; 0 before the first.
    pub seq: u64,
    /// The step of the episode.
    pub step: u32,
    /// What was taken in.
    #[serde(flatten)]
    pub input: TakenInput,
}

impl TakenLine<'_> {
    /// Returns whether nothing that the session took in before matters: there is nothing, or no observation yet.
    pub fn is_beginning(&self) -> bool {
        let is_observation = matches!(self.input, TakenInput::Observation { .. });
        self.n == 1 || self.seq == 0 && self.said == 0 && !is_observation
    }
}

/// Numbers the lines of a session, and counts what is said.
#[derive(Clone, Debug)]
pub(crate) struct TakenLog {
    start: String,
    n: u64,
    said: u64,
    recent: VecDeque<Vec<u8>>,
    message: Vec<u8>,
}

impl TakenLog {
    /// Begins with a session in this start of the notifier; one that goes on after a restart has had a beginning that nobody hears of any more.
    pub(crate) fn new(start: Incarnation, goes_on: bool) -> Self {
        let (start, recent) = (start.hex(), VecDeque::with_capacity(N_REPEATED));
        Self { start, n: u64::from(goes_on), said: 0, recent, message: Vec::new() }
    }

    /// Counts an event that is said.
    pub(crate) fn count_said(&mut self) {
        self.said += 1;
    }

    /// Writes a message with the next line: `input` was taken in, and led to the newest observation and the step.
    pub(crate) fn write(
        &mut self,
        session: &str,
        now: u64,
        seq: u64,
        step: u32,
        input: TakenInput,
    ) -> &[u8] {
        self.n += 1;
        let (session, start) = (Cow::Borrowed(session), Cow::Borrowed(&*self.start));
        let line = TakenLine { session, start, n: self.n, now, said: self.said, seq, step, input };
        let is_full = self.recent.len() >= N_REPEATED;
        let mut text = if is_full { self.recent.pop_front() } else { None }.unwrap_or_default();
        text.clear();
        // Plain data into memory: it cannot fail.
        drop(serde_json::to_writer(&mut text, &line));
        self.recent.push_back(text);
        self.message.clear();
        for (i, text) in self.recent.iter().enumerate() {
            self.message.push(if i == 0 { b'[' } else { b',' });
            self.message.extend_from_slice(text);
        }
        self.message.push(b']');
        &self.message
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
            TakenInput::Observation { at: u64::MAX, is_other_clock: false },
            TakenInput::Observation { at: 5, is_other_clock: true },
            TakenInput::Heard { report },
            TakenInput::Presence { is_here: false },
            TakenInput::Tick,
        ];
        let mut log = TakenLog::new(Incarnation(0xa7), false);
        for (n, input) in (1..).zip(inputs) {
            log.count_said();
            let message = log.write("c52e5475", 7, 17, 3, input);
            let read: Vec<TakenLine<'_>> = serde_json::from_slice(message).unwrap();
            assert_eq!(read.len() as u64, n);
            let (session, start) = (Cow::Borrowed("c52e5475"), Cow::Borrowed("00000000000000a7"));
            let line = TakenLine { session, start, n, now: 7, said: n, seq: 17, step: 3, input };
            assert_eq!(read.last(), Some(&line));
        }
        let message =
            TakenLog::new(Incarnation(1), true).write("a", 9, 0, 0, TakenInput::Tick).to_vec();
        let text = r#"[{"session":"a","start":"0000000000000001","n":2,"now":9,"said":0,"seq":0,"step":0,"what":"tick"}]"#;
        assert_eq!(String::from_utf8(message).unwrap(), text);
    }

    #[test]
    fn lost_lines_are_repeated_in_the_next_message() {
        let mut log = TakenLog::new(Incarnation(0), false);
        for n in 1..20 {
            let message = log.write("a", n, n, 0, TakenInput::Tick);
            let read: Vec<TakenLine<'_>> = serde_json::from_slice(message).unwrap();
            let numbers: Vec<u64> = read.iter().map(|line| line.n).collect();
            assert_eq!(numbers, (n.saturating_sub(7).max(1)..=n).collect::<Vec<_>>());
        }
    }
}
