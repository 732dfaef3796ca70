//! Everything that goes to standard output and files (data) and the last words on standard error.
//!
//! A closed pipe (`leadtime runs | head -1`) is no error: whoever stopped reading has what they wanted. Any other
//! failure, such as a full disk, is kept, and [`finish`] reports it when the command is done: work that was done is
//! not undone by it. What cannot be written to standard error is dropped.

use std::ffi::OsString;
use std::fmt::Display;
use std::io::{self, Write as _};
use std::path::Path;
use std::sync::OnceLock;

use anyhow::Context as _;
use leadtime_proto::text::own_message;
use leadtime_runs::write_atomically;
use serde::Serialize;

use crate::exit::Failure;

/// The first failure to write to standard output.
static FAILED: OnceLock<io::Error> = OnceLock::new();

/// Writes text and a line end to standard output.
pub(crate) fn line(text: &str) {
    keep(writeln!(io::stdout().lock(), "{text}"));
}

/// Writes a value as one line of JSON to standard output.
pub(crate) fn json<T: Serialize>(value: &T) {
    line(&serde_json::to_string(value).expect("results are plain data"));
}

/// Writes a file, whole or not at all.
pub(crate) fn file(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    write_atomically(path, bytes).with_context(|| format!("writing {}", path.display()))
}

/// Keeps the outcome of a write to standard output for [`finish`].
pub(crate) fn keep(written: io::Result<()>) {
    if let Err(error) = written
        && error.kind() != io::ErrorKind::BrokenPipe
    {
        // Only the first one counts.
        drop(FAILED.set(error));
    }
}

/// Writes out what is still buffered; fails if anything could not be written to standard output.
pub(crate) fn finish() -> Result<(), Failure> {
    keep(io::stdout().lock().flush());
    let failure = |error| Failure::input(format!("standard output cannot be written: {error}"));
    FAILED.get().map_or(Ok(()), |error| Err(failure(error)))
}

/// Writes a line to standard error, whatever `RUST_LOG` says.
pub(crate) fn say(text: &str) {
    drop(writeln!(io::stderr().lock(), "{text}"));
}

/// Writes an error as the last line of a command.
pub(crate) fn error(error: &impl Display) {
    say(&own_message(&format!("error: {error:#}")));
}

/// Writes a command with its arguments so that a shell reads the same ones.
pub(crate) fn command_line(args: impl Iterator<Item = OsString>) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "_-+=.,:/@%".contains(c);
    let quoted = args.map(|arg| {
        let arg = arg.to_string_lossy();
        let plain = !arg.is_empty() && arg.chars().all(is_plain);
        if plain { arg.into_owned() } else { format!("'{}'", arg.replace('\'', r"'\''")) }
    });
    std::iter::once("leadtime".to_owned()).chain(quoted).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shell_reads_a_command_back() {
        let args = ["eval", "it's", "--set=human.d={fixed=3}", "", "a b"];
        let command = command_line(args.into_iter().map(OsString::from));
        assert_eq!(command, r"leadtime eval 'it'\''s' '--set=human.d={fixed=3}' '' 'a b'");
    }
}
