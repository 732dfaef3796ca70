//! What the tests of a notifier at work share: its policy, its start, and a client.

use std::time::{Duration, Instant};

use leadtime_link::live::{ClientPort, LiveClientLink, LiveMessage};
use leadtime_link::{ConnectSettings, Error as LinkError};
use leadtime_proto::{ClientName, Incarnation, ServiceName};
use leadtime_serve::HeardSay;
use leadtime_serve::observation::{ObservationHead, write_json};
use serde_json::{Value, json};
use tokio::runtime::{Builder, Runtime};

use crate::support::{PATIENCE, Place, Running, repository, wait_for_words};

/// How long a step takes, in seconds, where nothing depends on it.
pub(crate) const STEP: f64 = 0.05;

/// Returns the file of the policy that is put to work.
pub(crate) fn policy() -> String {
    repository("deploy/policies/piloting.safetensors")
}

/// Starts a notifier with further options and waits until it is at work.
pub(crate) fn serve(place: &Place, more: &str) -> Running {
    let notifier = place.start(&["serve", &policy(), "--listen", &place.endpoint("n"), more]);
    wait_for_words(&notifier, "is at work");
    notifier
}

/// Returns what a lander sees that comes down beside the pad.
pub(crate) fn coming_down(step: f32) -> [f32; 8] {
    let y = (1.4 - step / 400.0).max(0.0);
    [0.4 * (step / 15.0).sin(), y, 0.0, -0.2, 0.0, 0.0, 0.0, 0.0]
}

/// Asks for a session, with these keys; a later part counts more.
fn question(parts: &[&Value]) -> Vec<u8> {
    let mut question = json!({"protocol": 1, "domain": "lander"});
    for (key, value) in parts.iter().flat_map(|part| part.as_object().unwrap()) {
        question[key] = value.clone();
    }
    question.to_string().into_bytes()
}

/// Connects to where the notifier listens.
pub(crate) fn link(place: &Place) -> (Runtime, LiveClientLink) {
    let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let endpoint = place.endpoint("n").parse().unwrap();
    let settings = ConnectSettings { timeout: PATIENCE, ..ConnectSettings::new(vec![endpoint]) };
    let link = runtime.block_on(LiveClientLink::open(&settings)).unwrap();
    (runtime, link)
}

/// Finds the notifier and takes a client's place at it.
async fn port(link: &LiveClientLink, client: &str, start: Incarnation) -> ClientPort {
    let service = ServiceName::new("notifier").unwrap();
    link.find(&service).await.unwrap();
    link.port(&service, &ClientName::new(client).unwrap(), start).unwrap()
}

/// A client that does what a test wants.
pub(crate) struct Client {
    runtime: Runtime,
    pub(crate) link: LiveClientLink,
    pub(crate) port: ClientPort,
    /// What it asks for with every question.
    pub(crate) own: Value,
    pub(crate) began: Instant,
    pub(crate) seq: u64,
    /// What was sent under a number, and when.
    pub(crate) sent: Vec<(u64, Instant)>,
    pub(crate) says: Vec<(Instant, HeardSay)>,
    /// The same as it was written, where that is JSON.
    pub(crate) written: Vec<Value>,
    pub(crate) statuses: Vec<Value>,
}

impl Client {
    pub(crate) fn connect(place: &Place, name: &str, start: u64) -> Self {
        let (runtime, link) = link(place);
        let start = Incarnation(start);
        let port = runtime.block_on(port(&link, name, start));
        Self {
            runtime,
            link,
            port,
            own: json!({"seconds_per_step": STEP, "incarnation": start.hex()}),
            began: Instant::now(),
            seq: 0,
            sent: Vec::new(),
            says: Vec::new(),
            written: Vec::new(),
            statuses: Vec::new(),
        }
    }

    /// Asks for a session; returns the answer, or the sentence that says no.
    pub(crate) fn open(&self, more: &Value) -> Result<Value, String> {
        match self.runtime.block_on(self.port.ask(question(&[&self.own, more]))) {
            Ok(answer) => Ok(serde_json::from_slice(&answer).unwrap()),
            Err(LinkError::Rejected { reason, .. }) => Err(reason),
            Err(error) => panic!("{error}"),
        }
    }

    pub(crate) fn head(&mut self) -> ObservationHead {
        self.seq += 1;
        self.sent.push((self.seq, Instant::now()));
        let t = self.began.elapsed().as_secs_f64();
        ObservationHead { seq: self.seq, t, episode: 0, end: false }
    }

    /// Sends what a lander sees.
    pub(crate) fn observe(&mut self) {
        self.put(false);
    }

    /// Sends what a lander sees, at the end of an episode or before it.
    pub(crate) fn put(&mut self, end: bool) {
        let values = coming_down(self.seq as f32);
        let head = ObservationHead { end, ..self.head() };
        self.port.observe(&write_json(&head, &values)).unwrap();
    }

    /// Takes what is told for a while.
    pub(crate) fn listen(&mut self, time: Duration) {
        let deadline = Instant::now() + time;
        while let Some(message) = self.port.next(deadline.saturating_duration_since(Instant::now()))
        {
            match message {
                LiveMessage::Say(bytes) => {
                    self.says.push((Instant::now(), HeardSay::read(&bytes).expect("an event")));
                    self.written.extend(serde_json::from_slice::<Value>(&bytes).ok());
                }
                LiveMessage::Status(bytes) => {
                    self.statuses.push(serde_json::from_slice(&bytes).expect("a status"));
                }
                LiveMessage::ServiceHere(_) | LiveMessage::ServiceGone(_) => {}
            }
        }
    }

    /// Does something again and again until something holds.
    #[track_caller]
    pub(crate) fn act_until(
        &mut self,
        what: &str,
        holds: impl Fn(&Self) -> bool,
        mut act: impl FnMut(&mut Self),
    ) {
        let deadline = Instant::now() + PATIENCE;
        while !holds(self) {
            let last = self.statuses.last();
            assert!(Instant::now() < deadline, "in vain: {what}; the last status: {last:?}");
            act(self);
        }
    }
}
