//! What is said, as events: the running utterance is in every one, so that a lost event heals with the next.
//!
//! ```text
//! {"seq":17,"step":52,"episode":3,"event":"start","utterance":5,"topic":"ascend","k":2,"l":4,"heard":0,
//!  "text":"Climb now, zone ahead.","words":["Climb","now,","zone","ahead."],"at":[0,0.3,0.6,0.9],"end":1.2,
//!  "age":0.004,"last":true}
//!
//! raw, 24 bytes, little-endian:
//!   0  utterance u32    4  event u8 (0 silent, 1 start, 2 word, 3 end, 4 cut)    5  topic u8    6  k u8    7  l u8
//!   8  heard u8         9  flags u8 (1 = last)    10  step u32    14  seq u64    22  word u16
//! ```

use std::sync::Arc;

use leadtime_taxonomy::words;
use leadtime_voice::SpokenSentence;
use serde::ser::{SerializeMap as _, SerializeSeq as _};
use serde::{Deserialize, Serialize, Serializer};

use crate::open::SayForm;

/// Bytes of a raw event.
pub const RAW_SAY: usize = 24;
/// The flag of the last event about an observation.
const LAST: u8 = 1;

/// Where a session's events go.
pub trait SayTo {
    /// Puts an event of what is said, JSON or raw as the client wants it.
    fn say(&mut self, bytes: &[u8]);
    /// Puts a status, as JSON.
    fn status(&mut self, bytes: &[u8]);
    /// Plays a sentence, if there is a loudspeaker; what it plays is cut.
    fn play(&mut self, _sentence: &Arc<SpokenSentence>) {}
    /// Cuts what is played.
    fn hush(&mut self) {}
}

/// What happens to an utterance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SayEvent {
    /// Nothing is said. Only published with `clock = "observation"`, where every observation has an answer.
    Silent,
    /// An utterance starts with its first word.
    Start,
    /// A further word of it begins.
    Word,
    /// Its last word has ended.
    End,
    /// It is cut: by the next one, by the notifier, or because nobody should be spoken to.
    Cut,
}

/// The utterance that an event is about.
#[derive(Clone, Copy, Debug)]
pub struct SaidUtterance<'a> {
    /// Its number in the session, from 1.
    pub number: u32,
    /// Index of its topic in the task.
    pub topic: usize,
    /// Name of the topic in the task, such as `ascend`.
    pub topic_name: &'a str,
    /// Comprehension time k, in words.
    pub comprehension: u32,
    /// Conveyance time l, in words.
    pub conveyance: u32,
    /// Words that have ended.
    pub heard: u32,
    /// The sentence; empty without words.
    pub text: &'a str,
    /// No sentence has exactly this k and l; this one stands in.
    pub stand_in: bool,
    /// How long it takes where every word takes a step, in seconds.
    pub seconds: f64,
    /// The sentence with the times of its words, where they count.
    pub spoken: Option<&'a SpokenSentence>,
}

/// One event of what is said.
#[derive(Clone, Copy, Debug)]
pub struct SayLine<'a> {
    /// The newest observation, by its number.
    pub seq: u64,
    /// The step of the episode, from 0.
    pub step: u32,
    /// The episode that the client counts it to.
    pub episode: u64,
    /// What happens to the utterance.
    pub event: SayEvent,
    /// About which utterance; `None` for [`SayEvent::Silent`].
    pub utterance: Option<SaidUtterance<'a>>,
    /// How old the newest observation is, in seconds.
    pub age: f64,
}

/// What ends a line, last event or not.
const TAILS: [&[u8]; 2] = [b",\"last\":false}", b",\"last\":true}"];

impl SayLine<'_> {
    /// Writes the event as JSON without its end, which [`finish`] adds.
    pub fn write_json(&self, out: &mut Vec<u8>) {
        out.clear();
        // Plain data into memory: neither can fail.
        drop(serde_json::to_writer(&mut *out, self));
        out.truncate(out.len().saturating_sub(1));
    }

    /// Writes the event raw, not as the last one.
    pub fn write_raw(&self, out: &mut Vec<u8>) {
        let utterance = self.utterance.as_ref();
        let small = |of: fn(&SaidUtterance<'_>) -> u32| {
            u8::try_from(utterance.map_or(0, of)).unwrap_or(u8::MAX)
        };
        out.clear();
        out.extend_from_slice(&utterance.map_or(0, |it| it.number).to_le_bytes());
        out.push(self.event as u8);
        out.push(small(|it| it.topic as u32));
        out.push(small(|it| it.comprehension));
        out.push(small(|it| it.conveyance));
        out.push(small(|it| it.heard));
        out.push(0);
        out.extend_from_slice(&self.step.to_le_bytes());
        out.extend_from_slice(&self.seq.to_le_bytes());
        let word = utterance.map_or(0, |it| it.word(words::spoken(it.text).count() as u32));
        out.extend_from_slice(&(word as u16).to_le_bytes());
    }
}

