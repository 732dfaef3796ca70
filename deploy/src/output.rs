//! Everything that goes to standard output and files (data) and the last words on standard error.
//!
//! A closed pipe (`leadtime runs | head -1`) is no error: the reader has what it wanted. Any other
//! failure, such as a full disk, is kept, and [`finish`] reports it when the command is done: work that was done is
//! not undone by it. What cannot be written to standard error is dropped.

use std::env;
use std::ffi::OsString;
use std::fmt::Display;
use std::io::{self, Write as _};
use std::path::Path;
use std::sync::OnceLock;

use anyhow::Context as _;
use leadtime_proto::text::{escaped, own_message};
use leadtime_runs::{command_line, journal, program_name, write_atomically};
pub(crate) use leadtime_table::WIDTH;
use serde::Serialize;

use crate::exit::Failure;
use crate::{logging, terminal};

/// The first failure to write to standard output.
static FAILED: OnceLock<io::Error> = OnceLock::new();

/// Writes lines for people to standard output.
pub(crate) fn line(text: &str) {
    data(&shown(text));
}

/// Writes text for programs and a line end to standard output, as it is.
pub(crate) fn data(text: &str) {
    keep(writeln!(io::stdout().lock(), "{text}"));
}

/// Writes a value as one line of JSON to standard output.
pub(crate) fn json<T: Serialize>(value: &T) {
    data(&serde_json::to_string(value).expect("results are plain data"));
}

/// Returns text as a terminal may get it: lines and tabs stay, and every other control character is escaped. A path may hold any.
fn shown(text: &str) -> String {
    let stays = |c: char| matches!(c, '\n' | '\t');
    let piece = |piece: &str| match piece.strip_suffix(stays) {
        Some(text) => escaped(text) + &piece[text.len()..],
        None => escaped(piece),
    };
    text.split_inclusive(stays).map(piece).collect()
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
    terminal::print(&shown(text));
}

/// Writes a line to standard error unless only warnings and results are wanted.
pub(crate) fn note(text: &str) {
    if logging::is_chatty() {
        say(text);
    }
}

/// Names this program as commands have to.
pub(crate) fn program() -> String {
    program_name(env::args_os().next())
}

/// Writes a command of this program as it can be typed.
pub(crate) fn command(args: impl IntoIterator<Item = OsString>) -> String {
    command_line(&program(), args)
}

/// Returns the command that is being carried out.
pub(crate) fn this_command() -> String {
    command(env::args_os().skip(1))
}

/// A command about a policy that can be typed next, with `POLICY` for it, and what it does.
type Hint = (&'static str, &'static str);
pub(crate) const EVALUATE: Hint = ("eval POLICY", "evaluate it over many episodes, with intervals");
pub(crate) const DRAW: Hint = ("play POLICY -o episode.png", "draw an episode of it");
pub(crate) const DRAW_MORE: Hint = ("play POLICY --eval-seed 2 -o other.png", "draw another one");
pub(crate) const REPORT: Hint = ("report POLICY", "evaluate it and write report.html again");
pub(crate) const HEAR: Hint = ("eval POLICY --transcript", "print an episode as it is heard");
pub(crate) const TRY: Hint = ("smoke", "train a policy, evaluate it and draw an episode of it");

/// Says what can be done next with a policy, or with a run's.
pub(crate) fn next(policy: &Path, hints: &[Hint]) {
    let word = |word: &str| if word == "POLICY" { policy.into() } else { word.into() };
    let line =
        |(hint, does): &Hint| format!("\n  {}\n      {does}", command(hint.split(' ').map(word)));
    note(&format!("\nNext:{}", hints.iter().map(line).collect::<String>()));
}

/// Says how a run goes on that was stopped: `command` is `up` or `learner`, with options of its own.
pub(crate) fn next_resumes(command: &str, run: &Path, name: &str, options: &[OsString]) {
    let (n_updates, config) = (journal::last_update(run), run.join("config.toml"));
    let mut args = vec![command.into(), "-c".into(), config.into(), "--name".into(), name.into()];
    args.extend(options.iter().cloned());
    note(&format!("\nTo go on from update {n_updates}:\n  {}", self::command(args)));
}

/// Writes an error as the last line of a command.
pub(crate) fn error(error: &impl Display) {
    say(&own_message(&format!("error: {error:#}")));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_path_holds_is_no_order_to_the_terminal() {
        let text = "run\truns/a\u{1b}[2J\u{7}b\r\nnext\u{202e}\n";
        assert_eq!(shown(text), "run\truns/a\\u{1b}[2J\\u{7}b\\r\nnext\\u{202e}\n");
        assert_eq!(shown("a ± b\n\n\tc"), "a ± b\n\n\tc");
    }
}
