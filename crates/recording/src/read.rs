//! Reading: everything up to the last whole chunk, and how the file ended.

use std::collections::BTreeMap;
use std::io::Read;

use mcap::McapError;
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use crate::error::Error;
use crate::topic::RecordedTopic;
use crate::write::{METADATA, VERSION};

/// The longest record, in bytes; a chunk of ours has a little more than 256 kB.
const MAX_RECORD: usize = 64 << 20;
/// The most that is read of a file at a time, in bytes of messages: as sessions they take as much again.
pub const MAX_READ_BYTES: u64 = 1 << 30;

/// How a file ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RecordingEnd {
    /// As its writer ended it.
    Whole,
    /// In the middle: its writer was killed, or the file was cut.
    Cut,
    /// With what cannot be read; the sentence says why.
    Damaged(String),
}

/// A message of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedMessage {
    /// What kind of message it is.
    pub topic: RecordedTopic,
    /// When it arrived at the recorder, in nanoseconds since 1970.
    pub at: u64,
    /// As it is recorded.
    pub json: Vec<u8>,
}

/// Everything that was recorded about one client, in the order of arrival.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedClient {
    /// The notifier and the client: `notifier/car-1`.
    pub name: String,
    /// What was recorded, in the order of the file; nothing where something else is read.
    pub messages: Vec<RecordedMessage>,
}

/// A recording as it is read.
#[derive(Clone, Debug)]
pub struct RecordingFile {
    /// Every client, by name.
    pub clients: Vec<RecordedClient>,
    /// How the file ended.
    pub end: RecordingEnd,
}

impl RecordingFile {
    /// Reads a recording up to its last whole chunk.
    ///
    /// # Errors
    ///
    /// [`Error::NoMcap`] if it is no MCAP file, [`Error::Foreign`] or [`Error::Version`] if something else or another
    /// release wrote it, [`Error::Compressed`] if its chunks are compressed, [`Error::Empty`] if it ends before its
    /// first whole chunk, [`Error::TooLarge`] if there is more than [`MAX_READ_BYTES`] of its messages, [`Error::Read`] if
    /// the system cannot read it.
    pub fn read(from: impl Read) -> Result<Self, Error> {
        Self::read_of(from, |_| true)
    }

    /// Reads what is about the clients that are wanted, by their names: of the others, the names alone.
    ///
    /// # Errors
    ///
    /// As [`Self::read`]; messages about others take no memory.
    pub fn read_of(from: impl Read, is_wanted: impl Fn(&str) -> bool) -> Result<Self, Error> {
        Self::read_within(from, &is_wanted, MAX_READ_BYTES)
    }

    fn read_within(
        mut from: impl Read,
        is_wanted: &dyn Fn(&str) -> bool,
        max_bytes: u64,
    ) -> Result<Self, Error> {
        let options = LinearReaderOptions::default()
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(MAX_RECORD);
        let mut reader = LinearReader::new_with_options(options);
        let (mut taken, mut is_started) = (TakenRecords::new(is_wanted, max_bytes), false);
        let end = loop {
            let failed = match reader.next_event() {
                None => break RecordingEnd::Whole,
                Some(Ok(LinearReadEvent::ReadRequest(need))) => {
                    let read = from.read(reader.insert(need)).map_err(Error::Read)?;
                    reader.notify_read(read);
                    continue;
                }
                Some(Ok(LinearReadEvent::Record { data, opcode })) => {
                    is_started = true;
                    match taken.take(opcode, data) {
                        Ok(true) => continue,
                        Ok(false) => break RecordingEnd::Whole,
                        Err(TakeError::Ours(error)) => return Err(error),
                        Err(TakeError::Format(error)) => error,
                    }
                }
                Some(Err(error)) => error,
            };
            match failed {
                McapError::BadMagic | McapError::UnexpectedEof if !is_started => {
                    return Err(Error::NoMcap);
                }
                McapError::UnexpectedEof | McapError::UnexpectedEoc => break RecordingEnd::Cut,
                McapError::UnsupportedCompression(name) => return Err(Error::Compressed(name)),
                other => break RecordingEnd::Damaged(other.to_string()),
            }
        };
        taken.finish(end)
    }
}

/// Why a record is not taken.
enum TakeError {
    Ours(Error),
    Format(McapError),
}

impl From<McapError> for TakeError {
    fn from(error: McapError) -> Self {
        Self::Format(error)
    }
}

