//! What it costs to give one version of the weights to 1, 4, 16 and 64 clients: each from the learner, and each from its region's relay,
//! which pulls it from the learner once.
//!
//! Learner, relay and clients are three processes on one machine, over loopback. Prints how long it takes until all clients have a version
//! (the median), and how much processor time the learner spends on one, its announcement included (the mean). Beside two cores, the longer
//! times are mostly the clients' own.
//!
//! ```console
//! cargo bench -p leadtime-link --bench fanout
//! ```

#![expect(clippy::print_stdout, reason = "a bench prints what it found")]
#![expect(clippy::unwrap_used, reason = "what it shares with tests fails as they do")]

#[path = "../crates/link/tests/network/support.rs"]
#[expect(dead_code, reason = "only a part of it is needed here")]
mod support;

use std::env;
use std::io::{self, BufRead as _, BufReader, Lines, Write as _};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use leadtime_link::{
    ActorLink, ConnectSettings, LearnerEvent, LearnerLink, ListenSettings, RUNTIME_VARIABLE,
    RouterLink,
};
use leadtime_proto::message::HelloReply;
use leadtime_proto::{PolicyVersion, RegionName, hex};
use tokio::runtime::Runtime;
use tokio::task::JoinSet;

use crate::support::{
    DOMAIN, LearnerEvents, SOON, actor_id, hello, learner_start, run, start, welcome,
};

/// As many bytes as the notifier that guides pilots has.
const N_BYTES: usize = 86_000;
/// Versions that each number of clients pulls.
const N_VERSIONS: u32 = 100;
const N_CLIENTS: [u32; 4] = [1, 4, 16, 64];
const REGION: &str = "eu";
const ANY: &str = "tcp/127.0.0.1:0";
/// Ticks of the processor's clock in `/proc`, per second.
const TICKS: u64 = 100;
/// A client opens some 15 files, so 64 of them open more than a process may by default.
const RAISE: &str = "ulimit -n $(ulimit -Hn); exec \"$0\" \"$@\"";

fn main() {
    let arguments: Vec<String> = env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["learner"] => learner(),
        ["relay", at] => relay(at),
        ["measure"] => measure(),
        // Cargo's test runner asks every bench for its tests.
        _ if arguments.iter().any(|argument| argument == "--list") => {}
        _ => {
            let this = env::current_exe().unwrap();
            let status = Command::new("sh").args(["-c", RAISE]).arg(this).arg("measure").status();
            assert!(status.unwrap().success(), "see above");
        }
    }
}

/// Offers another version whenever it is asked to, and says which digest it has.
fn learner() {
    let runtime = Runtime::new().unwrap();
    let settings = ListenSettings::new(vec![ANY.parse().unwrap()]);
    let (name, own) = (run("one"), learner_start());
    let opened = runtime.block_on(LearnerLink::open(&name, DOMAIN, &own, &settings));
    let (learner, events) = opened.unwrap();
    println!("{}", learner.locators()[0]);
    runtime.spawn(welcome_all(events));
    for (line, version) in io::stdin().lines().zip(1..) {
        line.unwrap();
        // No two are alike: a relay knows weights by their digest.
        let mut weights: Vec<u8> = (0..N_BYTES).map(|i| (i ^ (i >> 8)) as u8).collect();
        weights[..8].copy_from_slice(&u64::to_le_bytes(version));
        learner.retire_weights(PolicyVersion(version));
        learner.offer_weights(PolicyVersion(version), weights.into()).unwrap();
        println!("{}", hex::encode(&learner.announcement().versions.last().unwrap().1));
    }
}

async fn welcome_all(events: LearnerEvents) {
    let answer = HelloReply::Welcome(Box::new(welcome("one")));
    while let Ok(event) = events.recv_async().await {
        if let LearnerEvent::Hello { reply, .. } = event {
            reply.reply(&answer).unwrap();
        }
    }
}

/// Pulls for its region, and says whenever it is asked how often it did, and how often it answered.
fn relay(learner: &str) {
    let runtime = Runtime::new().unwrap();
    let above = vec![learner.parse().unwrap()];
    let settings =
        ListenSettings { connect: above, ..ListenSettings::new(vec![ANY.parse().unwrap()]) };
    let router = runtime.block_on(async {
        let mut router = RouterLink::open(&settings).await.unwrap();
        router.relay_weights(&RegionName::new(REGION).unwrap()).unwrap();
        router
    });
    println!("{}", router.locators()[0]);
    for line in io::stdin().lines() {
        line.unwrap();
        let counts = router.relay_counts();
        println!("{} {}", counts.pulled, counts.answered);
    }
}

