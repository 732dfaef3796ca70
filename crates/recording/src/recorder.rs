//! From what is published to a file: every message on its channel, and every session with what it is.

use std::collections::BTreeMap;
use std::io::Write;

use leadtime_link::live::{LiveKey, LiveSample, LiveTopic};
use leadtime_proto::{ClientName, ServiceName};
use leadtime_serve::TakenLine;
use serde_json::Value;

use crate::error::Error;
use crate::message::record;
use crate::topic::RecordedTopic;
use crate::write::RecordingWriter;

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
}

impl SeenSession {
    fn new(id: &str) -> Self {
        let (id, start) = (id.to_owned(), String::new());
        Self { id, start, last_line: 0, has_beginning: false, is_recorded: false }
    }
}

/// Writes what is published about clients into a recording.
#[derive(Debug)]
pub struct LiveRecorder<W: Write> {
    writer: RecordingWriter<W>,
    service: ServiceName,
    sessions: BTreeMap<ClientName, SeenSession>,
    n_sessions: usize,
}

impl<W: Write> LiveRecorder<W> {
    /// Records the clients of a notifier.
    pub fn new(writer: RecordingWriter<W>, service: ServiceName) -> Self {
        Self { writer, service, sessions: BTreeMap::new(), n_sessions: 0 }
    }

    /// Writes a message that arrived at `at`, in nanoseconds since 1970.
    ///
    /// # Errors
    ///
    /// [`Error::Write`] if the file cannot be written, with what the system reports.
    pub fn take(&mut self, at: u64, sample: &LiveSample) -> Result<(), Error> {
        let LiveSample { client, topic, arrival } = sample;
        let (payload, beside) = (arrival.payload(), arrival.attachment());
        match topic {
            LiveTopic::Taken => return self.take_lines(at, client, &payload),
            LiveTopic::Status => self.look_at_status(client, &payload),
            LiveTopic::Observations | LiveTopic::Say | LiveTopic::Heard => {}
        }
        let json = record(*topic, &arrival.encoding(), &payload, beside.as_deref());
        let key = topic.key(&self.service, client).to_string();
        self.writer.write(&key, RecordedTopic::Live(*topic), at, &json)
    }

    /// Writes the lines of a message that are new: each message repeats some.
    fn take_lines(&mut self, at: u64, client: &ClientName, payload: &[u8]) -> Result<(), Error> {
        let Ok(lines) = serde_json::from_slice::<Vec<TakenLine<'_>>>(payload) else {
            return Ok(());
        };
        let key = LiveTopic::Taken.key(&self.service, client).to_string();
        for line in lines {
            let seen = self.see(client, &line.session);
            // A notifier that was started again goes on with the session, but counts from the beginning.
            if !seen.start.is_empty() && seen.start != line.start {
                *seen = SeenSession::new(&line.session);
            }
            seen.start = line.start.clone().into_owned();
            if line.n <= seen.last_line {
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

    fn look_at_status(&mut self, client: &ClientName, payload: &[u8]) {
        let status: Value = serde_json::from_slice(payload).unwrap_or_default();
        if let Some(id) = status["session"].as_str() {
            let is_new = status["taken"] == 0;
            self.see(client, id).has_beginning |= is_new;
        }
    }

    /// Notices a client's session.
    fn see(&mut self, client: &ClientName, id: &str) -> &mut SeenSession {
        let seen = self.sessions.entry(client.clone()).or_insert_with(|| SeenSession::new(id));
        if seen.id != id {
            *seen = SeenSession::new(id);
        }
        seen
    }

    /// Lists the clients whose session has to be asked for.
    pub fn unknown(&self) -> Vec<ClientName> {
        let unknown = self.sessions.iter().filter(|(_, seen)| !seen.is_recorded);
        unknown.map(|(client, _)| client.clone()).collect()
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
        self.n_sessions += 1;
        let key = LiveKey::Session(&self.service, client).to_string();
        self.writer.write(&key, RecordedTopic::Session, at, note.to_string().as_bytes())
    }

    /// Returns how many messages of how many sessions there are.
    pub fn counts(&self) -> (u64, usize) {
        (self.writer.n_messages(), self.n_sessions)
    }

    /// Returns the file, to flush and to finish it.
    pub fn writer(&mut self) -> &mut RecordingWriter<W> {
        &mut self.writer
    }
}
