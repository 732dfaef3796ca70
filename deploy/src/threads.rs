//! The one place that decides how many threads the libraries use.
//!
//! candle and gemm read `RAYON_NUM_THREADS` when they first multiply. What a run computes is not theirs (an update's threads are
//! `learner.threads`), so no bit depends on it: it keeps them from starting a thread for every core. The network library reads its
//! own variable when it first connects ([`leadtime_link::runtime`]).
//! A variable cannot be set safely inside a running process, so the program starts itself once more in the same process
//! (same id, same files) with the variables set, before it does anything else. Children of the supervisor inherit them.

use std::env::{self, VarError};
use std::os::unix::process::CommandExt as _;
use std::process::Command;

use leadtime_link::{RUNTIME_VARIABLE, runtime_fault};
use leadtime_proto::text::quoted;
use leadtime_runs::build::running_program;

use crate::exit::Failure;

/// The variables that the numeric libraries read.
const NUMERIC: [&str; 2] = ["RAYON_NUM_THREADS", "OMP_NUM_THREADS"];
/// One thread per process: actors and learner share the machine's cores as processes.
const N_THREADS: &str = "1";

/// Makes sure that the libraries use the documented numbers of threads; call it first in `main`.
///
/// What the person has set stays. If the program cannot be started again it goes on as it is: the numeric libraries
/// then use every core, which is slower but not wrong, and many actors that lose their learner together come back later.
pub(crate) fn pin() {
    let unset = unset(|name| env::var_os(name).is_some());
    if unset.is_empty() {
        return;
    }
    let Ok(program) = running_program() else { return };
    let mut again = Command::new(program);
    again.args(env::args_os().skip(1)).envs(unset);
    if let Some(name) = env::args_os().next() {
        again.arg0(name);
    }
    // `exec` returns only if it failed.
    let error = again.exec();
    crate::output::say(&format!("warning: the number of threads stays unset: {error}"));
}

/// Lists the variables that are still to be set, with their values.
fn unset(is_set: impl Fn(&str) -> bool) -> Vec<(&'static str, String)> {
    let mut unset = Vec::new();
    if !is_set(NUMERIC[0]) {
        unset.extend(NUMERIC.map(|name| (name, N_THREADS.to_owned())));
    }
    if !is_set(RUNTIME_VARIABLE) {
        unset.push((RUNTIME_VARIABLE, leadtime_link::runtime()));
    }
    unset
}

/// Refuses a number of threads for the network library that it cannot read.
pub(crate) fn check() -> Result<(), Failure> {
    checked(env::var(RUNTIME_VARIABLE))
}

fn checked(wanted: Result<String, VarError>) -> Result<(), Failure> {
    let help = "leave it unset, or write for example `(net: (worker_threads: 2))`";
    let refused = |reason: String| Failure::input(format!("{RUNTIME_VARIABLE} {reason}; {help}"));
    match wanted {
        Ok(value) => match runtime_fault(&value) {
            Some(fault) => Err(refused(format!(
                "is `{}`, which the network library cannot read: {}",
                quoted(&value),
                quoted(&fault)
            ))),
            None => Ok(()),
        },
        Err(VarError::NotUnicode(_)) => Err(refused("is not text".to_owned())),
        Err(VarError::NotPresent) => Ok(()),
    }
}

/// Returns the number of threads that the numeric libraries were told to use, for the run's record.
pub(crate) fn configured() -> String {
    env::var(NUMERIC[0]).unwrap_or_else(|_| "unset".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn threads_that_the_network_library_cannot_read_are_refused() {
        checked(Err(VarError::NotPresent)).unwrap();
        checked(Ok(leadtime_link::runtime())).unwrap();
        let error = checked(Ok("nonsense".to_owned())).unwrap_err();
        assert!(format!("{error:?}").contains("ZENOH_RUNTIME is `nonsense`, which"), "{error:?}");
    }

    #[test]
    fn what_the_person_has_set_stays_and_the_rest_is_set_once() {
        let names = |set: &[&str]| -> Vec<&str> {
            unset(|name| set.contains(&name)).into_iter().map(|(name, _)| name).collect()
        };
        assert_eq!(names(&[]), [NUMERIC[0], NUMERIC[1], RUNTIME_VARIABLE]);
        assert_eq!(names(&[NUMERIC[0]]), [RUNTIME_VARIABLE]);
        assert_eq!(names(&[RUNTIME_VARIABLE]), NUMERIC);
        let all: Vec<&str> = unset(|_| false).into_iter().map(|(name, _)| name).collect();
        assert!(unset(|name| all.contains(&name)).is_empty(), "or it would start for ever");
    }
}