/// A process of this program, which answers each line with a line. It ends with this one.
struct Helper {
    child: Child,
    answers: Lines<BufReader<ChildStdout>>,
    /// Where it listens, which it says first.
    place: String,
}

impl Helper {
    fn start(arguments: &[&str]) -> Self {
        let mut command = Command::new(env::current_exe().unwrap());
        command.args(arguments).env(RUNTIME_VARIABLE, leadtime_link::runtime());
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let mut answers = BufReader::new(child.stdout.take().unwrap()).lines();
        let place = answers.next().expect("it says where it listens").unwrap();
        Self { child, answers, place }
    }

    fn ask(&mut self) -> String {
        writeln!(self.child.stdin.as_mut().unwrap()).unwrap();
        self.answers.next().expect("it answers").unwrap()
    }

    /// Returns how much processor time it has spent.
    fn cpu(&self) -> Duration {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.child.id())).unwrap();
        let (_, fields) = stat.rsplit_once(')').expect("the name of a process is in brackets");
        let ticks = fields.split_whitespace().skip(11).take(2);
        let n_ticks: u64 = ticks.map(|ticks| ticks.parse::<u64>().unwrap()).sum();
        Duration::from_millis(n_ticks * 1_000 / TICKS)
    }
}

impl Drop for Helper {
    fn drop(&mut self) {
        drop(self.child.kill());
        drop(self.child.wait());
    }
}

fn measure() {
    let runtime = Runtime::new().unwrap();
    let mut learner = Helper::start(&["learner"]);
    let mut relay = Helper::start(&["relay", &learner.place]);
    let mut version = 0;
    println!("weights of {N_BYTES} bytes, {N_VERSIONS} versions in each row");
    println!("from     clients  until all have it, ms     learner's CPU, ms");
    for region in [None, Some(REGION)] {
        let (from, at) = match region {
            None => ("learner", learner.place.clone()),
            Some(_) => ("relay", relay.place.clone()),
        };
        for n_clients in N_CLIENTS {
            let clients = runtime.block_on(open(&at, region, n_clients));
            let (mut times, before) = (Vec::new(), learner.cpu());
            for _ in 0..N_VERSIONS {
                version += 1;
                let sha256 = hex::decode(&learner.ask()).expect("a digest");
                let pulled = pull_all(&clients, PolicyVersion(version), sha256);
                times.push(runtime.block_on(pulled));
            }
            let cpu =
                learner.cpu().saturating_sub(before).as_secs_f64() * 1e3 / f64::from(N_VERSIONS);
            times.sort_unstable();
            let median = times[times.len() / 2].as_secs_f64() * 1e3;
            println!("{from:8} {n_clients:7} {median:22.2} {cpu:21.2}");
            runtime.block_on(close(clients));
        }
    }
    let n_pulled = N_VERSIONS * N_CLIENTS.len() as u32;
    let n_answered = N_VERSIONS * N_CLIENTS.iter().sum::<u32>();
    assert_eq!(relay.ask(), format!("{n_pulled} {n_answered}"), "each version was pulled once");
}

/// Opens clients at an address, each welcome in the run.
async fn open(at: &str, region: Option<&str>, n_clients: u32) -> Vec<Arc<ActorLink>> {
    let settings = ConnectSettings {
        timeout: SOON,
        region: region.map(|name| RegionName::new(name).unwrap()),
        ..ConnectSettings::new(vec![at.parse().unwrap()])
    };
    let mut clients = Vec::new();
    for i in 0..n_clients {
        let id = format!("{}-{n_clients}-{i}", region.unwrap_or("near"));
        let opened = ActorLink::open(&settings, &actor_id(&id), &start(&id)).await;
        let (client, _events) = opened.unwrap();
        client.hello(None, &hello(&id), SOON).await.unwrap();
        clients.push(Arc::new(client));
    }
    clients
}

/// Has all clients pull a version at once, and returns how long it took.
async fn pull_all(
    clients: &[Arc<ActorLink>],
    version: PolicyVersion,
    sha256: [u8; 32],
) -> Duration {
    let (mut pulls, started) = (JoinSet::new(), Instant::now());
    for client in clients {
        let client = Arc::clone(client);
        pulls.spawn(async move { client.pull_weights(version, sha256).await.unwrap().len() });
    }
    assert!(pulls.join_all().await.iter().all(|&n_bytes| n_bytes == N_BYTES));
    started.elapsed()
}

async fn close(clients: Vec<Arc<ActorLink>>) {
    for client in clients {
        client.close().await.unwrap();
    }
}
