//! Observations as they come from clients: JSON, or raw numbers with 40 bytes attached. Nothing of them is trusted.
//!
//! ```text
//! {"seq":17,"t":12.34,"obs":[0.1,...],"episode":3,"end":false,"facts":["zone_below"]}
//!
//! raw: obs_dim f32, little-endian; attached, little-endian:
//!   0  magic "LDLV"    4  version u16 = 1    6  flags u16 (1 = end of the episode)
//!   8  seq u64        16  t u64, ns         24  episode u64
//!  32  crc32c u32 over bytes 0..32 and the numbers                    36  reserved u32 = 0
//! ```

use std::fmt;

use leadtime_proto::limits::MAX_LIVE_BYTES;
use leadtime_proto::text::quoted;
use leadtime_taxonomy::MAX_FACTS;
use serde::Deserialize;
use serde::de::{self, DeserializeSeed, Deserializer as _, MapAccess, SeqAccess, Visitor};
use serde_json::Value;
use thiserror::Error;

use crate::json_fault::{FieldRule, JsonFault, described, no_count, no_number};
use crate::robot::cdr::BadCdr;
use crate::robot::ros2::ATTACHMENT;

/// The greatest number that an observation may hold.
pub const MAX_NUMBER: f64 = 1e9;
/// The latest time that an observation may have, in seconds: Unix time until the year 2096.
pub const MAX_TIME: f64 = 4e9;
/// The largest number of an observation: room is left to count on from it, also for one that counts nanoseconds.
pub const MAX_SEQ: u64 = 1 << 62;
/// The longest name of a fact, in bytes.
const MAX_FACT: usize = 64;
/// Bytes attached to a raw observation.
pub const RAW_HEADER: usize = 40;
const MAGIC: [u8; 4] = *b"LDLV";
const VERSION: u16 = 1;
/// The flag that ends an episode.
const END: u16 = 1;
/// Where the checksum is; it covers what lies before it.
const CRC_AT: usize = 32;

/// Why an observation is refused.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the sentence of each variant names its fields")]
pub enum BadObservation {
    #[error("the observation cannot be read: {0}")]
    Json(JsonFault),
    #[error(
        "the observation has {found} bytes; {expected} numbers have {}{looks_like}", 4 * expected
    )]
    NumbersAlone { found: usize, expected: usize, looks_like: &'static str },
    #[error(transparent)]
    Cdr(#[from] BadCdr),
    #[error(
        "{0} bytes are beside the message; rmw_zenoh 0.2.4 or later puts {ATTACHMENT} there: number, time, 16 and the gid of the source"
    )]
    SourceMark(usize),
    #[error(
        "two sources send observations at once: the first one is listened to until it is silent"
    )]
    TwoSources,
    #[error("the observation holds NaN or Infinity, which JSON does not have: send finite numbers")]
    NotJsonNumber,
    #[error("the observation has {found} numbers; {expected} are expected")]
    Length { found: usize, expected: usize },
    #[error(
        "number {place} of the observation is {}; allowed: finite, at most 1e9 either way",
        brief(*value)
    )]
    Number { place: usize, value: f64 },
    #[error("`seq` is {0}; allowed: 0 to {MAX_SEQ}")]
    Sequence(u64),
    #[error("`seq` leaps to {0}, far beyond the one before: it counts observations")]
    Leap(u64),
    #[error("the number of the source leaps to {0}, far beyond the one before: it counts messages")]
    SourceLeap(i64),
    #[error("`t` is {}; allowed: 0 to 4e9 seconds", brief(*.0))]
    Time(f64),
    #[error(
        "`t` went back from {before} to {after}: it is the client's own clock, which only goes on"
    )]
    BackInTime { before: f64, after: f64 },
    #[error("observation {0} came twice, with other content the second time: count `seq` up")]
    SameSequence(u64),
    #[error("the observation has {0} facts; at most {MAX_FACTS} are possible")]
    TooManyFacts(usize),
    #[error("a raw observation has {RAW_HEADER} bytes beside it, its attachment; this one has {0}")]
    HeaderLength(usize),
    #[error("the bytes beside the observation do not begin with `LDLV`")]
    Magic,
    #[error(
        "the bytes beside the observation are of version {0}; this notifier reads version {VERSION}"
    )]
    Version(u16),
    #[error(
        "the checksum of the observation is wrong: it was damaged on the way, or is not CRC-32C over bytes 0 to 32 and the numbers"
    )]
    Checksum,
    #[error("the observation has {0} bytes, with what is beside it; {MAX_LIVE_BYTES} at most")]
    TooLong(usize),
    #[error("the raw observation has {0} bytes, not 4 for each number")]
    RawLength(usize),
    #[error("an observation of encoding `{}`; known: application/json, application/octet-stream;leadtime.obs/1", quoted(.0))]
    Encoding(String),
}

