//! Feeds noise to the reader of observations: as JSON, and as raw numbers with 40 bytes beside them, as they are and sealed by an
//! intruder who knows the checksum.
//!
//! A panic, an allocation over libFuzzer's `-malloc_limit_mb`, or an observation that does not survive a second crossing is a
//! finding.
#![no_main]

use leadtime_serve::HeardSay;
use leadtime_serve::heard::HeardReport;
use leadtime_serve::observation::{LiveObservation, RAW_HEADER, write_json, write_raw};
use libfuzzer_sys::fuzz_target;

const OBS_DIM: usize = 4;

fuzz_target!(|bytes: &[u8]| {
    let mut read = LiveObservation::new(OBS_DIM);
    if read.read_json(bytes).is_ok() {
        let mut again = LiveObservation::new(OBS_DIM);
        again
            .read_json(&write_json(&read.head, &read.values))
            .expect("what was read can be written");
        assert_eq!((again.head.seq, &again.values), (read.head.seq, &read.values));
    }
    let (beside, numbers) = bytes.split_at(bytes.len().min(RAW_HEADER));
    if read.read_raw(numbers, beside).is_ok() {
        let (numbers, beside) = write_raw(&read.head, &read.values);
        let mut again = LiveObservation::new(OBS_DIM);
        again.read_raw(&numbers, &beside).expect("what was read can be written");
        assert_eq!(again.values, read.values);
    }
    drop(HeardReport::read(bytes));
    drop(HeardSay::read(bytes));
});
