//! Genuine messages with flipped bits, a million of them, through the receiving path: no panic, and no memory that grows.
//!
//! ```console
//! cargo run --release -p leadtime-proto --example mutations
//! ```
//!
//! Every message is one of those that are frozen in `tests/data`, with one to eight bits flipped, and now and then cut or
//! lengthened. Half of them keep the checksum of the original, as damage on the way would; the others are sealed anew, as
//! somebody who knows the format would, so that the decoder sees them.

#![expect(clippy::print_stdout, clippy::expect_used, reason = "a program for people")]

use std::collections::BTreeMap;
use std::process::ExitCode;

use leadtime_numerics::Pcg64;
use leadtime_proto::header::PROTOCOL_VERSION;
use leadtime_proto::message::{Announcement, Control, ControlReply, Credit, Hello, HelloReply};
use leadtime_proto::receive::{self, Expected};
use leadtime_proto::{ActionSpec, EnvSpec, Header, Incarnation, Refusal, Rollout};
use peak_alloc::PeakAlloc;
use serde::de::DeserializeOwned;

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

/// Messages that are tried.
const N_MESSAGES: u64 = 1_000_000;
/// What one message may take while it is received: its bytes and what the decoder's limit allows.
const MOST_BYTES: usize = 8 << 20;

fn opened<T: DeserializeOwned>(
    header: &[u8],
    payload: &[u8],
    expected: Expected,
) -> Result<T, Refusal> {
    receive::receive::<T>(Some(header), payload, expected).map(|(_, message)| message)
}

/// Receives a message of a kind as the running system does; returns why it is refused.
fn receive_as(kind: &str, header: &[u8], payload: &[u8]) -> Result<(), Refusal> {
    let spec = || EnvSpec {
        obs_dim: 4,
        actions: ActionSpec::discrete("push", 2),
        metrics: vec!["length".to_owned()],
    };
    match kind.split('.').next().unwrap_or_default() {
        "hello" => opened::<Hello>(header, payload, receive::HELLO)?.check(),
        "hello_reply" => opened::<HelloReply>(header, payload, receive::HELLO_REPLY).map(drop),
        "control" => opened::<Control>(header, payload, receive::CONTROL).map(drop),
        "control_reply" => {
            opened::<ControlReply>(header, payload, receive::CONTROL_REPLY).map(drop)
        }
        "credit" => opened::<Credit>(header, payload, receive::CREDIT).map(drop),
        "announcement" => opened::<Announcement>(header, payload, receive::ANNOUNCEMENT).map(drop),
        _ => {
            let rollout = opened::<Rollout>(header, payload, receive::ROLLOUT)?;
            rollout.check(&spec(), 2, 0).map(drop)
        }
    }
}

fn expected(kind: &str) -> Expected {
    match kind.split('.').next().unwrap_or_default() {
        "hello" => receive::HELLO,
        "hello_reply" => receive::HELLO_REPLY,
        "control" => receive::CONTROL,
        "control_reply" => receive::CONTROL_REPLY,
        "credit" => receive::CREDIT,
        "announcement" => receive::ANNOUNCEMENT,
        _ => receive::ROLLOUT,
    }
}

/// Flips bits, and now and then cuts or lengthens.
fn mutated(bytes: &[u8], draws: &mut Pcg64) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    match draws.below(16) {
        0 => bytes.truncate(draws.below(bytes.len() + 1)),
        1 => bytes.extend((0..draws.below(64)).map(|i| i as u8)),
        _ => {}
    }
    for _ in 0..=draws.below(8) {
        if !bytes.is_empty() {
            let place = draws.below(bytes.len());
            bytes[place] ^= 1 << draws.below(8);
        }
    }
    bytes
}

fn genuine() -> Vec<(String, Vec<u8>)> {
    let path = format!("{}/../tests/data/wire_{PROTOCOL_VERSION}.txt", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(path).expect("the frozen messages are there");
    let byte = |pair: &[u8]| {
        let digit = |c: u8| char::from(c).to_digit(16).expect("hexadecimal") as u8;
        digit(pair[0]) << 4 | digit(pair[1])
    };
    let line = |line: &str| {
        let (kind, digits) = line.split_once(' ').expect("a kind and its bytes");
        (kind.to_owned(), digits.as_bytes().chunks_exact(2).map(byte).collect())
    };
    text.lines().filter(|line| !line.starts_with("header ")).map(line).collect()
}

fn main() -> ExitCode {
    let messages = genuine();
    let mut draws = Pcg64::seed_from_u64(7);
    let mut fates: BTreeMap<&'static str, u64> = BTreeMap::new();
    MEMORY.reset_peak_usage();
    let before = MEMORY.current_usage();
    for _ in 0..N_MESSAGES {
        let (kind, payload) = &messages[draws.below(messages.len())];
        let own = Header::plain(expected(kind).schema, Incarnation(11), payload);
        let payload = mutated(payload, &mut draws);
        let header = match draws.below(4) {
            0 | 1 => Header::plain(own.schema, Incarnation(11), &payload).to_bytes().to_vec(),
            2 => own.to_bytes().to_vec(),
            _ => mutated(&own.to_bytes(), &mut draws),
        };
        let fate =
            receive_as(kind, &header, &payload).map_or_else(|it| it.cause.name(), |()| "taken");
        *fates.entry(fate).or_default() += 1;
    }
    let grown = MEMORY.current_usage().saturating_sub(before);
    let peak = MEMORY.peak_usage().saturating_sub(before);
    println!("{N_MESSAGES} messages, no panic; at most {peak} bytes in use, {grown} left");
    for (fate, n) in &fates {
        println!("{n:9} {fate}");
    }
    if peak > MOST_BYTES || grown > 1 << 16 { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}
