//! Writes scalars and settings as TensorBoard reads them: event files of framed protobuf records.
//!
//! ```text
//! record   length u64 | masked crc32c of the length u32 | event | masked crc32c of the event u32   (little-endian)
//! event    1: wall time f64   2: step i64   then one of
//!          3: file version    5: summary { 1: value ... }    7: session { 1: START }
//! value    1: tag   then   2: simple value f32   or   9: metadata { 1: plugin { 1: name  2: contents } }
//! hparams  3: session start { 1: { 1: key  2: { 2: f64 or 3: text or 4: bool } } ...  5: start time f64 }
//! ```
//!
//! A process that takes up a run again starts a file of its own with a session mark, so that TensorBoard forgets
//! what a killed process had written beyond the checkpoint.
//!
//! # Source
//!
//! `tensorboard/compat/proto/{event,summary}.proto`, `tensorboard/plugins/hparams/plugin_data.proto` and
//! `tensorboard/summary/writer/record_writer.py`.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::Path;

use leadtime_learner::write_atomically;
use toml::{Table, Value};

/// Wire types of protobuf: the low three bits of a field's key.
const VARINT: u64 = 0;
const FIXED64: u64 = 1;
const BYTES: u64 = 2;
const FIXED32: u64 = 5;

/// How the name of the event file of an evaluation ends.
const EVALUATION: &str = ".leadtime.eval";

/// Writes the scalars of a run's last evaluation as an event file of their own, in place of those before.
///
/// Other processes may do the same meanwhile; the latest file stays.
pub(crate) fn write_evaluation(
    directory: &Path,
    wall_time: f64,
    step: u64,
    scalars: &[(String, f64)],
) -> io::Result<()> {
    let mut file = EventFile { out: Vec::new() };
    file.version(wall_time)?;
    file.scalars(wall_time, step, scalars)?;
    fs::create_dir_all(directory)?;
    let name = format!("events.out.tfevents.{:010}{EVALUATION}", wall_time as u64);
    write_atomically(&directory.join(&name), &file.out)?;
    for entry in fs::read_dir(directory)? {
        let entry = entry?;
        let other = entry.file_name();
        let is_older = other.to_string_lossy().ends_with(EVALUATION) && other < *name;
        if is_older && let Err(error) = fs::remove_file(entry.path()) {
            // Another process was quicker.
            if error.kind() != io::ErrorKind::NotFound {
                return Err(error);
            }
        }
    }
    Ok(())
}

#[derive(Debug)]
pub(crate) struct EventFile<W = BufWriter<File>> {
    out: W,
}

impl EventFile {
    /// Creates an event file in `directory`, for steps from `first_step` on.
    ///
    /// `wall_time` is in seconds since the Unix epoch; `process` keeps two files of one second apart.
    pub(crate) fn create(
        directory: &Path,
        wall_time: f64,
        process: u32,
        first_step: u64,
    ) -> io::Result<Self> {
        fs::create_dir_all(directory)?;
        let name = format!("events.out.tfevents.{:010}.leadtime.{process}", wall_time as u64);
        let mut file = Self { out: BufWriter::new(File::create(directory.join(name))?) };
        file.version(wall_time)?;
        let mut session = event(wall_time, Some(first_step));
        bytes_field(&mut session, 7, &[8, 1]);
        file.record(&session)?;
        file.out.flush()?;
        Ok(file)
    }
}

impl<W: Write> EventFile<W> {
    fn version(&mut self, wall_time: f64) -> io::Result<()> {
        let mut version = event(wall_time, None);
        bytes_field(&mut version, 3, b"brain.Event:2");
        self.record(&version)
    }

