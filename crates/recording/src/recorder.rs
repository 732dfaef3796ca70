//! From what is published to a file: every message on its channel, and every session with what it is.
//!
//! Anybody may invent names. So of those that the notifier says nothing of only some have a place in the file, and each of them
//! is asked for once a second, the one that has waited longest first.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;

use leadtime_link::live::{ArrivalEncoding, LiveKey, LiveSample, LiveTopic};
use leadtime_proto::{ClientName, ServiceName};
use leadtime_serve::TakenLine;
use serde_json::Value;

use crate::error::Error;
use crate::message::record;
use crate::topic::RecordedTopic;
use crate::write::RecordingWriter;

/// How many clients have a place in the file of which the notifier has said nothing.
const MAX_UNKNOWN: usize = 1_024;
/// How many clients have a place at all, and of how many it is known what they are. Of each there are six channels at most.
const MAX_CLIENTS: usize = 8_192;
/// How often it is asked what a client's session is, in nanoseconds.
const ASK_EVERY: u64 = 1_000_000_000;

/// What is known of a client's session in one start of the notifier.
#[derive(Debug)]
struct SeenSession {
    id: String,
    /// The start of the notifier; empty until a message states it.
    start: String,
    /// The last line of what was taken in.
    last_line: u64,
    /// Whether the recording has it from its first observation on.
    has_beginning: bool,
    is_recorded: bool,
    /// From when on the notifier may be asked what it is, in nanoseconds since 1970.
    ask_at: u64,
}

impl SeenSession {
    fn new(id: &str, ask_at: u64) -> Self {
        let (id, start) = (id.to_owned(), String::new());
        Self { id, start, last_line: 0, has_beginning: false, is_recorded: false, ask_at }
    }

    /// Returns whether it is time to ask what it is; a clock that was set back keeps nobody waiting.
    fn is_due(&self, now: u64) -> bool {
        let wait = self.ask_at.saturating_sub(now);
        !self.is_recorded && (wait == 0 || wait > ASK_EVERY)
    }
}

/// Writes what is published about clients into a recording.
#[derive(Debug)]
pub struct LiveRecorder<W: Write> {
    writer: RecordingWriter<W>,
    service: ServiceName,
    sessions: BTreeMap<ClientName, SeenSession>,
    /// The clients that have a place in the file, and whether the notifier has said what they are.
    placed: BTreeMap<ClientName, bool>,
    /// How many of them it has said nothing of.
    n_unknown: usize,
    n_sessions: usize,
    n_passed_over: u64,
}

impl<W: Write> LiveRecorder<W> {
    /// Records the clients of a notifier.
    pub fn new(writer: RecordingWriter<W>, service: ServiceName) -> Self {
        let (sessions, placed) = (BTreeMap::new(), BTreeMap::new());
        let (n_unknown, n_sessions, n_passed_over) = (0, 0, 0);
        Self { writer, service, sessions, placed, n_unknown, n_sessions, n_passed_over }
    }

    /// Writes a message that arrived at `at`, in nanoseconds since 1970.
    ///
    /// # Errors
    ///
    /// [`Error::Write`] if the file cannot be written, with what the system reports.
    pub fn take(&mut self, at: u64, sample: &LiveSample) -> Result<(), Error> {
        let LiveSample { client, topic, arrival, .. } = sample;
        let (payload, beside) = (arrival.payload(), arrival.attachment());
        self.take_message(at, client, *topic, &arrival.encoding(), (&*payload, beside.as_deref()))
    }

    /// Writes a message: its bytes, and those beside it.
    fn take_message(
        &mut self,
        at: u64,
        client: &ClientName,
        topic: LiveTopic,
        encoding: &ArrivalEncoding,
        (payload, beside): (&[u8], Option<&[u8]>),
    ) -> Result<(), Error> {
        let is_placed = self.place(client);
        self.n_passed_over += u64::from(!is_placed);
        match topic {
            LiveTopic::Taken => return self.take_lines(at, client, payload, is_placed),
            LiveTopic::Status => self.look_at_status(at, client, payload, is_placed),
            LiveTopic::Observations | LiveTopic::Say | LiveTopic::Heard => {}
        }
        if !is_placed {
            return Ok(());
        }
        let json = record(topic, encoding, payload, beside);
        let key = topic.key(&self.service, client).to_string();
        self.writer.write(&key, RecordedTopic::Live(topic), at, &json)
    }

    /// Gives a client a place in the file; `false` if it gets none, or none before the notifier says what it is.
    fn place(&mut self, client: &ClientName) -> bool {
        let is_known = self.sessions.get(client).is_some_and(|seen| seen.is_recorded);
        if let Some(was_known) = self.placed.get_mut(client) {
            // Somebody else can have its place among those of whom nothing is said.
            self.n_unknown -= usize::from(is_known && !*was_known);
            *was_known |= is_known;
            return true;
        }
        let has_room =
            self.placed.len() < MAX_CLIENTS && (is_known || self.n_unknown < MAX_UNKNOWN);
        if has_room {
            self.n_unknown += usize::from(!is_known);
            self.placed.insert(client.clone(), is_known);
        }
        has_room
    }

