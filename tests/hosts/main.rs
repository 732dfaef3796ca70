//! Five hosts made of network namespaces: a learner, a router, two actors and somebody who watches, encrypted; one actor behind
//! a slow line, the other cut off for five seconds on the way. The weights are those of a run on one host, in each mode that
//! promises it.
//!
//! It needs root and `ip` (iproute2), so it runs only if asked: `cargo test -p leadtime --test hosts -- --ignored`. It has no
//! harness, because this program is also the slow line, and what opens the page: processes of their own in hosts.

#![expect(clippy::print_stdout, reason = "it has no harness that says why it is skipped")]

mod namespaces;
mod relay;
#[expect(dead_code, reason = "the other process tests use the rest")]
#[path = "../processes/support.rs"]
mod support;

use std::env;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use namespaces::Hosts;
use serde_json::Value;
use support::{
    PATIENCE, Place, Running, get, result, signal, updates, wait_for_updates, wait_for_words,
    wait_until,
};

const RUN: &str = "learner -c cartpole --seed 5 --name r --set learner.n_steps=32 --set learner.total_steps=51200";
/// The modes that promise equal weights, and where the router listens meanwhile.
const MODES: [(&str, u16); 2] = [("sync", 7447), ("lag", 7457)];
/// Where the slow line begins.
const LINE: &str = "127.0.0.1:7448";
/// How long a byte takes on the slow line, in each direction.
const DELAY: Duration = Duration::from_millis(40);
/// How long an actor is cut off: longer than the lease, after which it counts as gone.
const CUT: Duration = Duration::from_secs(5);
/// The longest that the run on several hosts may take.
const HOSTS_PATIENCE: Duration = Duration::from_mins(4);

fn main() {
    let arguments: Vec<String> = env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["relay", listen, target] => relay::run(listen, target, DELAY),
        ["get", address, path] => {
            let (code, body) = get(address, path);
            assert_eq!(code, 200, "{body}");
            println!("{body}");
        }
        _ if arguments.iter().any(|it| it == "--ignored" || it == "--include-ignored") => {
            if let Err(reason) = namespaces::probe() {
                println!("skipped: no network namespaces can be made here: {reason}");
                return;
            }
            let hosts = Hosts::make(&["learner", "router", "near", "far", "page"]);
            let hosts = hosts.unwrap_or_else(|reason| panic!("{reason}"));
            the_weights_are_those_of_one_host(&hosts);
        }
        _ => println!("skipped: it makes network namespaces; as root, run it with `-- --ignored`"),
    }
}

fn the_weights_are_those_of_one_host(hosts: &Hosts) {
    for (mode, port) in MODES {
        let run = format!("{RUN} --set learner.mode={mode}");
        let (apart, together) = (on_several_hosts(hosts, &run, port), on_one_host(&run));
        assert_eq!(apart["weights_sha256"], together["weights_sha256"], "{mode}");
        assert_eq!(apart["books"]["balanced"], true, "{apart}");
        println!("{mode}: same weights on five hosts and on one: {}", together["weights_sha256"]);
    }
}