    /// Appends the settings of a run, by their full keys, as hyper-parameters.
    pub(crate) fn settings(&mut self, wall_time: f64, table: &Table) -> io::Result<()> {
        let mut session = Vec::new();
        hyper_parameters(&mut session, "", table);
        fixed64_field(&mut session, 5, wall_time);
        let (mut contents, mut plugin, mut metadata) = (Vec::new(), Vec::new(), Vec::new());
        bytes_field(&mut contents, 3, &session);
        bytes_field(&mut plugin, 1, b"hparams");
        bytes_field(&mut plugin, 2, &contents);
        bytes_field(&mut metadata, 1, &plugin);
        let (mut entry, mut summary) = (Vec::new(), Vec::new());
        bytes_field(&mut entry, 1, b"_hparams_/session_start_info");
        bytes_field(&mut entry, 9, &metadata);
        bytes_field(&mut summary, 1, &entry);
        let mut record = event(wall_time, Some(0));
        bytes_field(&mut record, 5, &summary);
        self.record(&record)?;
        self.out.flush()
    }

    /// Appends scalars of one step and hands them to the operating system.
    pub(crate) fn scalars(
        &mut self,
        wall_time: f64,
        step: u64,
        scalars: &[(String, f64)],
    ) -> io::Result<()> {
        let mut summary = Vec::new();
        for (tag, value) in scalars {
            let mut entry = Vec::new();
            bytes_field(&mut entry, 1, tag.as_bytes());
            varint(&mut entry, 2 << 3 | FIXED32);
            entry.extend_from_slice(&(*value as f32).to_le_bytes());
            bytes_field(&mut summary, 1, &entry);
        }
        let mut record = event(wall_time, Some(step));
        bytes_field(&mut record, 5, &summary);
        self.record(&record)?;
        self.out.flush()
    }

    fn record(&mut self, event: &[u8]) -> io::Result<()> {
        let length = (event.len() as u64).to_le_bytes();
        self.out.write_all(&length)?;
        self.out.write_all(&masked_crc(&length).to_le_bytes())?;
        self.out.write_all(event)?;
        self.out.write_all(&masked_crc(event).to_le_bytes())
    }
}

/// Appends a hyper-parameter per leaf of a table.
fn hyper_parameters(out: &mut Vec<u8>, section: &str, table: &Table) {
    for (key, value) in table {
        let key = format!("{section}{key}");
        let mut written = Vec::new();
        match value {
            Value::Table(inner) => {
                hyper_parameters(out, &format!("{key}."), inner);
                continue;
            }
            Value::Integer(number) => fixed64_field(&mut written, 2, *number as f64),
            Value::Float(number) => fixed64_field(&mut written, 2, *number),
            Value::Boolean(is) => {
                varint(&mut written, 4 << 3 | VARINT);
                varint(&mut written, u64::from(*is));
            }
            Value::String(text) => bytes_field(&mut written, 3, text.as_bytes()),
            other => bytes_field(&mut written, 3, other.to_string().as_bytes()),
        }
        let mut entry = Vec::new();
        bytes_field(&mut entry, 1, key.as_bytes());
        bytes_field(&mut entry, 2, &written);
        bytes_field(out, 1, &entry);
    }
}

fn event(wall_time: f64, step: Option<u64>) -> Vec<u8> {
    let mut out = Vec::new();
    fixed64_field(&mut out, 1, wall_time);
    if let Some(step) = step {
        varint(&mut out, 2 << 3 | VARINT);
        varint(&mut out, step);
    }
    out
}

fn fixed64_field(out: &mut Vec<u8>, field: u64, value: f64) {
    varint(out, field << 3 | FIXED64);
    out.extend_from_slice(&value.to_le_bytes());
}

fn bytes_field(out: &mut Vec<u8>, field: u64, bytes: &[u8]) {
    varint(out, field << 3 | BYTES);
    varint(out, bytes.len() as u64);
    out.extend_from_slice(bytes);
}