/// Ends a line that was written, as the last one about an observation or not.
pub fn finish(line: &mut Vec<u8>, form: SayForm, is_last: bool) {
    if form == SayForm::Binary {
        line[9] = if is_last { LAST } else { 0 };
    } else {
        line.extend_from_slice(TAILS[usize::from(is_last)]);
    }
}

impl SaidUtterance<'_> {
    /// Returns the word of the sentence that begins after the words that have been heard.
    ///
    /// A sentence of another length than the message's keeps its pace: both end together.
    fn word(&self, n_words: u32) -> u32 {
        let n = if n_words == 0 { self.conveyance } else { n_words };
        let said = self.heard * n;
        match self.spoken {
            // Where words have times of their own, that part of the message has ended with a word.
            Some(_) => said.div_ceil(self.conveyance.max(1)),
            None => said / self.conveyance.max(1),
        }
    }
}

impl Serialize for SayLine<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("seq", &self.seq)?;
        map.serialize_entry("step", &self.step)?;
        map.serialize_entry("episode", &self.episode)?;
        map.serialize_entry("event", &self.event)?;
        if let Some(said) = &self.utterance {
            map.serialize_entry("utterance", &said.number)?;
            map.serialize_entry("topic", said.topic_name)?;
            map.serialize_entry("k", &said.comprehension)?;
            map.serialize_entry("l", &said.conveyance)?;
            map.serialize_entry("heard", &said.heard)?;
            let n_words = words::spoken(said.text).count() as u32;
            map.serialize_entry("word", &said.word(n_words))?;
            if n_words > 0 {
                map.serialize_entry("text", said.text)?;
                map.serialize_entry("words", &WordList(said.text))?;
                let (seconds, spoken) = (said.seconds, said.spoken);
                map.serialize_entry("at", &WordTimes { n_words, seconds, spoken })?;
            }
            let end = said.spoken.map_or(said.seconds, |spoken| f64::from(spoken.end()) / 1e3);
            map.serialize_entry("end", &milliseconds(end))?;
            if said.spoken.is_some_and(|spoken| spoken.is_estimated) {
                map.serialize_entry("estimated", &true)?;
            }
            if said.stand_in {
                map.serialize_entry("stand_in", &true)?;
            }
        }
        map.serialize_entry("age", &milliseconds(self.age))?;
        map.end()
    }
}

/// Rounds seconds to milliseconds, which is as exact as anybody hears.
pub(crate) fn milliseconds(seconds: f64) -> f64 {
    (seconds * 1e3).round() / 1e3
}

struct WordList<'a>(&'a str);

impl Serialize for WordList<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut list = serializer.serialize_seq(None)?;
        words::spoken(self.0).try_for_each(|word| list.serialize_element(word))?;
        list.end()
    }
}

/// When each word begins, in seconds from the start.
struct WordTimes<'a> {
    n_words: u32,
    seconds: f64,
    spoken: Option<&'a SpokenSentence>,
}

impl Serialize for WordTimes<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut list = serializer.serialize_seq(None)?;
        for word in self.spoken.iter().flat_map(|spoken| &spoken.words) {
            list.serialize_element(&(f64::from(word.begin) / 1e3))?;
        }
        let by_steps = if self.spoken.is_some() { 0..0 } else { 0..self.n_words };
        for word in by_steps {
            let at = f64::from(word) * self.seconds / f64::from(self.n_words);
            list.serialize_element(&milliseconds(at))?;
        }
        list.end()
    }
}

