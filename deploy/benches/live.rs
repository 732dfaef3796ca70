//! A notifier at work under load: 16 clients at 50 observations a second, and the same beside a client that sends junk as fast as it
//! can.
//!
//! The notifier is a process of its own. Its part, from an observation's arrival to the end of what is said about it, is what
//! its status tells; the round trip is measured here, in a second process, over loopback. Ends with 1 if a limit is not kept.
//!
//! ```console
//! cargo bench -p leadtime --bench live
//! ```

#![expect(clippy::print_stdout, reason = "a bench prints what it found")]

use std::io::{BufRead as _, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use leadtime_link::ConnectSettings;
use leadtime_link::live::{ClientPort, LiveClientLink};
use leadtime_proto::{ClientName, Incarnation, ServiceName};
use leadtime_serve::{ClientSettings, LatencyHistogram, LiveClient, SayForm, StepClock};
use serde_json::Value;
use tokio::runtime::Runtime;

const N_CLIENTS: usize = 16;
/// Pause between two observations of a client.
const EVERY: Duration = Duration::from_millis(20);
const WARM_UP: Duration = Duration::from_secs(1);
const MEASURED: Duration = Duration::from_secs(10);
/// The longest that 99 % may take, in microseconds: the notifier's part, the round trip, the round trip beside junk.
const LIMITS_US: [f64; 3] = [200.0, 1_000.0, 2_000.0];
const PATIENCE: Duration = Duration::from_secs(10);

fn main() {
    // Cargo's test runner asks every bench for its tests.
    if std::env::args().any(|argument| argument == "--list") {
        return;
    }
    let (mut notifier, endpoint) = serve();
    let runtime = Runtime::new().expect("a runtime starts");
    let mut clients: Vec<LiveClient> =
        (0..N_CLIENTS).map(|i| open(&runtime, &endpoint, &format!("client-{i}"))).collect();
    load(&mut clients, WARM_UP);
    let quiet = load(&mut clients, MEASURED);
    let part = notifiers_part(&mut clients);
    let before = memory(&notifier);
    let junk = Junk::start(&runtime, &endpoint);
    let beside = load(&mut clients, MEASURED);
    let n_junk = junk.stop();
    let grown = memory(&notifier).saturating_sub(before);
    drop(notifier.kill());
    drop(notifier.wait());
    let [p50, p99, max] = [0.5, 0.99, 1.0].map(|share| quiet.quantile_us(share));
    println!("{N_CLIENTS} clients, {} steps", quiet.n());
    println!("notifier's part      p99 {part:7.0} us (worst client)");
    println!("round trip           p50 {p50:7.0} us, p99 {p99:7.0} us, max {max:7.0} us");
    let rate = n_junk as f64 / MEASURED.as_secs_f64();
    let [b50, b99, bmax] = [0.5, 0.99, 1.0].map(|share| beside.quantile_us(share));
    println!("beside {rate:.0} junk messages a second, memory grown by {grown} kB:");
    println!("round trip           p50 {b50:7.0} us, p99 {b99:7.0} us, max {bmax:7.0} us");
    let is_kept = [part, p99, b99].iter().zip(LIMITS_US).all(|(found, limit)| *found < limit);
    println!("limits {LIMITS_US:?} us at 99 %: {}", if is_kept { "kept" } else { "NOT kept" });
    assert!(is_kept, "a limit is not kept");
}

/// Starts a notifier and returns where it listens.
fn serve() -> (Child, String) {
    let policy = concat!(env!("CARGO_MANIFEST_DIR"), "/policies/piloting.safetensors");
    let mut command = Command::new(env!("CARGO_BIN_EXE_leadtime"));
    command.args(["serve", policy, "--listen", "tcp/127.0.0.1:0"]).stderr(Stdio::piped());
    let mut notifier = command.spawn().expect("the program starts");
    let log = BufReader::new(notifier.stderr.take().expect("its log is piped"));
    let mut lines = log.lines().map_while(Result::ok);
    let at_work = lines.find(|line| line.contains("is at work at ")).expect("it goes to work");
    let endpoint = at_work.rsplit(' ').next().expect("it says where").to_owned();
    // Whatever else it logs is read, so that it never waits for a reader.
    std::thread::Builder::new().spawn(move || lines.for_each(drop)).expect("a thread starts");
    (notifier, endpoint)
}

fn open(runtime: &Runtime, endpoint: &str, name: &str) -> LiveClient {
    let settings = ConnectSettings::new(vec![endpoint.parse().expect("an address")]);
    let asked = ClientSettings {
        service: ServiceName::new("notifier").expect("a name"),
        client: ClientName::new(name).expect("a name"),
        incarnation: Incarnation(1),
        domain: "lander".to_owned(),
        obs_dim: None,
        clock: StepClock::Observation,
        seconds_per_step: 0.3,
        seed: 1,
        form: SayForm::Json,
    };
    runtime.block_on(async {
        let link = LiveClientLink::open(&settings).await.expect("the notifier is there");
        LiveClient::open(&link, asked).await.expect("a session is opened")
    })
}

/// Lets every client step every 20 ms, one after the other, and returns the round trips.
fn load(clients: &mut [LiveClient], time: Duration) -> LatencyHistogram {
    let mut times = LatencyHistogram::default();
    let (started, pause) = (Instant::now(), EVERY / clients.len() as u32);
    let mut i = 0_u32;
    while started.elapsed() < time {
        let due = started + pause * i;
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        let n_clients = clients.len();
        let client = &mut clients[i as usize % n_clients];
        let height = 1.4 - (i as f32 / 10_000.0) % 1.4;
        let sent = Instant::now();
        let values = [0.1, height, 0.0, -0.2, 0.0, 0.0, 0.0, 0.0];
        client.step(&values, 0, PATIENCE).expect("every observation is answered");
        times.record(sent.elapsed().as_nanos() as u64);
        i += 1;
    }
    times
}

/// Returns what 99 % of the notifier's steps do not exceed, of the slowest client, in microseconds.
fn notifiers_part(clients: &mut [LiveClient]) -> f64 {
    std::thread::sleep(Duration::from_millis(1_200));
    let p99 = |client: &mut LiveClient| {
        while client.next(Duration::from_millis(1)).expect("the notifier is there").is_some() {}
        let status: Value = serde_json::from_str(client.status()).expect("a status was told");
        status["latency_us"]["p99"].as_f64().expect("a number")
    };
    clients.iter_mut().map(p99).fold(0.0, f64::max)
}

/// Returns the memory of the notifier, in kB.
fn memory(notifier: &Child) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{}/status", notifier.id()));
    let status = status.unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    line.and_then(|line| line.trim().split(' ').next()?.parse().ok()).unwrap_or(0)
}

