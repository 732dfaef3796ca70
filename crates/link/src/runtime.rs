//! How many threads the network library may use, which it reads from a variable when it starts its first one.
//!
//! Its own limit is 50 threads that may block, for each of its runtimes. Every connection that ends or opens takes one
//! of them and waits there for a lock. When more than 50 actors lose their learner together, all of them wait, and what
//! would give the lock free finds no thread to run on until it gives up after ten seconds, once for every connection. So
//! actors stayed away for minutes.

use std::num::NonZeroUsize;

use ron::extensions::Extensions;
use ron::options::Options;
use serde::Deserialize;

/// The variable; a value that the person has set is theirs.
pub const RUNTIME_VARIABLE: &str = "ZENOH_RUNTIME";
/// Threads that may block, for each runtime in which connections end, open and receive: more than twice the connections
/// that may be opening at once (1,000), and more than twice the actors that a learner may be told to serve (1,000),
/// because a connection may still be ending while its successor opens. A thread is started only when it is needed.
const N_BLOCKING: usize = 2_048;
/// Threads that do the upkeep of connections: with one, whatever waits there holds up all connections.
const N_UPKEEP: usize = 2;

/// Returns the value that the variable should have.
///
/// The library reads these limits only from an environment variable, which cannot be set safely while threads run. So the caller that
/// starts a process with many connections sets it.
pub fn runtime() -> String {
    format!(
        "(net: (worker_threads: {N_UPKEEP}, max_blocking_threads: {N_BLOCKING}), \
         acc: (max_blocking_threads: {N_BLOCKING}), rx: (max_blocking_threads: {N_BLOCKING}))"
    )
}

/// Returns why the library cannot use a value of the variable; `None` if it can.
///
/// The library does not say it: it panics when its first thread starts, in every process of a run.
pub fn runtime_fault(value: &str) -> Option<String> {
    let options = Options::default().with_default_extension(Extensions::IMPLICIT_SOME);
    options.from_str::<Runtimes>(value).err().map(|error| error.to_string())
}

/// What the library reads from the variable.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "it is only checked that it can be read")]
struct Runtimes {
    #[serde(default)]
    app: RuntimeLimits,
    #[serde(default)]
    acc: RuntimeLimits,
    #[serde(default)]
    tx: RuntimeLimits,
    #[serde(default)]
    rx: RuntimeLimits,
    #[serde(default)]
    net: RuntimeLimits,
}

/// The limits of one of its runtimes.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "it is only checked that it can be read")]
struct RuntimeLimits {
    #[serde(default = "one")]
    worker_threads: NonZeroUsize,
    #[serde(default = "one")]
    max_blocking_threads: NonZeroUsize,
    #[serde(default)]
    handover: Option<RuntimeName>,
}

/// One of its runtimes.
#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum RuntimeName {
    App,
    Acc,
    Tx,
    Rx,
    Net,
}

impl Default for RuntimeLimits {
    fn default() -> Self {
        Self { worker_threads: one(), max_blocking_threads: one(), handover: None }
    }
}

fn one() -> NonZeroUsize {
    NonZeroUsize::MIN
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ListenSettings;
    use crate::session::ACCEPT_PENDING;

    #[test]
    fn there_are_threads_for_all_connections_to_end_and_open_at_once() {
        const { assert!(N_BLOCKING > 2 * ListenSettings::MOST_ACTORS as usize) };
        const { assert!(N_BLOCKING > 2 * ACCEPT_PENDING) };
        assert_eq!(runtime().matches("2048").count(), 3, "{}", runtime());
    }

    #[test]
    fn settings_that_the_library_would_panic_at_are_found_before() {
        for good in [runtime().as_str(), "()", "(rx: (handover: app), tx: (worker_threads: 2))"] {
            assert_eq!(runtime_fault(good), None, "{good}");
        }
        for bad in [
            "",
            "nonsense",
            "(net: 2)",
            "(net: None)",
            "(nte: (worker_threads: 1))",
            "(net: (worker_threads: 0))",
            "(net: (handover: nowhere))",
        ] {
            assert!(runtime_fault(bad).is_some_and(|why| !why.is_empty()), "{bad}");
        }
    }
}
