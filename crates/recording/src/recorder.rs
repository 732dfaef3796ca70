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

/// What is known of a client's session.
#[derive(Debug)]
struct SeenSession {
    id: String,
    /// Whether the recording has it from its first observation on.
    has_beginning: bool,
    is_recorded: bool,
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
    /// [`Error::Write`] with what the disk says.
    pub fn take(&mut self, at: u64, sample: &LiveSample) -> Result<(), Error> {
        let LiveSample { client, topic, arrival } = sample;
        let (payload, beside) = (arrival.payload(), arrival.attachment());
        self.look(client, *topic, &payload);
        let json = record((*topic).into(), &arrival.encoding(), &payload, beside.as_deref());
        let key = topic.key(&self.service, client).to_string();
        self.writer.write(&key, (*topic).into(), at, &json)
    }

    /// Notices sessions, by what the notifier says about them.
    fn look(&mut self, client: &ClientName, topic: LiveTopic, payload: &[u8]) {
        let (id, has_beginning) = match topic {
            LiveTopic::Taken => match serde_json::from_slice::<TakenLine<'_>>(payload) {
                Ok(line) => (line.session.into_owned(), line.n == 1),
                Err(_other) => return,
            },
            LiveTopic::Status => {
                let status: Value = serde_json::from_slice(payload).unwrap_or_default();
                let Some(id) = status["session"].as_str() else { return };
                (id.to_owned(), status["taken"] == 0)
            }
            _ => return,
        };
        match self.sessions.get_mut(client) {
            Some(seen) if seen.id == id => seen.has_beginning |= has_beginning,
            _ => {
                let seen = SeenSession { id, has_beginning, is_recorded: false };
                self.sessions.insert(client.clone(), seen);
            }
        }
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
    /// [`Error::Write`] with what the disk says.
    pub fn note(&mut self, at: u64, client: &ClientName, answer: &[u8]) -> Result<(), Error> {
        let Ok(mut note) = serde_json::from_slice::<Value>(answer) else { return Ok(()) };
        let Some(seen) = self.sessions.get_mut(client) else { return Ok(()) };
        if note["session"] != seen.id.as_str() || seen.is_recorded {
            return Ok(());
        }
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

    /// As [`RecordingWriter::flush`].
    ///
    /// # Errors
    ///
    /// [`Error::Write`] with what the disk says.
    pub fn flush(&mut self) -> Result<(), Error> {
        self.writer.flush()
    }

    /// As [`RecordingWriter::finish`].
    ///
    /// # Errors
    ///
    /// [`Error::Write`] with what the disk says.
    pub fn finish(&mut self) -> Result<(), Error> {
        self.writer.finish()
    }
}
