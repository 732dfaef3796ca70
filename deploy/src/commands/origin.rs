//! Which program made a page, on what and when: the last lines of where its numbers are from.

use leadtime_eval::report::Fact;
use leadtime_runs::clock;

use crate::build::this_build;

/// Describes the program that runs, the processor and the day.
///
/// # Errors
///
/// As [`this_build`].
pub(super) fn this_program() -> anyhow::Result<[Fact; 3]> {
    let build = this_build()?;
    let commit = build.commit.as_deref().unwrap_or("unknown");
    Ok([
        Fact::new("program", format!("{}, commit {commit}", build.program)),
        Fact::new("processor", build.cpu),
        Fact::new("date", clock::utc_date()),
    ])
}