/// Writes a number in few digits, however large it is.
pub(crate) fn brief(x: f64) -> String {
    if x.abs() < 1e15 { x.to_string() } else { format!("{x:e}") }
}

// The sentence already contains its cause, so `source()` does not repeat it.
impl From<JsonFault> for BadObservation {
    fn from(fault: JsonFault) -> Self {
        Self::Json(fault)
    }
}

/// What an observation says besides its numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ObservationHead {
    /// Its number, counted by the client.
    pub seq: u64,
    /// The client's own time, in seconds.
    pub t: f64,
    /// The episode that the client counts it to.
    pub episode: u64,
    /// It is the last one of its episode.
    pub end: bool,
}

/// Names of what is the case now, for sentences that state reasons.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FactList {
    /// All names, one after the other: the memory of one observation serves the next.
    text: String,
    ends: Vec<usize>,
}

impl FactList {
    /// Lists the names in the order in which they came.
    pub fn iter(&self) -> impl Iterator<Item = &str> {
        let begins = [0].into_iter().chain(self.ends.iter().copied());
        begins.zip(&self.ends).map(|(from, to)| &self.text[from..*to])
    }

    /// Returns whether a name is among them.
    pub fn contains(&self, fact: &str) -> bool {
        self.iter().any(|name| name == fact)
    }

    fn clear(&mut self) {
        self.text.clear();
        self.ends.clear();
    }

    fn push(&mut self, name: &str) {
        self.text.push_str(name);
        self.ends.push(self.text.len());
    }
}

/// An observation, read into memory that is used again.
#[derive(Clone, Debug, PartialEq)]
pub struct LiveObservation {
    /// What it says besides its numbers.
    pub head: ObservationHead,
    /// Its numbers. Shape `[obs_dim]` once it was read without an error.
    pub values: Vec<f32>,
    /// The client says what is the case now: `names`.
    has_facts: bool,
    names: FactList,
    obs_dim: usize,
}

impl LiveObservation {
    /// Makes room for observations of `obs_dim` numbers.
    pub fn new(obs_dim: usize) -> Self {
        Self {
            head: ObservationHead::default(),
            values: Vec::with_capacity(obs_dim),
            has_facts: false,
            names: FactList {
                text: String::with_capacity(MAX_FACTS * MAX_FACT),
                ends: Vec::with_capacity(MAX_FACTS),
            },
            obs_dim,
        }
    }

    /// Returns how many numbers an observation has.
    pub(crate) fn obs_dim(&self) -> usize {
        self.obs_dim
    }

    /// Returns the facts; `None` from a client that does not say any.
    pub fn facts(&self) -> Option<&FactList> {
        self.has_facts.then_some(&self.names)
    }

    fn clear(&mut self) {
        self.head = ObservationHead::default();
        self.values.clear();
        self.has_facts = false;
        self.names.clear();
    }