    /// Writes the lines of a message that are new: each message repeats some. Of a client without a place it is only seen that
    /// it has a session.
    fn take_lines(
        &mut self,
        at: u64,
        client: &ClientName,
        payload: &[u8],
        is_placed: bool,
    ) -> Result<(), Error> {
        let Ok(lines) = serde_json::from_slice::<Vec<TakenLine<'_>>>(payload) else {
            return Ok(());
        };
        let key = LiveTopic::Taken.key(&self.service, client).to_string();
        for line in lines {
            let Some(seen) = self.see(at, client, &line.session) else { continue };
            // A notifier that was started again goes on with the session, but counts from the beginning.
            if !seen.start.is_empty() && seen.start != line.start {
                *seen = SeenSession::new(&line.session, seen.ask_at);
            }
            seen.start = line.start.clone().into_owned();
            if line.n <= seen.last_line || !is_placed {
                continue;
            }
            seen.last_line = line.n;
            seen.has_beginning |= line.is_beginning();
            // Plain data: it cannot fail.
            let json = serde_json::to_vec(&line).unwrap_or_default();
            self.writer.write(&key, RecordedTopic::Live(LiveTopic::Taken), at, &json)?;
        }
        Ok(())
    }

    fn look_at_status(&mut self, at: u64, client: &ClientName, payload: &[u8], is_placed: bool) {
        let status: Value = serde_json::from_slice(payload).unwrap_or_default();
        if let Some(id) = status["session"].as_str() {
            let is_new = status["taken"] == 0 && is_placed;
            if let Some(seen) = self.see(at, client, id) {
                seen.has_beginning |= is_new;
            }
        }
    }

    /// Notices a client's session; `None` where there is no room: all others are known, or have yet to be asked for.
    fn see(&mut self, at: u64, client: &ClientName, id: &str) -> Option<&mut SeenSession> {
        if self.sessions.len() >= MAX_CLIENTS && !self.sessions.contains_key(client) {
            // One that was asked for in vain makes room.
            let unknown = self.sessions.iter().filter(|(_, seen)| !seen.is_recorded);
            let in_vain = unknown.filter(|(_, seen)| seen.ask_at > at).min_by_key(|it| it.1.ask_at);
            let in_vain = in_vain?.0.clone();
            self.sessions.remove(&in_vain);
        }
        let new = || SeenSession::new(id, at);
        let seen = self.sessions.entry(client.clone()).or_insert_with(new);
        if seen.id != id {
            *seen = SeenSession::new(id, seen.ask_at);
        }
        Some(seen)
    }

    /// Lists the clients whose session has to be asked for now, in nanoseconds since 1970, but for those that are being asked for,
    /// `n` at most: the one that has waited longest is the first, and nobody is asked for twice within a second.
    pub fn next_to_ask(
        &mut self,
        now: u64,
        n: usize,
        asked: &BTreeSet<ClientName>,
    ) -> Vec<ClientName> {
        let due = self.sessions.iter_mut();
        let due = due.filter(|(client, seen)| seen.is_due(now) && !asked.contains(*client));
        let mut due: Vec<_> = due.collect();
        due.sort_by_key(|(_, seen)| seen.ask_at);
        let asked = due.into_iter().take(n).map(|(client, seen)| {
            seen.ask_at = now.saturating_add(ASK_EVERY);
            client.clone()
        });
        asked.collect()
    }

    /// Writes what the notifier says a session is.
    ///
    /// # Errors
    ///
    /// [`Error::Write`] if the file cannot be written, with what the system reports.
    pub fn note(&mut self, at: u64, client: &ClientName, answer: &[u8]) -> Result<(), Error> {
        let Ok(mut note) = serde_json::from_slice::<Value>(answer) else { return Ok(()) };
        let Some(seen) = self.sessions.get_mut(client) else { return Ok(()) };
        let start = note["start"].as_str().unwrap_or_default();
        let is_this =
            note["session"] == seen.id.as_str() && (seen.start.is_empty() || seen.start == start);
        if !is_this || seen.is_recorded {
            return Ok(());
        }
        start.clone_into(&mut seen.start);
        seen.is_recorded = true;
        note["has_beginning"] = seen.has_beginning.into();
        if !self.place(client) {
            return Ok(());
        }
        self.n_sessions += 1;
        let key = LiveKey::Session(&self.service, client).to_string();
        self.writer.write(&key, RecordedTopic::Session, at, note.to_string().as_bytes())
    }

    /// Returns how many messages of how many sessions there are.
    pub fn counts(&self) -> (u64, usize) {
        (self.writer.n_messages(), self.n_sessions)
    }

    /// Returns how many messages were passed over, because the recording has no room for their client or its keys.
    pub fn n_passed_over(&self) -> u64 {
        self.n_passed_over + self.writer.n_passed_over()
    }

    /// Returns the file, to flush and to finish it.
    pub fn writer(&mut self) -> &mut RecordingWriter<W> {
        &mut self.writer
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = ASK_EVERY;
    /// What the notifier says of a session.
    const ANSWER: &[u8] = br#"{"session":"s","start":"a"}"#;

    fn recorder() -> LiveRecorder<Vec<u8>> {
        let writer = RecordingWriter::new(Vec::new(), "a test").unwrap();
        LiveRecorder::new(writer, ServiceName::new("notifier").unwrap())
    }

    fn name(i: usize) -> ClientName {
        ClientName::new(format!("invented-{i:05}")).unwrap()
    }

    /// Lets a client have a status, which anybody can put.
    fn status(recorder: &mut LiveRecorder<Vec<u8>>, at: u64, client: &ClientName) {
        let status = br#"{"session":"s","state":"silent","taken":0}"#;
        let encoding = ArrivalEncoding::Json;
        recorder.take_message(at, client, LiveTopic::Status, &encoding, (status, None)).unwrap();
    }

    #[test]
    fn invented_names_wait_for_their_turn_to_be_asked_for() {
        let mut recorder = recorder();
        (0..100).for_each(|i| status(&mut recorder, i as u64, &name(i)));
        let real = ClientName::new("real").unwrap();
        status(&mut recorder, 100, &real);
        let first = recorder.next_to_ask(200, 64, &BTreeSet::new());
        assert_eq!(first, (0..64).map(name).collect::<Vec<_>>());
        let second = recorder.next_to_ask(201, 64, &BTreeSet::new());
        assert_eq!((second.len(), second.last()), (37, Some(&real)));
        assert!(recorder.next_to_ask(202, 64, &BTreeSet::new()).is_empty());
        recorder.note(300, &real, ANSWER).unwrap();
        assert_eq!(recorder.counts(), (102, 1));
        let again = recorder.next_to_ask(300 + SECOND, 1_000, &BTreeSet::new());
        assert_eq!(again, (0..100).map(name).collect::<Vec<_>>());
        // A clock that is set back keeps nobody waiting.
        assert_eq!(recorder.next_to_ask(3, 1_000, &BTreeSet::new()).len(), 100);
    }

    #[test]
    fn a_client_that_the_notifier_knows_has_a_place_beside_any_number_of_invented_names() {
        let mut recorder = recorder();
        let n = MAX_CLIENTS + 100;
        for i in 0..n {
            status(&mut recorder, i as u64, &name(i));
            // One that was asked for in vain makes room.
            if i % 64 == 63 {
                recorder.next_to_ask(i as u64, 64, &BTreeSet::new());
            }
        }
        assert_eq!((recorder.placed.len(), recorder.n_unknown), (MAX_UNKNOWN, MAX_UNKNOWN));
        assert_eq!(recorder.sessions.len(), MAX_CLIENTS);
        assert_eq!(recorder.n_passed_over(), (n - MAX_UNKNOWN) as u64);
        let real = ClientName::new("real").unwrap();
        status(&mut recorder, SECOND, &real);
        let (before, _) = recorder.counts();
        assert!(recorder.next_to_ask(2 * SECOND, n, &BTreeSet::new()).contains(&real));
        recorder.note(2 * SECOND, &real, ANSWER).unwrap();
        status(&mut recorder, 2 * SECOND, &real);
        assert_eq!(recorder.counts(), (before + 2, 1));
    }

    #[test]
    fn clients_that_are_known_take_nobody_the_place_of_one_that_is_not() {
        let mut recorder = recorder();
        let n = MAX_UNKNOWN + 76;
        for i in 0..n {
            status(&mut recorder, i as u64, &name(i));
            recorder.note(i as u64, &name(i), ANSWER).unwrap();
        }
        let (before, n_sessions) = recorder.counts();
        assert_eq!((n_sessions, recorder.n_unknown), (n, 0));
        status(&mut recorder, SECOND, &ClientName::new("new").unwrap());
        assert_eq!(recorder.counts(), (before + 1, n));
        assert_eq!(recorder.n_passed_over(), 0);
    }

    #[test]
    fn who_is_being_asked_for_takes_no_turn_of_those_that_wait() {
        let mut recorder = recorder();
        (0..3).for_each(|i| status(&mut recorder, i as u64, &name(i)));
        let asked = BTreeSet::from([name(0), name(1)]);
        assert_eq!(recorder.next_to_ask(200, 1, &asked), [name(2)]);
    }
}
