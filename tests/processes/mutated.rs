//! Genuine messages of a run, changed and sent again by a member that hears everything: bits flipped, cut, lengthened, spliced, with
//! the old proof or with one of the stranger's own. `bench/attacks.py mutate` sends a million of them, of every kind.

use std::fs;

use leadtime_link::live::LiveClientLink;
use leadtime_link::{ActorEvent, ActorLink, ConnectSettings, Endpoint, Events};
use leadtime_numerics::Pcg64;
use leadtime_proto::{Header, Sequence};
use serde_json::Value;
use tokio::runtime::{Builder, Runtime};

use crate::resilience::{LONG, end_as_undisturbed, learner_below, router};
use crate::support::{PATIENCE, Place, Running, SOON, fake_actor, wait_for_updates};

const N_MESSAGES: usize = 10_000;
/// One message in so many is a rollout under a proof that holds.
const PROVED_EVERY: usize = 20;
/// Megabytes by which the strangers' messages may make a process grow: what wait to be read share 256 MB.
const MOST_GROWTH: u64 = 64;
/// What others can hear in a run, and the bytes of the proof behind it.
const HEARD: [(&str, usize); 5] = [
    ("leadtime/1/r/traj/cartpole/a", 64),
    ("leadtime/1/r/credit/a", 64),
    ("leadtime/1/r/weights/cartpole", 96),
    ("leadtime/1/r/metrics/actor/a", 0),
    ("leadtime/1/r/metrics/learner/learner", 0),
];

struct Heard {
    key: &'static str,
    head: Vec<u8>,
    body: Vec<u8>,
    proof: Vec<u8>,
}

fn heard(stranger: &LiveClientLink, (key, n_proof_bytes): (&'static str, usize)) -> Heard {
    let taken = stranger.take_at(key).unwrap();
    let (mut body, head) = taken.next(SOON).unwrap_or_else(|| panic!("nothing at {key}"));
    let proof = body.split_off(body.len() - n_proof_bytes);
    Heard { key, head: head.expect("every message has a header"), body, proof }
}

/// Changes bytes in one of four ways.
fn changed(bytes: &[u8], other: &[u8], draws: &mut Pcg64) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    let at = draws.below(bytes.len() + 1);
    match draws.below(8) {
        0 => bytes.truncate(at),
        1 => bytes.extend((0..draws.below(64)).map(|i| i as u8)),
        2 => drop(bytes.splice(at.., other[draws.below(other.len())..].iter().copied())),
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

/// A start of the stranger's own that the learner has made welcome. It answers no order, so it gets no environments.
struct Mole {
    link: ActorLink,
    _events: Events<ActorEvent>,
    start: Header,
    n_left: u64,
}

impl Mole {
    fn enter(runtime: &Runtime, endpoint: &Endpoint, number: usize, rollout: &[u8]) -> Self {
        let (link, events, hello) =
            runtime.block_on(fake_actor(endpoint, &format!("mole-{number}")));
        let start = Header {
            incarnation: hello.incarnation,
            sequence: Sequence(0),
            ..Header::from_bytes(rollout).unwrap()
        };
        let welcome = runtime.block_on(link.hello(None, &hello, SOON)).unwrap();
        Self { link, _events: events, start, n_left: u64::from(welcome.window) }
    }

    fn send(&mut self, body: Vec<u8>) {
        self.start.sequence = self.start.sequence.next();
        self.n_left -= 1;
        self.link.publish_rollout(&mended(self.start, &body), body.into()).unwrap();
    }
}

/// Returns the header with the checksum of this body.
fn mended(head: Header, body: &[u8]) -> Header {
    Header { checksum: Header::plain(head.schema, head.incarnation, body).checksum, ..head }
}

/// Sends changed messages, the same ones every time as far as those that were heard are.
fn attack(endpoint: &Endpoint) {
    let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let settings =
        ConnectSettings { timeout: SOON, ..ConnectSettings::new(vec![endpoint.clone()]) };
    let stranger = runtime.block_on(LiveClientLink::open(&settings)).unwrap();
    let all = HEARD.map(|place| heard(&stranger, place));
    let mut draws = Pcg64::seed_from_u64(7);
    let mut mole = Mole::enter(&runtime, endpoint, 0, &all[0].head);
    for number in 0..N_MESSAGES {
        let (other, draws) = (&all[draws.below(all.len())].body, &mut draws);
        if number % PROVED_EVERY == 0 {
            if mole.n_left == 0 {
                runtime.block_on(mole.link.close()).unwrap();
                mole = Mole::enter(&runtime, endpoint, number, &all[0].head);
            }
            mole.send(changed(&all[0].body, other, draws));
            continue;
        }
        let Heard { key, head, body, proof } = &all[draws.below(all.len())];
        let (mut head, mut body) = (head.clone(), body.clone());
        match draws.below(4) {
            0 => body = [body.as_slice(), proof].concat(),
            1 => head = changed(&head, other, draws),
            _ => {
                body = changed(&body, other, draws);
                head = mended(Header::from_bytes(&head).unwrap(), &body).to_bytes().to_vec();
                body.extend_from_slice(proof);
            }
        }
        let body = changed(&body, other, draws);
        stranger.put_at(key, &body, Some(&head)).unwrap();
    }
    runtime.block_on(mole.link.close()).unwrap();
}

fn megabytes(process: &Running) -> u64 {
    let status = fs::read_to_string(format!("/proc/{}/status", process.id())).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    line.trim().split(' ').next().unwrap().parse::<u64>().unwrap() / 1024
}

#[test]
fn ten_thousand_changed_copies_of_genuine_messages_harm_nobody() {
    let place = Place::new();
    let endpoint = place.endpoint("router");
    let router = router(&place);
    let learner = learner_below(&endpoint, &place, LONG);
    let actors = ["a", "b"].map(|id| place.start(&["actor --connect", &endpoint, "--id", id]));
    wait_for_updates(&place.run("r"), 5);
    let all = || [&router, &learner].into_iter().chain(&actors);
    let before: Vec<u64> = all().map(megabytes).collect();

    attack(&endpoint.parse().unwrap());
    for (process, before) in all().zip(before) {
        assert!(!process.stderr().contains("panicked"), "{}", process.stderr());
        let after = megabytes(process);
        assert!(after < before + MOST_GROWTH, "from {before} MB to {after} MB");
    }
    end_as_undisturbed(learner);
    for actor in actors {
        actor.finish(PATIENCE).with_code(0);
    }
    let journal = fs::read_to_string(place.run("r").join("metrics.jsonl")).unwrap();
    let last: Value = serde_json::from_str(journal.lines().last().unwrap()).unwrap();
    let count = |cause: &str| last["refusals"][cause].as_u64().unwrap_or(0);
    // What does not prove its sender is charged to nobody; what follows the proof has been reached as well. Those that were cut off are
    // the stranger's own: an actor that is cut off does not end with 0.
    assert!(count("proof") > 500 && count("malformed") > 50, "{}", last["refusals"]);
}