/// An event as a client reads it.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct HeardSay {
    /// The newest observation that the notifier had, by its number.
    pub seq: u64,
    /// The step of the episode, from 0.
    pub step: u32,
    /// The client's episode; 0 in a raw event.
    #[serde(default)]
    pub episode: u64,
    /// What happens to the utterance.
    pub event: SayEvent,
    /// The utterance's number; 0 in silence.
    #[serde(default)]
    pub utterance: u32,
    /// The topic's name; empty in a raw event.
    #[serde(default)]
    pub topic: String,
    /// The topic's number, which only a raw event has.
    #[serde(skip)]
    pub topic_id: Option<u8>,
    /// Comprehension time k, in words.
    #[serde(default)]
    pub k: u32,
    /// Conveyance time l, in words.
    #[serde(default)]
    pub l: u32,
    /// Words that have ended.
    #[serde(default)]
    pub heard: u32,
    /// The sentence; empty without words.
    #[serde(default)]
    pub text: String,
    /// How old the newest observation was, in seconds; 0 in a raw event.
    #[serde(default)]
    pub age: f64,
    /// The last event about this observation.
    #[serde(default)]
    pub last: bool,
}

impl HeardSay {
    /// Reads an event in either form; `None` if it is none.
    pub fn read(bytes: &[u8]) -> Option<Self> {
        if bytes.first() == Some(&b'{') && bytes.len() != RAW_SAY {
            return serde_json::from_slice(bytes).ok();
        }
        let bytes: &[u8; RAW_SAY] = bytes.try_into().ok()?;
        let u32_at = |at: usize| (0..4).rev().fold(0, |sum, i| sum << 8 | u32::from(bytes[at + i]));
        let event =
            [SayEvent::Silent, SayEvent::Start, SayEvent::Word, SayEvent::End, SayEvent::Cut];
        Some(Self {
            seq: u64::from(u32_at(18)) << 32 | u64::from(u32_at(14)),
            step: u32_at(10),
            episode: 0,
            event: *event.get(usize::from(bytes[4]))?,
            utterance: u32_at(0),
            topic: String::new(),
            topic_id: Some(bytes[5]),
            k: bytes[6].into(),
            l: bytes[7].into(),
            heard: bytes[8].into(),
            text: String::new(),
            age: 0.0,
            last: bytes[9] & LAST != 0,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(event: SayEvent) -> SayLine<'static> {
        let utterance = SaidUtterance {
            number: 5,
            topic: 2,
            topic_name: "ascend",
            comprehension: 2,
            conveyance: 4,
            heard: 1,
            text: "Climb now, zone \"ahead\".",
            stand_in: false,
            seconds: 1.2,
            spoken: None,
        };
        let utterance = (event != SayEvent::Silent).then_some(utterance);
        SayLine { seq: 1 << 40, step: 52, episode: 3, event, utterance, age: 0.0041 }
    }

    #[test]
    fn an_event_is_json_with_the_whole_utterance() {
        let mut out = Vec::new();
        line(SayEvent::Word).write_json(&mut out);
        finish(&mut out, SayForm::Json, true);
        let text = String::from_utf8(out.clone()).unwrap();
        assert_eq!(
            text,
            r#"{"seq":1099511627776,"step":52,"episode":3,"event":"word","utterance":5,"topic":"ascend","k":2,"l":4,"heard":1,"word":1,"text":"Climb now, zone \"ahead\".","words":["Climb","now,","zone","\"ahead\"."],"at":[0.0,0.3,0.6,0.9],"end":1.2,"age":0.004,"last":true}"#
        );
        assert!(text.len() < 600);
        let heard = HeardSay::read(&out).unwrap();
        assert_eq!((heard.event, heard.heard, heard.l, heard.last), (SayEvent::Word, 1, 4, true));
        line(SayEvent::Silent).write_json(&mut out);
        finish(&mut out, SayForm::Json, false);
        let heard = HeardSay::read(&out).unwrap();
        assert_eq!((heard.event, heard.utterance, heard.last), (SayEvent::Silent, 0, false));
    }

    #[test]
    fn a_raw_event_has_24_bytes_that_can_be_read_back() {
        let mut out = Vec::new();
        for event in [SayEvent::Start, SayEvent::Word, SayEvent::End, SayEvent::Cut] {
            line(event).write_raw(&mut out);
            finish(&mut out, SayForm::Binary, true);
            assert_eq!(out.len(), RAW_SAY);
            let heard = HeardSay::read(&out).unwrap();
            assert_eq!(
                (heard.seq, heard.step, heard.event, heard.last),
                (1 << 40, 52, event, true)
            );
            assert_eq!((heard.topic_id, heard.k, heard.l, heard.heard), (Some(2), 2, 4, 1));
            assert_eq!(out[22..], [1, 0]);
        }
        for noise in [&b"{"[..], b"", b"{\"seq\":1}", &[9; RAW_SAY]] {
            assert_eq!(HeardSay::read(noise), None);
        }
    }
}