/// Trains with everybody on a host of their own, and returns the result.
fn on_several_hosts(hosts: &Hosts, run: &str, port: u16) -> Value {
    let place = Place::new();
    let certs = |arguments: &str| {
        place.finish(&["certs", arguments]).with_code(0);
    };
    certs("init pki");
    let router_host = hosts.address("router");
    certs(&format!(
        "issue pki router:r1@{router_host},127.0.0.1 learner:l1 actor:a1 actor:a2 observer:o1"
    ));

    let at = |host: &str, arguments: &[&str]| {
        place.start_with(Hosts::program(host, &place.program(arguments)))
    };
    let listen = format!("router --listen tls/0.0.0.0:{port} --acl pki/acl.json5 --tls pki/r1");
    let router = at("router", &[&listen]);
    wait_for_words(&router, "router listens");
    let there = format!("tls/{router_host}:{port}");
    let mut learner =
        at("learner", &[run, "--set run.actors_min=2 --tls pki/l1 --connect", &there]);
    let near = at("near", &["actor --json --tls pki/a1 --connect", &there]);
    let line = Hosts::relay("far", LINE, &format!("{router_host}:{port}"));
    let far = at("far", &["actor --json --tls pki/a2 --connect", &format!("tls/{LINE}")]);

    let directory = place.run("r");
    wait_for_updates(&directory, 5);
    let look = at("page", &["watch --once --json --tls pki/o1 --connect", &there]);
    look_at(&look.finish(PATIENCE).with_code(0).json());
    let page = "watch --http 127.0.0.1:0 --play off --json --tls pki/o1 --connect";
    let watcher = at("page", &[page, &there]);
    open_page(&watcher);
    cut_off(&directory, &mut learner);

    let finished = learner.finish(HOSTS_PATIENCE).with_code(0);
    for actor in [near, far] {
        let journal = actor.finish(PATIENCE).with_code(0).json();
        println!("{journal}");
    }
    assert!(finished.stdout.contains("weights"), "{}", finished.stdout);
    drop(line);
    signal("TERM", watcher.id());
    watcher.finish(PATIENCE).with_code(130);
    signal("TERM", router.id());
    router.finish(PATIENCE).with_code(0);
    result(&directory)
}

/// Asserts that this is a run at work.
fn look_at(seen: &Value) {
    assert_eq!(seen["state"]["state"], "training", "{seen}");
    assert_eq!(seen["about"]["domain"], "cartpole", "{seen}");
    assert!(seen["actors"].as_array().is_some_and(|actors| !actors.is_empty()), "{seen}");
    println!("seen from a host of its own: update {}", seen["state"]["update"]);
}

/// Opens the page that is served in a host, from there.
fn open_page(watcher: &Running) {
    wait_until("the page is served", PATIENCE, || watcher.stdout().ends_with('\n'));
    let said: Value = serde_json::from_str(&watcher.stdout()).expect("it says where");
    let link = said["page"].as_str().expect("a link");
    let address = link.trim_start_matches("http://").trim_end_matches('/');
    let page = Hosts::get("page", address, "/");
    assert!(page.contains("<title>Leadtime</title>"), "{page}");
    let mut seen = Value::Null;
    wait_until("the page shows the run at work", PATIENCE, || {
        let state = Hosts::get("page", address, "/state.json");
        seen = serde_json::from_str(&state).unwrap_or_else(|error| panic!("{error}: {state}"));
        let is_known = seen["about"]["domain"].is_string();
        let is_training = seen["state"]["state"] == "training";
        is_known && is_training && seen["actors"].as_array().is_some_and(|it| !it.is_empty())
    });
    look_at(&seen);
}

/// Cuts off an actor for a while, and waits until it is back.
fn cut_off(run: &Path, learner: &mut Running) {
    let before = updates(run);
    let started = Instant::now();
    Hosts::cut("near");
    wait_for_words(learner, "actor left: a1");
    thread::sleep(CUT.saturating_sub(started.elapsed()));
    let during = updates(run);
    assert!(learner.is_running(), "the run is over before the line is back: {}", learner.stderr());
    Hosts::mend("near");
    let mended = Instant::now();
    wait_until("the actor that was cut off is back", PATIENCE, || {
        learner.n_said("actor joined: a1") >= 2
    });
    println!(
        "updates {before} when cut, {during} when mended, the actor back {:?} later",
        mended.elapsed()
    );
}

/// Trains with everybody on one host, and returns the result.
fn on_one_host(run: &str) -> Value {
    let alone = Place::new();
    let endpoint = alone.endpoint("z");
    let learner = alone.start(&[run, "--listen", &endpoint]);
    let actor = alone.start(&["actor --connect", &endpoint]);
    learner.finish(PATIENCE).with_code(0);
    actor.finish(PATIENCE).with_code(0);
    result(&alone.run("r"))
}