/// What has been read.
struct TakenRecords<'a> {
    is_wanted: &'a dyn Fn(&str) -> bool,
    max_bytes: u64,
    /// Channels of ours by number: whose, what.
    channels: BTreeMap<u16, (String, RecordedTopic)>,
    /// The names of other channels.
    others: Vec<String>,
    clients: BTreeMap<String, Vec<RecordedMessage>>,
    n_bytes: u64,
}

impl<'a> TakenRecords<'a> {
    fn new(is_wanted: &'a dyn Fn(&str) -> bool, max_bytes: u64) -> Self {
        let (channels, others, clients) = (BTreeMap::new(), Vec::new(), BTreeMap::new());
        Self { is_wanted, max_bytes, channels, others, clients, n_bytes: 0 }
    }

    /// Takes a record; `false` at the end of the data.
    fn take(&mut self, opcode: u8, data: &[u8]) -> Result<bool, TakeError> {
        // Only what is needed is parsed: of a damaged file as little as possible.
        match opcode {
            op::DATA_END => return Ok(false),
            op::CHANNEL | op::MESSAGE | op::METADATA => {}
            _ => return Ok(true),
        }
        match mcap::parse_record(opcode, data)? {
            Record::Channel(channel) => match RecordedTopic::of_key(&channel.topic) {
                Some((name, topic)) => {
                    self.channels.insert(channel.id, (name.to_owned(), topic));
                }
                None => self.others.push(channel.topic),
            },
            Record::Metadata(metadata) if metadata.name == METADATA => {
                let found = metadata.metadata.get("version").cloned().unwrap_or_default();
                if found != VERSION {
                    let known = VERSION;
                    return Err(TakeError::Ours(Error::Version { found, known }));
                }
            }
            Record::Message { header, data } => {
                let Some((name, topic)) = self.channels.get(&header.channel_id) else {
                    return Ok(true);
                };
                let messages = self.clients.entry(name.clone()).or_default();
                if !(self.is_wanted)(name) {
                    return Ok(true);
                }
                self.n_bytes += data.len() as u64;
                if self.n_bytes > self.max_bytes {
                    return Err(TakeError::Ours(Error::TooLarge(self.max_bytes)));
                }
                let (topic, at) = (*topic, header.log_time);
                messages.push(RecordedMessage { topic, at, json: data.into_owned() });
            }
            _ => {}
        }
        Ok(true)
    }

    fn finish(self, end: RecordingEnd) -> Result<RecordingFile, Error> {
        if self.clients.is_empty() {
            return Err(match (&end, self.others.first()) {
                (_, Some(other)) => Error::Foreign(format!("`{other}`")),
                (RecordingEnd::Whole, None) => Error::Nothing,
                _ => Error::Empty,
            });
        }
        let clients = self.clients.into_iter();
        let clients = clients.map(|(name, messages)| RecordedClient { name, messages }).collect();
        Ok(RecordingFile { clients, end })
    }
}

#[cfg(test)]
mod tests {
    use leadtime_link::live::LiveTopic;

    use super::*;
    use crate::write::RecordingWriter;

    #[test]
    fn what_is_read_of_one_client_is_not_limited_by_the_others() {
        let mut bytes = Vec::new();
        let mut writer = RecordingWriter::new(&mut bytes, "a test").unwrap();
        let json = format!("{{\"x\":\"{}\"}}", "7".repeat(100));
        for (client, n) in [("car-1", 100), ("car-2", 3)] {
            let key = format!("leadtime/live/1/notifier/{client}/status");
            for at in 0..n {
                let topic = RecordedTopic::Live(LiveTopic::Status);
                writer.write(&key, topic, at, json.as_bytes()).unwrap();
            }
        }
        writer.finish().unwrap();
        assert_eq!(writer.n_bytes(), 103 * json.len() as u64);
        drop(writer);
        let refused = RecordingFile::read_within(&*bytes, &|_| true, 1_000).unwrap_err();
        assert!(matches!(refused, Error::TooLarge(1_000)), "{refused}");
        let is_second = |name: &str| name == "notifier/car-2";
        let read = RecordingFile::read_within(&*bytes, &is_second, 1_000).unwrap();
        let clients = read.clients.iter().map(|it| (it.name.as_str(), it.messages.len()));
        let expected = [("notifier/car-1", 0), ("notifier/car-2", 3)];
        assert_eq!(clients.collect::<Vec<_>>(), expected);
    }
}