    /// Reads JSON.
    ///
    /// # Errors
    ///
    /// [`BadObservation`] if the bytes are no JSON of an observation with number and time, or if its numbers are not as
    /// many as the task has, or not finite. What was there before is lost.
    pub fn read_json(&mut self, bytes: &[u8]) -> Result<(), BadObservation> {
        match self.read_fields(bytes)? {
            [true, true] => Ok(()),
            [has_seq, _] => Err(missing(if has_seq { "t" } else { "seq" })),
        }
    }

    /// Reads JSON that may have neither number nor time; returns whether it has both.
    ///
    /// # Errors
    ///
    /// [`BadObservation`], also if it has only one of them.
    pub(crate) fn read_json_of_robot(&mut self, bytes: &[u8]) -> Result<bool, BadObservation> {
        match self.read_fields(bytes)? {
            [true, false] => Err(missing("t")),
            [false, true] => Err(missing("seq")),
            [has_both, _] => Ok(has_both),
        }
    }

    /// Reads JSON; returns whether there were a number and a time.
    fn read_fields(&mut self, bytes: &[u8]) -> Result<[bool; 2], BadObservation> {
        self.clear();
        let mut reader = serde_json::Deserializer::from_slice(bytes);
        let mut found = 0;
        let read = reader.deserialize_map(Fields { into: self, found: &mut found });
        let has = read.and_then(|has| reader.end().map(|()| has)).map_err(|error| {
            let holds = |word: &[u8]| bytes.windows(word.len()).any(|window| window == word);
            if error.is_syntax() && (holds(b"NaN") || holds(b"Infinity")) {
                BadObservation::NotJsonNumber
            } else {
                JsonFault::find(bytes, &RULES, &error).into()
            }
        })?;
        self.check(found).map(|()| has)
    }

    /// Reads numbers alone, each as its four bytes, little-endian; number and time stay 0.
    ///
    /// # Errors
    ///
    /// [`BadObservation`] if there are not as many as the task has, or one is not finite. What was there before is
    /// lost.
    pub(crate) fn read_numbers(&mut self, numbers: &[[u8; 4]]) -> Result<(), BadObservation> {
        self.clear();
        if numbers.len() == self.obs_dim {
            self.values.extend(numbers.iter().map(|bytes| f32::from_le_bytes(*bytes)));
        }
        self.check(numbers.len())
    }

    /// Reads raw numbers and the bytes attached to them.
    ///
    /// # Errors
    ///
    /// [`BadObservation`] if either has another length than expected, if beginning, version or checksum are wrong, or
    /// if a number is not finite. What was there before is lost.
    pub fn read_raw(&mut self, numbers: &[u8], beside: &[u8]) -> Result<(), BadObservation> {
        self.clear();
        if beside.len() != RAW_HEADER {
            return Err(BadObservation::HeaderLength(beside.len()));
        }
        let u16_at = |at: usize| u16::from_le_bytes([beside[at], beside[at + 1]]);
        let u64_at =
            |at: usize| (0..8).rev().fold(0, |sum, i| sum << 8 | u64::from(beside[at + i]));
        if beside[..4] != MAGIC {
            return Err(BadObservation::Magic);
        }
        if u16_at(4) != VERSION {
            return Err(BadObservation::Version(u16_at(4)));
        }
        let (whole, rest) = numbers.as_chunks::<4>();
        if !rest.is_empty() {
            return Err(BadObservation::RawLength(numbers.len()));
        }
        if whole.len() != self.obs_dim {
            let (found, expected) = (whole.len(), self.obs_dim);
            return Err(BadObservation::Length { found, expected });
        }
        let crc = checksum(&beside[..CRC_AT], numbers);
        if beside[CRC_AT..CRC_AT + 4] != crc.to_le_bytes() {
            return Err(BadObservation::Checksum);
        }
        self.values.extend(whole.iter().map(|bytes| f32::from_le_bytes(*bytes)));
        let t = u64_at(16) as f64 * 1e-9;
        let end = u16_at(6) & END != 0;
        self.head = ObservationHead { seq: u64_at(8), t, episode: u64_at(24), end };
        self.check(whole.len())
    }

