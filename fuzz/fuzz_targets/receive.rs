//! Feeds noise to the receiving path: first as a header and a payload, then as payloads that an intruder sealed.
//!
//! The same functions check messages in the running system; see `leadtime_proto::receive`. A panic, an allocation
//! over libFuzzer's `-malloc_limit_mb`, or a message that does not survive a second crossing is a finding.
#![no_main]

use leadtime_proto::header::HEADER_BYTES;
use leadtime_proto::message::{Announcement, Control, ControlReply, Credit, Hello, HelloReply};
use leadtime_proto::receive::{self, Expected};
use leadtime_proto::{ActionSpec, EnvSpec, Header, Incarnation, Rollout, codec};
use libfuzzer_sys::fuzz_target;

/// Receives a payload that is sealed as its kind; what gets through must cross once more.
fn sealed<T>(payload: &[u8], expected: Expected) -> Option<T>
where
    T: serde::Serialize + serde::de::DeserializeOwned,
{
    let header = Header::plain(expected.schema, Incarnation(1), payload).to_bytes();
    let (_, message) = receive::receive::<T>(Some(&header), payload, expected).ok()?;
    let again = codec::encode(&message).expect("what was decoded can be encoded");
    let back: T = codec::decode(&again, expected.max_bytes).expect("and decoded again");
    assert_eq!(codec::encode(&back).expect("and encoded again"), again);
    Some(message)
}

fuzz_target!(|bytes: &[u8]| {
    let (header, payload) = bytes.split_at(bytes.len().min(HEADER_BYTES));
    drop(receive::receive::<Rollout>(Some(header), payload, receive::ROLLOUT));

    if let Some(rollout) = sealed::<Rollout>(bytes, receive::ROLLOUT) {
        let spec = EnvSpec {
            obs_dim: 2,
            actions: ActionSpec::discrete("choice", 3),
            metrics: vec!["success".to_owned()],
        };
        let n_steps = rollout.n_steps as usize;
        drop(rollout.check(&spec, n_steps, 0));
    }
    sealed::<Control>(bytes, receive::CONTROL);
    sealed::<ControlReply>(bytes, receive::CONTROL_REPLY);
    sealed::<Hello>(bytes, receive::HELLO);
    sealed::<HelloReply>(bytes, receive::HELLO_REPLY);
    sealed::<Credit>(bytes, receive::CREDIT);
    sealed::<Announcement>(bytes, receive::ANNOUNCEMENT);
});
