//! Feeds noise to the reader of certificates, as `leadtime certs show` and the check before dialling call it: as a file, and as what
//! a file holds.
//!
//! A panic, an allocation over libFuzzer's `-malloc_limit_mb`, or a certificate with more hosts than are read is a finding.
#![no_main]

use leadtime_certs::Certificate;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    for read in [Certificate::parse(bytes), Certificate::from_der(bytes)].into_iter().flatten() {
        assert!(read.hosts.len() <= 256);
        // As it is printed.
        drop(format!("{read:?} {} {}", read.begins, read.ends));
    }
});
