//! What the tests of a notifier at work share: its policy, its start, and a client's way to it.

use leadtime_link::ConnectSettings;
use leadtime_link::live::{ClientPort, LiveClientLink};
use leadtime_proto::{ClientName, Incarnation, ServiceName};
use serde_json::{Value, json};
use tokio::runtime::{Builder, Runtime};

use crate::support::{PATIENCE, Place, Running, repository, wait_for_words};

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
pub(crate) fn question(parts: &[&Value]) -> Vec<u8> {
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
pub(crate) async fn port(link: &LiveClientLink, client: &str, start: Incarnation) -> ClientPort {
    let service = ServiceName::new("notifier").unwrap();
    link.find(&service).await.unwrap();
    link.port(&service, &ClientName::new(client).unwrap(), start).unwrap()
}
