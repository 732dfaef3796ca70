//! Feeds noise to what reads a worker's frames: as frames, as a hello's body, and as an answer about two environments.
//!
//! A panic, or an allocation over libFuzzer's `-malloc_limit_mb`, is a finding.
#![no_main]

use std::time::Duration;

use leadtime_worker::protocol::{
    FrameKind, FrameReader, FrameShape, StepRow, read_hello, read_stepped,
};
use libfuzzer_sys::fuzz_target;

const SHAPE: FrameShape = FrameShape { obs_dim: 2, n_heads: 1, n_metrics: 1 };
const SECOND: Duration = Duration::from_secs(1);

fuzz_target!(|bytes: &[u8]| {
    drop(read_hello(bytes));
    let mut rows = [StepRow::default(), StepRow::default()];
    if read_stepped(bytes, SHAPE, &mut rows).is_ok() {
        assert!(rows.iter().all(|row| row.observation.len() == SHAPE.obs_dim));
    }
    let mut reader = FrameReader::new(bytes);
    let most = SHAPE.max_stepped_bytes(rows.len());
    while reader.answer(FrameKind::Stepped, most, SECOND, SECOND, drop).is_ok() {}
});
