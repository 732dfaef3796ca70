//! Which program made a page, on what and when: the last lines of where its numbers are from.

use std::io;

use leadtime_eval::report::Fact;

use crate::{build_id, clock, cpu};

/// Describes the program that runs, the processor and the day.
///
/// # Errors
///
/// As [`build_id::fingerprint`].
pub(super) fn this_program() -> io::Result<[Fact; 3]> {
    let commit = build_id::COMMIT.unwrap_or("unknown");
    Ok([
        Fact::new("program", format!("{}, commit {commit}", build_id::fingerprint()?)),
        Fact::new("processor", cpu::fingerprint()),
        Fact::new("date", clock::utc_date()),
    ])
}