/// A client that sends what nobody can use.
struct Junk {
    stop: Arc<AtomicBool>,
    n: Arc<AtomicU64>,
    thread: std::thread::JoinHandle<()>,
}

impl Junk {
    fn start(runtime: &Runtime, endpoint: &str) -> Self {
        let settings = ConnectSettings::new(vec![endpoint.parse().expect("an address")]);
        let (service, client) = (
            ServiceName::new("notifier").expect("a name"),
            ClientName::new("junk").expect("a name"),
        );
        let port: ClientPort = runtime.block_on(async {
            let link = LiveClientLink::open(&settings).await.expect("the notifier is there");
            let port = link.port(&service, &client, Incarnation(2)).expect("a place");
            let question = br#"{"protocol":1,"domain":"lander","incarnation":"0000000000000002"}"#;
            port.ask(question.to_vec()).await.expect("a session is opened");
            port
        });
        let (stop, n) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
        let (stopped, count) = (Arc::clone(&stop), Arc::clone(&n));
        let work = move || {
            while !stopped.load(Ordering::Relaxed) {
                for _ in 0..200 {
                    port.observe(b"{\"seq\":1,\"t\":0,\"obs\":[1,2,3]}")
                        .expect("the network is there");
                }
                count.fetch_add(200, Ordering::Relaxed);
                // 200,000 a second.
                std::thread::sleep(Duration::from_micros(900));
            }
        };
        let thread = std::thread::Builder::new().name("junk".to_owned()).spawn(work);
        Self { stop, n, thread: thread.expect("a thread starts") }
    }

    fn stop(self) -> u64 {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().expect("it ends");
        self.n.load(Ordering::Relaxed)
    }
}
