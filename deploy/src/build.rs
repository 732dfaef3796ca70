//! Which build of the program this is.

use anyhow::Context as _;
use leadtime_runs::ProgramBuild;

use crate::threads;

/// The commit that the program was built from, if known.
pub const COMMIT: Option<&str> = option_env!("LEADTIME_COMMIT");

/// Describes the program that runs; reads all of it, so a process asks once.
///
/// # Errors
///
/// If the executable cannot be read.
pub fn this_build() -> anyhow::Result<ProgramBuild> {
    ProgramBuild::of_this_process(COMMIT, threads::configured())
        .context("reading the program's own file")
}
