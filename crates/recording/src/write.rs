//! Writing: an MCAP file that is readable up to the last second, whenever its writer is killed.
//!
//! Every chunk is put together in memory and written at once, so that no half of one is ever followed by another.

use std::collections::BTreeMap;
use std::io::Write;

use mcap::WriteOptions;
use mcap::records::MessageHeader;
use mcap::write::{Metadata, NoSeek};

use crate::error::Error;
use crate::topic::RecordedTopic;

/// The size from which on a chunk is closed, in bytes.
const CHUNK: u64 = 256 << 10;
/// The most channels of a file: their numbers have 16 bits. What comes on further keys is passed over, and counted.
const MAX_CHANNELS: usize = 60_000;
/// The name of the metadata that says what wrote the file.
pub(crate) const METADATA: &str = "leadtime.recording";
/// The version of what is recorded.
pub(crate) const VERSION: &str = "1";

#[derive(Debug)]
struct OpenChannel {
    id: u16,
    n_messages: u32,
}

/// A recording in the making.
pub struct RecordingWriter<W: Write> {
    file: mcap::Writer<NoSeek<W>>,
    channels: BTreeMap<String, OpenChannel>,
    n_messages: u64,
    n_bytes: u64,
    n_passed_over: u64,
}

impl<W: Write> std::fmt::Debug for RecordingWriter<W> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let n = self.n_messages;
        f.debug_struct("RecordingWriter").field("n_messages", &n).finish_non_exhaustive()
    }
}

impl<W: Write> RecordingWriter<W> {
    /// Begins a recording; `program` says what writes it.
    ///
    /// # Errors
    ///
    /// [`Error::Write`] if the file cannot be written, with what the system reports.
    pub fn new(out: W, program: &str) -> Result<Self, Error> {
        let options = WriteOptions::new()
            .compression(None)
            .chunk_size(Some(CHUNK))
            .disable_seeking(true)
            .profile("leadtime")
            .library(program);
        let mut file = options.create(NoSeek::new(out)).map_err(Error::writing)?;
        let metadata = [("version", VERSION), ("program", program)];
        let metadata = metadata.map(|(key, value)| (key.to_owned(), value.to_owned())).into();
        let metadata = Metadata { name: METADATA.to_owned(), metadata };
        file.write_metadata(&metadata).map_err(Error::writing)?;
        let (channels, n_messages, n_bytes, n_passed_over) = (BTreeMap::new(), 0, 0, 0);
        let mut writer = Self { file, channels, n_messages, n_bytes, n_passed_over };
        writer.flush()?;
        Ok(writer)
    }

    /// Adds a message; `at` is when it arrived, in nanoseconds since 1970. One of a further key is passed over once there are
    /// [`MAX_CHANNELS`] of them.
    ///
    /// # Errors
    ///
    /// [`Error::Write`] if the file cannot be written, with what the system reports.
    pub fn write(
        &mut self,
        key: &str,
        topic: RecordedTopic,
        at: u64,
        json: &[u8],
    ) -> Result<(), Error> {
        let channel = if let Some(channel) = self.channels.get_mut(key) {
            channel
        } else if self.channels.len() >= MAX_CHANNELS {
            self.n_passed_over += 1;
            return Ok(());
        } else {
            let (name, schema) = topic.schema();
            let schema = self.file.add_schema(name, "jsonschema", schema.as_bytes());
            let schema = schema.map_err(Error::writing)?;
            let id = self.file.add_channel(schema, key, "json", &BTreeMap::new());
            let channel = OpenChannel { id: id.map_err(Error::writing)?, n_messages: 0 };
            self.channels.entry(key.to_owned()).or_insert(channel)
        };
        let sequence = channel.n_messages;
        channel.n_messages = sequence.wrapping_add(1);
        let (channel_id, log_time, publish_time) = (channel.id, at, at);
        let header = MessageHeader { channel_id, sequence, log_time, publish_time };
        self.file.write_to_known_channel(&header, json).map_err(Error::writing)?;
        self.n_messages += 1;
        self.n_bytes += json.len() as u64;
        Ok(())
    }

    /// Returns how many messages there are.
    pub fn n_messages(&self) -> u64 {
        self.n_messages
    }

    /// Returns how long all messages are together, in bytes.
    pub fn n_bytes(&self) -> u64 {
        self.n_bytes
    }

    /// Returns how many messages were passed over.
    pub fn n_passed_over(&self) -> u64 {
        self.n_passed_over
    }

    /// Closes the chunk and hands it to the disk: it can be read from now on, whatever happens.
    ///
    /// # Errors
    ///
    /// [`Error::Write`] if the file cannot be written, with what the system reports.
    pub fn flush(&mut self) -> Result<(), Error> {
        self.file.flush().map_err(Error::writing)
    }

