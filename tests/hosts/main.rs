//! Hosts made of network namespaces: what README and docs/operations.md have for several of them, and a training in which a host
//! is cut off, hears nothing, is not heard, and stands still.
//!
//! It needs root and `ip` (iproute2), so it runs only if asked: `cargo test -p leadtime --test hosts -- --ignored [NAME]`. It has
//! no harness, because this program is also the slow line, and what opens the page: processes of their own in hosts.

#![expect(clippy::print_stdout, reason = "it has no harness that says why it is skipped")]

mod blows;
mod namespaces;
mod pages;
mod relay;
#[expect(dead_code, reason = "the other process tests use the rest")]
#[path = "../processes/support.rs"]
mod support;

use std::env;
use std::time::Instant;

use namespaces::Hosts;
use support::get;

/// What a test does with its hosts.
type HostsTest = fn(&Hosts);

/// What is tried, by name.
const TESTS: [(&str, HostsTest); 5] = [
    ("readme", pages::the_commands_of_readme_work_on_hosts_of_their_own),
    ("operations", pages::the_commands_without_a_router_work_on_two_hosts),
    ("python", pages::an_environment_of_ones_own_trains_on_two_hosts),
    ("sync", |hosts| blows::the_weights_are_those_of_a_run_in_peace(hosts, "sync")),
    ("lag", |hosts| blows::the_weights_are_those_of_a_run_in_peace(hosts, "lag")),
];

fn main() {
    let arguments: Vec<String> = env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["relay", listen, target] => relay::run(listen, target, blows::DELAY),
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
            let wanted: Vec<&String> = arguments.iter().filter(|it| !it.starts_with('-')).collect();
            for (name, test) in TESTS {
                if wanted.is_empty() || wanted.iter().any(|part| name.contains(part.as_str())) {
                    let started = Instant::now();
                    let names = ["authority", "router", "learner", "near", "far", "page"];
                    test(&Hosts::make(&names).unwrap_or_else(|reason| panic!("{reason}")));
                    println!("{name}: ok, {:.0} s", started.elapsed().as_secs_f64());
                }
            }
        }
        _ => println!("skipped: it makes network namespaces; as root, run it with `-- --ignored`"),
    }
}
