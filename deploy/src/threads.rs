//! The one place that decides how many threads the numeric library uses.
//!
//! candle and gemm read `RAYON_NUM_THREADS` when they first multiply, and the number of threads is part of what a
//! run's bits depend on. A variable cannot be set safely inside a running process, so the program starts itself
//! once more in the same process (same id, same files) with the variable set, before it does anything else.
//! Children of the supervisor inherit it.

use std::env;
use std::os::unix::process::CommandExt as _;
use std::process::Command;

use leadtime_runs::build::running_program;

/// The variables that the numeric libraries read.
const VARIABLES: [&str; 2] = ["RAYON_NUM_THREADS", "OMP_NUM_THREADS"];
/// One thread per process: actors and learner share the machine's cores as processes.
const N_THREADS: &str = "1";

/// Makes sure that the numeric libraries use the documented number of threads; call it first in `main`.
///
/// A number that the person has set stays. If the program cannot be started again it goes on as it is: the
/// libraries then use every core, which is slower but not wrong.
pub(crate) fn pin() {
    if env::var_os(VARIABLES[0]).is_some() {
        return;
    }
    let Ok(program) = running_program() else { return };
    let mut again = Command::new(program);
    again.args(env::args_os().skip(1)).envs(VARIABLES.map(|name| (name, N_THREADS)));
    if let Some(name) = env::args_os().next() {
        again.arg0(name);
    }
    // `exec` returns only if it failed.
    let error = again.exec();
    crate::output::say(&format!("warning: the number of threads stays unset: {error}"));
}

/// Returns the number of threads that the numeric libraries were told to use, for the run's record.
pub(crate) fn configured() -> String {
    env::var(VARIABLES[0]).unwrap_or_else(|_| "unset".to_owned())
}