    fn check(&self, found: usize) -> Result<(), BadObservation> {
        let expected = self.obs_dim;
        if found != expected {
            return Err(BadObservation::Length { found, expected });
        }
        let is_odd = |value: &f32| !value.is_finite() || f64::from(value.abs()) > MAX_NUMBER;
        if let Some(place) = self.values.iter().position(is_odd) {
            return Err(BadObservation::Number { place, value: self.values[place].into() });
        }
        if self.head.seq > MAX_SEQ {
            return Err(BadObservation::Sequence(self.head.seq));
        }
        let t = self.head.t;
        if !(0.0..=MAX_TIME).contains(&t) {
            return Err(BadObservation::Time(t));
        }
        match self.names.ends.len() {
            n if n > MAX_FACTS => Err(BadObservation::TooManyFacts(n)),
            _ => Ok(()),
        }
    }
}

/// Computes the checksum of a raw observation.
fn checksum(head: &[u8], numbers: &[u8]) -> u32 {
    crc32c::crc32c_append(crc32c::crc32c(head), numbers)
}

/// Writes an observation as raw numbers and the bytes to attach.
pub fn write_raw(head: &ObservationHead, values: &[f32]) -> (Vec<u8>, [u8; RAW_HEADER]) {
    let numbers: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    let mut beside = [0; RAW_HEADER];
    beside[..4].copy_from_slice(&MAGIC);
    beside[4..6].copy_from_slice(&VERSION.to_le_bytes());
    beside[6..8].copy_from_slice(&(if head.end { END } else { 0 }).to_le_bytes());
    beside[8..16].copy_from_slice(&head.seq.to_le_bytes());
    beside[16..24].copy_from_slice(&((head.t * 1e9) as u64).to_le_bytes());
    beside[24..32].copy_from_slice(&head.episode.to_le_bytes());
    let crc = checksum(&beside[..CRC_AT], &numbers);
    beside[CRC_AT..CRC_AT + 4].copy_from_slice(&crc.to_le_bytes());
    (numbers, beside)
}

/// Writes an observation as JSON, without facts.
pub fn write_json(head: &ObservationHead, values: &[f32]) -> Vec<u8> {
    write_json_with(head, values, None)
}

/// Writes an observation as JSON, with the facts that hold, if the client states any.
pub fn write_json_with(
    head: &ObservationHead,
    values: &[f32],
    facts: Option<&[String]>,
) -> Vec<u8> {
    // As f64 a number reads back as the f32 that it was.
    let obs: Vec<f64> = values.iter().map(|value| f64::from(*value)).collect();
    let ObservationHead { seq, t, episode, end } = head;
    let mut json =
        serde_json::json!({"seq": seq, "t": t, "obs": obs, "episode": episode, "end": end});
    if let Some(facts) = facts {
        json["facts"] = facts.into();
    }
    json.to_string().into_bytes()
}

/// The fields of an observation, each once, in any order.
struct Fields<'a> {
    into: &'a mut LiveObservation,
    /// How many numbers there were, room or not.
    found: &'a mut usize,
}

/// The name of a field, in the order of [`RULES`].
#[derive(Clone, Copy, Deserialize)]
#[serde(field_identifier, rename_all = "snake_case")]
enum FieldName {
    Seq,
    T,
    Obs,
    Episode,
    End,
    Facts,
}

/// What each field has to be. The first two may be missing, as far as JSON is concerned.
const RULES: [FieldRule; 6] = [
    FieldRule::optional("seq", "the number of the observation, a whole number from 0", no_count),
    FieldRule::optional("t", "the time by the client's own clock, in seconds", no_number),
    FieldRule::required("obs", "the list of the observation's numbers", no_number_list),
    FieldRule::optional("episode", "the number of the episode, a whole number from 0", no_count),
    FieldRule::optional("end", "true or false", |value| {
        (!value.is_boolean()).then(|| format!("it is {}", described(value)))
    }),
    FieldRule::optional("facts", "a list of names of facts", no_fact_list),
];

