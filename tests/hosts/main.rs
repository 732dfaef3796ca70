//! Five hosts made of network namespaces: a learner, a router, two actors and somebody who watches, encrypted; one actor behind
//! a slow line, the other cut off for five seconds on the way. The weights are those of a run on one host.
//!
//! It needs root and `ip` (iproute2), so it runs only if asked: `cargo test -p leadtime --test hosts -- --ignored`. It has no
//! harness, because this program is also the slow line: a process of its own in the host of an actor.

#![expect(clippy::print_stdout, reason = "it has no harness that says why it is skipped")]

mod namespaces;
mod relay;
#[expect(dead_code, reason = "the other process tests use the rest")]
#[path = "../processes/support.rs"]
mod support;

use std::env;
use std::thread;
use std::time::{Duration, Instant};

use namespaces::Hosts;
use support::{PATIENCE, Place, result, signal, updates, wait_for_updates, wait_for_words};

const RUN: &str = "learner -c cartpole --seed 5 --name r --set learner.n_steps=32 --set learner.total_steps=51200";
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
        _ if arguments.iter().any(|it| it == "--ignored" || it == "--include-ignored") => {
            the_weights_are_those_of_one_host();
        }
        _ => println!("skipped: it makes network namespaces; as root, run it with `-- --ignored`"),
    }
}

fn the_weights_are_those_of_one_host() {
    let hosts = Hosts::make(&["learner", "router", "near", "far", "page"]);
    let hosts =
        hosts.unwrap_or_else(|reason| panic!("no network namespaces can be made here: {reason}"));
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
    let router =
        at("router", &["router --listen tls/0.0.0.0:7447 --acl pki/acl.json5 --tls pki/r1"]);
    wait_for_words(&router, "router listens");
    let there = format!("tls/{router_host}:7447");
    let mut learner =
        at("learner", &[RUN, "--set run.actors_min=2 --tls pki/l1 --connect", &there]);
    let near = at("near", &["actor --json --tls pki/a1 --connect", &there]);
    let line = Hosts::relay("far", "127.0.0.1:7448", &format!("{router_host}:7447"));
    let far = at("far", &["actor --json --tls pki/a2 --connect tls/127.0.0.1:7448"]);

    let run = place.run("r");
    wait_for_updates(&run, 5);
    let look = at("page", &["watch --once --json --tls pki/o1 --connect", &there]);
    let seen = look.finish(PATIENCE).with_code(0).json();
    assert_eq!(seen["state"]["state"], "training", "{seen}");
    assert_eq!(seen["about"]["domain"], "cartpole", "{seen}");
    assert!(seen["actors"].as_array().is_some_and(|actors| !actors.is_empty()), "{seen}");
    println!("seen from a host of its own: update {}", seen["state"]["update"]);
    let before = updates(&run);
    let started = Instant::now();
    Hosts::cut("near");
    wait_for_words(&learner, "actor left: a1");
    thread::sleep(CUT.saturating_sub(started.elapsed()));
    let during = updates(&run);
    assert!(learner.is_running(), "the run is over before the line is back: {}", learner.stderr());
    Hosts::mend("near");
    let mended = Instant::now();
    support::wait_until("the actor that was cut off is back", PATIENCE, || {
        learner.stderr().matches("actor joined: a1").count() >= 2
    });
    println!(
        "updates {before} when cut, {during} when mended, the actor back {:?} later",
        mended.elapsed()
    );
    let finished = learner.finish(HOSTS_PATIENCE).with_code(0);
    for actor in [near, far] {
        let journal = actor.finish(PATIENCE).with_code(0).json();
        println!("{journal}");
    }
    assert!(finished.stdout.contains("weights"), "{}", finished.stdout);
    drop(line);
    signal("TERM", router.id());
    router.finish(PATIENCE).with_code(0);

    let alone = Place::new();
    let endpoint = alone.endpoint("z");
    let learner = alone.start(&[RUN, "--listen", &endpoint]);
    let actor = alone.start(&["actor --connect", &endpoint]);
    learner.finish(PATIENCE).with_code(0);
    actor.finish(PATIENCE).with_code(0);
    let (far_apart, together) = (result(&run), result(&alone.run("r")));
    assert_eq!(far_apart["weights_sha256"], together["weights_sha256"]);
    assert_eq!(far_apart["books"]["balanced"], true, "{far_apart}");
    println!("same weights on five hosts and on one: {}", together["weights_sha256"]);
}
