//! Which build of the program this is.

use anyhow::Context as _;
use leadtime_runs::ProgramBuild;

use crate::threads;

/// Describes the program that runs; reads all of it, so a process asks once.
pub(crate) fn this_build() -> anyhow::Result<ProgramBuild> {
    ProgramBuild::of_this_process(option_env!("LEADTIME_COMMIT"), threads::configured())
        .context("reading the program's own file")
}
