//! Feeds noise to the readers of a robot's messages: CDR of ROS 2, and what `rmw_zenoh` puts beside it.
//!
//! A panic, an allocation over libFuzzer's `-malloc_limit_mb`, numbers that are not in the message, or a text that does not
//! survive a second crossing is a finding.
#![no_main]

use leadtime_serve::robot::cdr::{float32_array, string, write_string};
use leadtime_serve::robot::ros2::SourceMark;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(numbers) = float32_array(bytes) {
        let numbers = numbers.as_flattened();
        assert!(
            bytes.windows(numbers.len().max(1)).any(|window| window == numbers)
                || numbers.is_empty()
        );
    }
    if let Some(text) = string(bytes)
        && !text.contains('\0')
    {
        let mut written = Vec::new();
        write_string(text.as_bytes(), &mut written);
        assert_eq!(string(&written), Some(text));
    }
    if let Some(mark) = SourceMark::read(bytes) {
        assert_eq!(mark.write(), bytes);
    }
});
