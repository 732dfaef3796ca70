//! Writes scalars as TensorBoard reads them: event files of framed protobuf records.
//!
//! ```text
//! record   length u64 | masked crc32c of the length u32 | event | masked crc32c of the event u32   (little-endian)
//! event    1: wall time f64   2: step i64   then one of
//!          3: file version    5: summary { 1: value { 1: tag  2: simple value f32 } ... }    7: session { 1: START }
//! ```
//!
//! A process that takes up a run again starts a file of its own with a session mark, so that TensorBoard forgets
//! what a killed process had written beyond the checkpoint.
//!
//! # Source
//!
//! `tensorboard/compat/proto/{event,summary}.proto` and `tensorboard/summary/writer/record_writer.py`.

use std::fs::File;
use std::io::{self, BufWriter, Write as _};
use std::path::Path;

/// Wire types of protobuf: the low three bits of a field's key.
const VARINT: u64 = 0;
const FIXED64: u64 = 1;
const BYTES: u64 = 2;
const FIXED32: u64 = 5;

/// An open event file.
#[derive(Debug)]
pub(crate) struct EventFile {
    out: BufWriter<File>,
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
        std::fs::create_dir_all(directory)?;
        let name = format!("events.out.tfevents.{:010}.leadtime.{process}", wall_time as u64);
        let mut file = Self { out: BufWriter::new(File::create(directory.join(name))?) };
        let mut version = event(wall_time, None);
        bytes_field(&mut version, 3, b"brain.Event:2");
        file.record(&version)?;
        let mut session = event(wall_time, Some(first_step));
        bytes_field(&mut session, 7, &[8, 1]);
        file.record(&session)?;
        file.out.flush()?;
        Ok(file)
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

fn event(wall_time: f64, step: Option<u64>) -> Vec<u8> {
    let mut out = Vec::new();
    varint(&mut out, 1 << 3 | FIXED64);
    out.extend_from_slice(&wall_time.to_le_bytes());
    if let Some(step) = step {
        varint(&mut out, 2 << 3 | VARINT);
        varint(&mut out, step);
    }
    out
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