    /// Ends the file with its index.
    ///
    /// # Errors
    ///
    /// [`Error::Write`] if the file cannot be written, with what the system reports.
    pub fn finish(&mut self) -> Result<(), Error> {
        self.file.finish().map_err(Error::writing)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::io;

    use leadtime_link::live::LiveTopic;

    use super::*;
    use crate::read::{RecordingEnd, RecordingFile};

    const KEY: &str = "leadtime/live/1/notifier/car-1/status";

    /// A recording of so many messages in chunks of ten.
    fn recording(n: u64) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut writer = RecordingWriter::new(&mut bytes, "a test").unwrap();
        for i in 0..n {
            let json = format!("{{\"session\":\"s\",\"state\":\"silent\",\"taken\":{i}}}");
            writer.write(KEY, RecordedTopic::Live(LiveTopic::Status), i, json.as_bytes()).unwrap();
            if i % 10 == 9 {
                writer.flush().unwrap();
            }
        }
        writer.finish().unwrap();
        drop(writer);
        bytes
    }

    fn times(bytes: &[u8]) -> (Vec<u64>, RecordingEnd) {
        match RecordingFile::read(bytes) {
            Ok(read) => {
                (read.clients[0].messages.iter().map(|message| message.at).collect(), read.end)
            }
            Err(_) => (Vec::new(), RecordingEnd::Cut),
        }
    }

    #[test]
    fn a_file_is_read_up_to_its_last_whole_chunk_wherever_it_is_cut() {
        let whole = recording(35);
        let all: Vec<u64> = (0..35).collect();
        assert_eq!(times(&whole), (all.clone(), RecordingEnd::Whole));
        let mut seen = std::collections::BTreeSet::new();
        for cut in 0..whole.len() {
            let (read, _) = times(&whole[..cut]);
            assert_eq!(read, all[..read.len()], "{cut}");
            seen.insert(read.len());
        }
        assert_eq!(seen.into_iter().collect::<Vec<_>>(), [0, 10, 20, 30, 35]);
    }

    #[test]
    fn damage_anywhere_causes_neither_a_panic_nor_wrong_data() {
        let whole = recording(25);
        for i in 0..whole.len() {
            for bit in [0x01, 0x80] {
                let mut damaged = whole.clone();
                damaged[i] ^= bit;
                let (read, _) = times(&damaged);
                // A chunk whose kind is damaged is passed over: its lines are missing, which is reported.
                let is_right = read.iter().all(|at| *at < 25) && read.is_sorted_by(|a, b| a < b);
                assert!(is_right && read.len() % 5 == 0, "byte {i}: {read:?}");
            }
        }
    }

    #[test]
    fn more_keys_than_a_file_has_channels_end_no_recording() {
        let mut writer = RecordingWriter::new(std::io::sink(), "a test").unwrap();
        for i in 0..=u32::from(u16::MAX) {
            let key = format!("leadtime/1/r/metrics/actor/a{i}");
            writer.write(&key, RecordedTopic::Metrics, 0, b"{}").unwrap();
        }
        let n = MAX_CHANNELS as u64;
        assert_eq!((writer.n_messages(), writer.n_passed_over()), (n, 65_536 - n));
        writer.write(KEY, RecordedTopic::Live(LiveTopic::Status), 0, b"{}").unwrap();
        writer.write("leadtime/1/r/metrics/actor/a0", RecordedTopic::Metrics, 0, b"{}").unwrap();
        assert_eq!((writer.n_messages(), writer.n_passed_over()), (n + 1, 65_537 - n));
    }

    /// A disk with room for so many bytes.
    struct SmallDisk {
        room: usize,
        written: std::rc::Rc<std::cell::RefCell<Vec<u8>>>,
    }

    impl Write for SmallDisk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let n = bytes.len().min(self.room);
            if n == 0 {
                return Err(io::ErrorKind::StorageFull.into());
            }
            self.room -= n;
            self.written.borrow_mut().extend(&bytes[..n]);
            Ok(n)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_full_disk_is_told_and_what_was_written_can_be_read() {
        let written = std::rc::Rc::default();
        let disk = SmallDisk { room: 6_000, written: std::rc::Rc::clone(&written) };
        let mut writer = RecordingWriter::new(disk, "a test").unwrap();
        let mut n_kept = 0;
        let error = loop {
            let at = writer.n_messages();
            writer.write(KEY, RecordedTopic::Live(LiveTopic::Status), at, b"{}").unwrap();
            match writer.flush() {
                Ok(()) => n_kept += 1,
                Err(error) => break error,
            }
        };
        assert!(matches!(error, Error::Write(_)), "{error}");
        writer.finish().unwrap_err();
        drop(writer);
        let (read, end) = times(&written.borrow());
        // The last chunk may be whole, though its index is not.
        assert_eq!(read, (0..read.len() as u64).collect::<Vec<u64>>());
        assert!(n_kept > 5 && [n_kept, n_kept + 1].contains(&read.len()), "{n_kept} {read:?}");
        assert_eq!(end, RecordingEnd::Cut);
    }
}
