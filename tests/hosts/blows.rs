//! A training on five hosts, encrypted, one of them behind a slow line, and another one struck in every way in which a host can go
//! without a word. The weights are those of a run in peace on one host, in each mode that promises it.

use std::path::Path;
use std::time::{Duration, Instant};

use serde_json::Value;

use super::namespaces::Hosts;
use super::support::{
    PATIENCE, Place, Running, signal, updates, wait_for_updates, wait_for_words, wait_until,
};

/// More updates than are made: the run is ended once the last blow is over.
const RUN: &str = "learner -c cartpole --seed 5 --name r --json --set learner.n_steps=32 --set learner.total_steps=5120000";
/// Where the router listens.
const PORT: u16 = 7447;
/// Where the slow line begins.
const LINE: &str = "127.0.0.1:7448";
/// How long a byte takes on the slow line, in each direction.
pub(crate) const DELAY: Duration = Duration::from_millis(40);
/// Updates that the others must make while a host is away, and all of them before and after.
const SOME: u64 = 5;
/// The actors of the host that is struck.
const STRUCK: [&str; 2] = ["a1", "a3"];

/// What happens to a host, how it begins and how it ends.
type Blow = (&'static str, fn(&Hosts), fn(&Hosts));

const BLOWS: [Blow; 4] = [
    ("its cable is pulled out", |_| Hosts::cut("near"), |_| Hosts::mend("near")),
    (
        "nothing that it sends arrives",
        |hosts| hosts.lose("near", "router"),
        |hosts| hosts.deliver("near", "router"),
    ),
    (
        "nothing that is sent to it arrives",
        |hosts| hosts.lose("router", "near"),
        |hosts| hosts.deliver("router", "near"),
    ),
    ("it stands still", |_| stand_still("STOP"), |_| stand_still("CONT")),
];

/// Stops every process of the host, or lets them go on.
fn stand_still(name: &str) {
    let processes = Hosts::processes("near");
    assert_eq!(processes.len(), STRUCK.len(), "each actor is a process there");
    for id in processes {
        signal(name, id);
    }
}

pub(crate) fn the_weights_are_those_of_a_run_in_peace(hosts: &Hosts, mode: &str) {
    let run = format!("{RUN} --set learner.mode={mode}");
    let apart = on_several_hosts(hosts, &run);
    assert_eq!(apart["books"]["balanced"], true, "{apart}");
    let together = on_one_host(&run, &apart["updates"]);
    assert_eq!(apart["updates"], together["updates"]);
    assert_eq!(apart["weights_sha256"], together["weights_sha256"], "{mode}");
    println!(
        "{mode}: same weights after {} updates on five hosts and on one: {}",
        together["updates"], together["weights_sha256"]
    );
}

/// Trains with everybody on a host of their own until all blows are over, and returns how that ended.
fn on_several_hosts(hosts: &Hosts, run: &str) -> Value {
    let place = Place::new();
    let certs = |arguments: &str| {
        place.finish(&["certs", arguments]).with_code(0);
    };
    certs("init pki");
    let router_host = hosts.address("router");
    certs(&format!(
        "issue pki router:r1@{router_host},127.0.0.1 learner:l1 actor:a1 actor:a2 actor:a3 observer:o1"
    ));

    let at = |host: &str, arguments: &[&str]| {
        place.start_with(Hosts::program(host, &place.program(arguments)))
    };
    let listen = format!("router --listen tls/0.0.0.0:{PORT} --acl pki/acl.json5 --tls pki/r1");
    let router = at("router", &[&listen]);
    wait_for_words(&router, "router listens");
    let there = format!("tls/{router_host}:{PORT}");
    let mut learner =
        at("learner", &[run, "--set run.actors_min=3 --tls pki/l1 --connect", &there]);
    let actor = |id: &str, host: &str, address: &str| {
        at(host, &["actor --json --tls", &format!("pki/{id}"), "--connect", address])
    };
    let line = Hosts::relay("far", LINE, &format!("{router_host}:{PORT}"));
    let far = actor("a2", "far", &format!("tls/{LINE}"));
    let [near, other] = STRUCK.map(|id| actor(id, "near", &there));

    let directory = place.run("r");
    wait_for_updates(&directory, SOME);
    let look = at("page", &["watch --once --json --tls pki/o1 --connect", &there]);
    let seen = look.finish(PATIENCE).with_code(0).json();
    assert_eq!(seen["state"]["state"], "training", "{seen}");
    assert_eq!(seen["about"]["domain"], "cartpole", "{seen}");
    for blow in BLOWS {
        strike(hosts, &directory, &mut learner, blow);
    }

    signal("USR1", learner.id());
    let ended = learner.finish(PATIENCE).with_code(0).json();
    for actor in [near, other, far] {
        let journal = actor.finish(PATIENCE).with_code(0).json();
        println!("{journal}");
    }
    drop(line);
    signal("TERM", router.id());
    router.finish(PATIENCE).with_code(0);
    ended
}

/// Has something happen to a host until it is named as gone and the others go on without it, and waits until it is back.
fn strike(hosts: &Hosts, run: &Path, learner: &mut Running, (what, begin, end): Blow) {
    let left = STRUCK.map(|id| format!("actor left: {id},"));
    let joined = STRUCK.map(|id| format!("actor joined: {id} "));
    let count = |learner: &Running| {
        [&left, &joined].map(|lines| lines.each_ref().map(|line| learner.n_said(line)))
    };
    let [n_left, n_joined] = count(learner);
    let started = Instant::now();
    begin(hosts);
    wait_until(&format!("{what}: it is gone"), PATIENCE, || {
        count(learner)[0].iter().zip(n_left).all(|(now, before)| *now > before)
    });
    let (gone, before) = (started.elapsed(), updates(run));
    wait_for_updates(run, before + SOME);
    assert_eq!(count(learner)[1], n_joined, "{what}: who is away is not let in");
    end(hosts);
    let ended = Instant::now();
    wait_until(&format!("{what}: it is back"), PATIENCE, || {
        count(learner)[1].iter().zip(n_joined).all(|(now, before)| *now > before)
    });
    let back = ended.elapsed();
    let now = updates(run);
    wait_for_updates(run, now + SOME);
    assert!(learner.is_running(), "{}", learner.stderr());
    println!("{what}: gone after {gone:.1?}, back after {back:.1?}; updates {before} to {now}");
}

/// Trains with everybody on one host for so many updates, and returns how that ended.
fn on_one_host(run: &str, n_updates: &Value) -> Value {
    let alone = Place::new();
    let endpoint = alone.endpoint("z");
    let learner =
        alone.start(&[run, "--listen", &endpoint, "--stop-after", &n_updates.to_string()]);
    let actor = alone.start(&["actor --connect", &endpoint]);
    let ended = learner.finish(PATIENCE).with_code(0).json();
    actor.finish(PATIENCE).with_code(0);
    ended
}