fn missing(field: &str) -> BadObservation {
    let rule = RULES.iter().find(|rule| rule.name == field).unwrap_or(&RULES[0]);
    JsonFault::Missing { field: rule.name, expected: rule.expected }.into()
}

/// Says what is wrong with a list of numbers.
fn no_number_list(value: &Value) -> Option<String> {
    let Some(list) = value.as_array() else { return Some(format!("it is {}", described(value))) };
    let place = list.iter().position(|number| !number.is_number())?;
    Some(format!("number {place} is {}", described(&list[place])))
}

/// Says what is wrong with a list of facts.
fn no_fact_list(value: &Value) -> Option<String> {
    let Some(list) = value.as_array() else { return Some(format!("it is {}", described(value))) };
    let is_name = |name: &str| (1..=MAX_FACT).contains(&name.len());
    let place = list.iter().position(|name| !name.as_str().is_some_and(is_name));
    match place {
        Some(place) => {
            let found = described(&list[place]);
            Some(format!("name {place} is {found}, and one has 1 to {MAX_FACT} bytes"))
        }
        None if list.len() > MAX_FACTS => {
            Some(format!("it has {}, and {MAX_FACTS} is the most", list.len()))
        }
        None => None,
    }
}

impl<'de> Visitor<'de> for Fields<'_> {
    /// Whether there were a number and a time.
    type Value = [bool; 2];

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an observation: {\"seq\": 1, \"t\": 0.0, \"obs\": [...]}")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<[bool; 2], A::Error> {
        let Fields { into, found } = self;
        let mut seen = [false; RULES.len()];
        while let Some(field) = map.next_key::<FieldName>()? {
            if std::mem::replace(&mut seen[field as usize], true) {
                return Err(de::Error::duplicate_field(RULES[field as usize].name));
            }
            match field {
                FieldName::Seq => into.head.seq = map.next_value()?,
                FieldName::T => into.head.t = map.next_value()?,
                FieldName::Obs => {
                    let room = into.obs_dim;
                    map.next_value_seed(NumberList { into: &mut into.values, room, found })?;
                }
                FieldName::Episode => into.head.episode = map.next_value()?,
                FieldName::End => into.head.end = map.next_value()?,
                FieldName::Facts => {
                    into.has_facts = true;
                    map.next_value_seed(FactNames(&mut into.names))?;
                }
            }
        }
        let [has_seq, has_t, has_obs, ..] = seen;
        if has_obs { Ok([has_seq, has_t]) } else { Err(de::Error::missing_field("obs")) }
    }
}

/// A list of numbers, of which no more are kept than there is room for.
struct NumberList<'a> {
    into: &'a mut Vec<f32>,
    room: usize,
    found: &'a mut usize,
}

impl<'de> DeserializeSeed<'de> for NumberList<'_> {
    type Value = ();

    fn deserialize<D: de::Deserializer<'de>>(self, list: D) -> Result<(), D::Error> {
        list.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for NumberList<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of numbers")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<(), A::Error> {
        while let Some(number) = list.next_element::<f64>()? {
            *self.found += 1;
            if self.into.len() < self.room {
                self.into.push(number as f32);
            }
        }
        Ok(())
    }
}

/// A list of names, of which no more are kept than there is room for.
struct FactNames<'a>(&'a mut FactList);

impl<'de> DeserializeSeed<'de> for FactNames<'_> {
    type Value = ();

    fn deserialize<D: de::Deserializer<'de>>(self, list: D) -> Result<(), D::Error> {
        list.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for FactNames<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of names")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<(), A::Error> {
        while list.next_element_seed(Name(&mut *self.0))?.is_some() {}
        Ok(())
    }
}

struct Name<'a>(&'a mut FactList);

impl<'de> DeserializeSeed<'de> for Name<'_> {
    type Value = ();

    fn deserialize<D: de::Deserializer<'de>>(self, name: D) -> Result<(), D::Error> {
        name.deserialize_str(self)
    }
}