fn varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// The checksum of a record: a rotated CRC-32C plus a constant, so that a checksum of checksums stays sound.
fn masked_crc(bytes: &[u8]) -> u32 {
    crc32c::crc32c(bytes).rotate_right(15).wrapping_add(0xa282_ead8)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Splits a file into its events, checking both checksums of every record.
    fn records(bytes: &[u8]) -> Vec<Vec<u8>> {
        let mut events = Vec::new();
        let mut rest = bytes;
        while !rest.is_empty() {
            let (length, after) = rest.split_at(8);
            let n = u64::from_le_bytes(length.try_into().unwrap()) as usize;
            assert_eq!(after[..4], masked_crc(length).to_le_bytes());
            let event = &after[4..4 + n];
            assert_eq!(after[4 + n..8 + n], masked_crc(event).to_le_bytes());
            events.push(event.to_vec());
            rest = &after[8 + n..];
        }
        events
    }

    #[test]
    fn a_masked_checksum_equals_tensorboards() {
        // python3 -c "from tensorboard.summary.writer.record_writer import masked_crc32c as m; import struct
        // print(hex(struct.unpack('<I', m(b'123456789'))[0]))"; CRC-32C's check value is 0xe3069283.
        assert_eq!(masked_crc(b"123456789"), 0xc78a_b0e5);
    }

    #[test]
    fn settings_are_hyper_parameters_of_their_type() {
        // As tensorboard 2.21 writes them: python3 -c "from tensorboard.plugins.hparams import plugin_data_pb2 as p
        // i = p.SessionStartInfo(start_time_secs=2.0); i.hparams['a.b'].number_value = 3
        // i.hparams['c'].bool_value = True; i.hparams['d'].string_value = 'x'
        // print(p.HParamsPluginData(session_start_info=i).SerializeToString())"
        let expected =
            b"\x1a.\n\x10\n\x03a.b\x12\t\x11\x00\x00\x00\x00\x00\x00\x08@\n\x07\n\x01c\x12\x02\
                         \x20\x01\n\x08\n\x01d\x12\x03\x1a\x01x)\x00\x00\x00\x00\x00\x00\x00@";
        let mut file = EventFile { out: Vec::new() };
        let table = "a.b = 3\nc = true\nd = \"x\"".parse().unwrap();
        file.settings(2.0, &table).unwrap();
        let [event] = &records(&file.out)[..] else { panic!("one event") };
        assert!(event.ends_with(expected), "{event:?}");
    }

    #[test]
    fn an_evaluation_takes_the_place_of_the_one_before_and_of_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        EventFile::create(dir.path(), 12.5, 7, 0).unwrap();
        for (time, success) in [(10.0, 0.2), (30.0, 1.0), (20.0, 0.5)] {
            let scalars = [("eval/success".to_owned(), success)];
            write_evaluation(dir.path(), time, 300, &scalars).unwrap();
        }
        let entries = fs::read_dir(dir.path()).unwrap();
        let mut names: Vec<_> =
            entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        // The one of second 20 comes from a process that was slower than the one of second 30.
        let expected =
            ["0000000012.leadtime.7", "0000000020.leadtime.eval", "0000000030.leadtime.eval"];
        assert_eq!(names, expected.map(|end| format!("events.out.tfevents.{end}")));
        let events = records(&fs::read(dir.path().join(&names[2])).unwrap());
        assert!(events[1].ends_with(&1.0_f32.to_le_bytes()));
    }

    #[test]
    fn scalars_are_framed_protobuf() {
        let dir = tempfile::tempdir().unwrap();
        let mut file = EventFile::create(dir.path(), 12.5, 7, 0).unwrap();
        file.scalars(13.0, 300, &[("loss".to_owned(), 0.5)]).unwrap();
        let path = dir.path().join("events.out.tfevents.0000000012.leadtime.7");
        let events = records(&std::fs::read(path).unwrap());
        assert_eq!(events.len(), 3);
        assert!(events[0].ends_with(b"\x1a\x0dbrain.Event:2"));
        assert_eq!(events[1][9..], [0x10, 0, 0x3a, 2, 8, 1]);
        let mut expected = vec![0x09];
        expected.extend_from_slice(&13.0_f64.to_le_bytes());
        expected.extend_from_slice(&[0x10, 0xac, 0x02, 0x2a, 13, 0x0a, 11, 0x0a, 4]);
        expected.extend_from_slice(b"loss\x15");
        expected.extend_from_slice(&0.5_f32.to_le_bytes());
        assert_eq!(events[2], expected);
    }
}
