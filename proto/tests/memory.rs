//! How much memory a hostile message can have allocated: little more than its own length deserves.
//!
//! A test binary of its own with a single test, because the allocator counts for the whole process.

use leadtime_proto::header::Schema;
use leadtime_proto::message::{Control, Hello, HelloReply};
use leadtime_proto::receive::{self, CONTROL, Expected, HELLO, HELLO_REPLY, ROLLOUT};
use leadtime_proto::{Header, Incarnation, Rollout};
use peak_alloc::PeakAlloc;
use serde::de::DeserializeOwned;

#[global_allocator]
static ALLOCATOR: PeakAlloc = PeakAlloc;

/// What the decoder sets aside for a list before it has seen its elements.
const LIST_START: usize = 1 << 20;
/// How many bytes one byte of a message may claim.
const CLAIM: usize = 16;
/// The smallest limit that the codec works with.
const SMALLEST_LIMIT: usize = 64 << 10;

/// Receives a sealed payload and returns the most memory that was in use meanwhile.
fn peak_of<T: DeserializeOwned>(payload: &[u8], expected: Expected) -> usize {
    let schema: Schema = expected.schema;
    let header = Header::plain(schema, Incarnation(1), payload).to_bytes();
    let before = ALLOCATOR.current_usage();
    ALLOCATOR.reset_peak_usage();
    drop(receive::receive::<T>(Some(&header), payload, expected));
    ALLOCATOR.peak_usage().saturating_sub(before)
}

#[test]
fn a_claim_is_not_believed_beyond_what_the_message_can_hold() {
    let mut worst = 0;
    for bits in 0..64 {
        for at in 0..120 {
            // A plausible beginning of small numbers, then a length that claims 2^bits elements or bytes.
            let mut payload = vec![1; at];
            payload.push(253);
            payload.extend_from_slice(&(1_u64 << bits).to_le_bytes());
            payload.resize(payload.len() + 40, 1);
            let limit = LIST_START + SMALLEST_LIMIT.max(CLAIM * payload.len());
            let peaks = [
                peak_of::<Rollout>(&payload, ROLLOUT),
                peak_of::<Control>(&payload, CONTROL),
                peak_of::<Hello>(&payload, HELLO),
                peak_of::<HelloReply>(&payload, HELLO_REPLY),
            ];
            let peak = peaks.into_iter().max().unwrap();
            assert!(peak <= limit, "claim of 2^{bits} at {at}: {peak} bytes, limit {limit}");
            worst = worst.max(peak);
        }
    }
    // Some of these claims are believed as far as they may be, or the test would show nothing.
    assert!(worst > SMALLEST_LIMIT / 2, "{worst}");
}