impl Visitor<'_> for Name<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the name of a fact, 1 to {MAX_FACT} bytes, {MAX_FACTS} facts at most")
    }

    fn visit_str<E: de::Error>(self, name: &str) -> Result<(), E> {
        let has_room = self.0.ends.len() < MAX_FACTS && (1..=MAX_FACT).contains(&name.len());
        if !has_room {
            return Err(E::invalid_value(de::Unexpected::Str(&quoted(name)), &self));
        }
        self.0.push(name);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn read(text: &str) -> Result<LiveObservation, String> {
        let mut observation = LiveObservation::new(2);
        let read = observation.read_json(text.as_bytes());
        read.map(|()| observation).map_err(|error| error.to_string())
    }

    #[test]
    fn an_observation_is_read_as_people_write_it() {
        let text = r#"{"t": 1.5, "seq": 7, "obs": [1, -0.25], "facts": ["zone_below", "low"]}"#;
        let found = read(text).unwrap();
        let head = ObservationHead { seq: 7, t: 1.5, episode: 0, end: false };
        assert_eq!((found.head, found.values.as_slice()), (head, &[1.0, -0.25][..]));
        let facts = found.facts().unwrap();
        assert_eq!(facts.iter().collect::<Vec<_>>(), ["zone_below", "low"]);
        assert!(facts.contains("low") && !facts.contains("zone"));
        assert_eq!(read(r#"{"seq":1,"t":0,"obs":[0,0]}"#).unwrap().facts(), None);
        let told = ["zone_below".to_owned(), "low".to_owned()];
        let crossed = write_json_with(&head, &found.values, Some(&told));
        assert_eq!(read(str::from_utf8(&crossed).unwrap()).unwrap(), found);
        let none = read(r#"{"seq":1,"t":0,"obs":[0,0],"facts":[]}"#).unwrap();
        assert_eq!(none.facts().unwrap().iter().count(), 0);
    }

    #[test]
    fn what_is_wrong_is_one_sentence() {
        for (text, told) in [
            ("", "it is no JSON: it ends in the middle, after 0 bytes"),
            (
                "[]",
                "it has to be a JSON object with seq, t, obs, episode, end, facts; it is a list",
            ),
            (r#"{"seq":1,"t":0}"#, "`obs` is missing: the list of the observation's numbers"),
            (r#"{"t":0,"obs":[1,2]}"#, "`seq` is missing: the number of the observation"),
            (r#"{"seq":1,"obs":[1,2]}"#, "`t` is missing: the time by the client's own clock"),
            (r#"{"seq":1,"t":0,"obs":[1]}"#, "has 1 numbers; 2 are expected"),
            (r#"{"seq":1,"t":0,"obs":[1,2,3]}"#, "has 3 numbers; 2 are expected"),
            (r#"{"seq":1,"t":0,"obs":[NaN,1]}"#, "NaN or Infinity"),
            (r#"{"seq":1,"t":0,"obs":[1,null]}"#, "numbers; number 1 is null"),
            (r#"{"seq":1,"t":0,"obs":7}"#, "the list of the observation's numbers; it is 7"),
            (r#"{"seq":1,"t":0,"obs":[1e39,1]}"#, "number 0 of the observation is inf"),
            (r#"{"seq":1,"t":0,"obs":[1,-2e9]}"#, "number 1 of the observation is -2000000000"),
            (r#"{"seq":-1,"t":0,"obs":[1,2]}"#, "a whole number from 0; it is -1"),
            (r#"{"seq":"1","t":0,"obs":[1,2]}"#, "a whole number from 0; it is \"1\""),
            (r#"{"seq":1,"t":"now","obs":[1,2]}"#, "`t` has to be the time"),
            (r#"{"seq":1,"t":0,"obs":[1,2],"end":1}"#, "`end` has to be true or false; it is 1"),
            (r#"{"seq":1,"t":-1,"obs":[1,2]}"#, "`t` is -1; allowed: 0 to 4e9 seconds"),
            (r#"{"seq":1,"t":1e300,"obs":[1,2]}"#, "`t` is 1e300; allowed: 0 to 4e9 seconds"),
            (r#"{"seq":1,"t":0,"obs":[1,2],"ob":1}"#, "`ob` is not known; did you mean `obs`?"),
            (r#"{"seq":1,"seq":2,"t":0,"obs":[1,2]}"#, "`seq` is there twice"),
            (r#"{"seq":1,"t":0,"obs":[1,2]} x"#, "`x` at line 1, column 29 is out of place"),
            (
                r#"{"seq":1,"t":0,"obs":[1,2],"facts":["a",""]}"#,
                "name 1 is \"\", and one has 1 to 64",
            ),
            (r#"{"seq":1,"t":0,"obs":[1,2],"facts":"low"}"#, "a list of names of facts; it is"),
        ] {
            let error = read(text).unwrap_err();
            assert!(error.contains(told), "{text}: {error}");
        }
    }

    #[test]
    fn unix_time_is_a_time_in_both_forms() {
        let now = 1_796_000_000.25;
        let mut found = LiveObservation::new(2);
        let text = format!(r#"{{"seq":1,"t":{now},"obs":[1,2]}}"#);
        found.read_json(text.as_bytes()).unwrap();
        assert_eq!(found.head.t, now);
        let head = ObservationHead { seq: 9, t: now, episode: 4, end: true };
        let (numbers, beside) = write_raw(&head, &[0.1, -3.0]);
        found.read_raw(&numbers, &beside).unwrap();
        assert_eq!(found.head, head);
    }

    #[test]
    fn raw_numbers_cross_and_every_damage_is_seen() {
        let head = ObservationHead { seq: 9, t: 2.5, episode: 4, end: true };
        let (numbers, beside) = write_raw(&head, &[0.1, -3.0]);
        let mut found = LiveObservation::new(2);
        found.read_raw(&numbers, &beside).unwrap();
        assert_eq!((found.head, found.values.as_slice()), (head, &[0.1, -3.0][..]));
        for at in 0..36 {
            let mut damaged = beside;
            damaged[at] ^= 0x10;
            found.read_raw(&numbers, &damaged).unwrap_err();
        }
        for at in 0..numbers.len() {
            let mut damaged = numbers.clone();
            damaged[at] ^= 1;
            found.read_raw(&damaged, &beside).unwrap_err();
        }
        let error = found.read_raw(&numbers[..4], &beside).unwrap_err();
        assert_eq!(error.to_string(), "the observation has 1 numbers; 2 are expected");
        assert!(found.read_raw(&numbers, &[]).unwrap_err().to_string().contains("this one has 0"));
        let (numbers, beside) = write_raw(&head, &[f32::NAN, 0.0]);
        let error = found.read_raw(&numbers, &beside).unwrap_err().to_string();
        assert!(error.contains("number 0 of the observation is NaN"), "{error}");
    }

    proptest! {
        #[test]
        fn numbers_cross_as_json_bit_for_bit(bits in proptest::collection::vec(any::<u32>(), 2)) {
            let values: Vec<f32> = bits.iter().map(|bits| f32::from_bits(*bits)).collect();
            let fits = |x: &f32| x.is_finite() && x.abs() <= MAX_NUMBER as f32;
            prop_assume!(values.iter().all(fits));
            let head = ObservationHead { seq: 3, t: 0.3, episode: 1, end: false };
            let mut found = LiveObservation::new(2);
            found.read_json(&write_json(&head, &values)).unwrap();
            prop_assert_eq!(found.head, head);
            let same = |(a, b): (&f32, &f32)| a.to_bits() == b.to_bits();
            prop_assert!(found.values.iter().zip(&values).all(same));
        }

        #[test]
        fn noise_is_no_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let mut found = LiveObservation::new(3);
            drop(found.read_json(&bytes));
            let (beside, numbers) = bytes.split_at(bytes.len().min(RAW_HEADER));
            drop(found.read_raw(numbers, beside));
        }
    }
}
