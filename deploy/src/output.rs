//! Everything that goes to standard output and files (data) and the last words on standard error.
//!
//! A closed pipe (`leadtime runs | head -1`) is no error: the reader has what it wanted. Any other
//! failure, such as a full disk, is kept, and [`finish`] reports it when the command is done: work that was done is
//! not undone by it. What cannot be written to standard error is dropped.

use std::env;
use std::ffi::OsString;
use std::fmt::Display;
use std::fs::{self, File};
use std::io::{self, Write as _};
use std::os::unix::fs::FileTypeExt as _;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use anyhow::Context as _;
use leadtime_proto::text::{escaped, own_message};
use leadtime_runs::{PartialFile, command_line, layout, program_name};
pub(crate) use leadtime_table::WIDTH;
use serde::Serialize;

use crate::exit::Failure;
use crate::{log, terminal};

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
///
/// What is no file, such as `/dev/stdout` or a pipe, takes the content; it is not replaced. Of a link, what it leads to is
/// replaced.
pub(crate) fn file(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let mut file = GrowingFile::begin(path)?;
    file.add(bytes)?;
    file.end()
}

/// A file that grows piece by piece; whole or not at all, as [`file()`] has it.
pub(crate) struct GrowingFile<'a> {
    path: &'a Path,
    target: GrowingTarget,
}

/// What takes the pieces of a file.
enum GrowingTarget {
    /// What is no file: it has what was written so far.
    Stream(Box<dyn io::Write>),
    Partial(PartialFile),
}

impl<'a> GrowingFile<'a> {
    /// Begins the file.
    pub(crate) fn begin(path: &'a Path) -> anyhow::Result<Self> {
        let target = if is_stream(path) {
            stream(path).map(GrowingTarget::Stream)
        } else {
            PartialFile::create(&meant(path)).map(GrowingTarget::Partial)
        };
        Ok(Self { path, target: target.with_context(|| writing(path))? })
    }

    /// Adds a piece.
    pub(crate) fn add(&mut self, piece: &[u8]) -> anyhow::Result<()> {
        let written = match &mut self.target {
            GrowingTarget::Stream(stream) => pour(stream, piece),
            GrowingTarget::Partial(file) => file.write_all(piece),
        };
        written.with_context(|| writing(self.path))
    }

    /// Puts the whole file in its place.
    pub(crate) fn end(self) -> anyhow::Result<()> {
        let placed = match self.target {
            GrowingTarget::Stream(_) => Ok(()),
            GrowingTarget::Partial(file) => file.place(),
        };
        placed.with_context(|| writing(self.path))
    }
}

/// Says what could not be done with a path.
fn writing(path: &Path) -> String {
    format!("writing {}", path.display())
}

/// Makes sure that [`file()`] can write there, and leaves nothing behind: long work must not end with a refusal.
pub(crate) fn check_file(path: &Path) -> anyhow::Result<()> {
    if is_stream(path) {
        let is_pipe = fs::metadata(path).with_context(|| writing(path))?.file_type().is_fifo();
        // Opening a pipe waits for its reader.
        return if is_pipe {
            Ok(())
        } else {
            stream(path).map(drop).with_context(|| writing(path))
        };
    }
    let meant = meant(path);
    if meant.is_dir() {
        return Err(io::Error::from(io::ErrorKind::IsADirectory)).with_context(|| writing(path));
    }
    let folder = meant.parent().filter(|folder| !folder.as_os_str().is_empty());
    let tried = tempfile::tempfile_in(folder.unwrap_or(Path::new(".")));
    tried.map(|_file| ()).with_context(|| writing(path))
}

/// Returns what a path leads to, if it is a link.
fn meant(path: &Path) -> PathBuf {
    let target = if path.is_symlink() { path.canonicalize().ok() } else { None };
    target.unwrap_or_else(|| path.to_owned())
}

/// Tells whether a path leads to what takes bytes and stays: a pipe, a device, what a process has open.
fn is_stream(path: &Path) -> bool {
    const OPEN: [&str; 4] = ["/dev/stdout", "/dev/stderr", "/dev/fd", "/proc"];
    let is_other = |found: fs::Metadata| !found.is_file() && !found.is_dir();
    OPEN.iter().any(|open| path.starts_with(open)) || fs::metadata(path).is_ok_and(is_other)
}

/// Opens what takes bytes and stays.
fn stream(path: &Path) -> io::Result<Box<dyn io::Write>> {
    let stream: Box<dyn io::Write> = match path.to_str() {
        // Where a file is behind it, bytes that came another way would be written over by whoever writes there next.
        Some("/dev/stdout" | "/dev/fd/1" | "/proc/self/fd/1") => Box::new(io::stdout()),
        Some("/dev/stderr" | "/dev/fd/2" | "/proc/self/fd/2") => Box::new(io::stderr()),
        _ => Box::new(File::options().append(true).open(path)?),
    };
    Ok(stream)
}

/// Adds bytes to a stream; one whose reader is gone has what it wanted.
fn pour(stream: &mut dyn io::Write, bytes: &[u8]) -> io::Result<()> {
    match stream.write_all(bytes).and_then(|()| stream.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        written => written,
    }
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
    if log::is_chatty() {
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
    let (n_updates, config) = (layout::n_saved(run).unwrap_or(0), run.join("config.toml"));
    let mut args = vec![command.into(), "-c".into(), config.into(), "--name".into(), name.into()];
    // A configuration is text, and cannot say in which directory this one lies.
    if let Some(runs) = run.parent().filter(|runs| runs.to_str().is_none()) {
        args.extend([OsString::from("--runs"), runs.into()]);
    }
    args.extend(options.iter().cloned());
    note(&format!("\nTo go on from update {n_updates}:\n  {}", self::command(args)));
}

/// Writes an error as the last line of a command.
pub(crate) fn error(error: &impl Display) {
    say(&own_message(&format!("error: {error:#}")));
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{FileTypeExt as _, symlink};
    use std::process::{Command, Stdio};

    use super::*;

    #[test]
    fn a_pipe_takes_what_is_written_and_a_link_stays_one() {
        let place = tempfile::tempdir().unwrap();
        let pipe = place.path().join("pipe");
        assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let reader = Command::new("cat").arg(&pipe).stdout(Stdio::piped()).spawn().unwrap();
        file(&pipe, b"words").unwrap();
        assert!(fs::metadata(&pipe).unwrap().file_type().is_fifo(), "it was replaced");
        assert_eq!(reader.wait_with_output().unwrap().stdout, b"words");
        let (real, link) = (place.path().join("real.txt"), place.path().join("link.txt"));
        fs::write(&real, "old").unwrap();
        symlink(&real, &link).unwrap();
        file(&link, b"new").unwrap();
        assert!(link.is_symlink());
        assert_eq!(fs::read_to_string(&real).unwrap(), "new");
    }

    #[test]
    fn a_link_is_checked_where_it_leads() {
        let place = tempfile::tempdir().unwrap();
        let (folder, link) = (place.path().join("folder"), place.path().join("link.txt"));
        fs::create_dir(&folder).unwrap();
        fs::write(folder.join("real.txt"), "old").unwrap();
        symlink(folder.join("real.txt"), &link).unwrap();
        assert_eq!(meant(&link), folder.join("real.txt").canonicalize().unwrap());
        assert_eq!(meant(&folder), folder);
        check_file(&link).unwrap();
    }

    #[test]
    fn whether_a_file_can_be_written_is_known_before_and_nothing_is_left() {
        let place = tempfile::tempdir().unwrap();
        check_file(&place.path().join("new.txt")).unwrap();
        assert_eq!(fs::read_dir(place.path()).unwrap().count(), 0);
        let closed = PathBuf::from("/dev/fd/999");
        for path in [place.path().join("none/new.txt"), place.path().to_owned(), closed] {
            let told = check_file(&path).unwrap_err().to_string();
            assert_eq!(told, format!("writing {}", path.display()));
        }
    }

    #[test]
    fn a_file_that_grows_is_there_when_it_is_whole_and_a_pipe_has_its_pieces() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("steps.jsonl");
        fs::write(&path, "old").unwrap();
        let mut growing = GrowingFile::begin(&path).unwrap();
        growing.add(b"one\n").unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "old");
        growing.add(b"two\n").unwrap();
        growing.end().unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "one\ntwo\n");
        let pipe = place.path().join("pipe");
        assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let reader = Command::new("cat").arg(&pipe).stdout(Stdio::piped()).spawn().unwrap();
        let mut growing = GrowingFile::begin(&pipe).unwrap();
        growing.add(b"one\n").unwrap();
        growing.add(b"two\n").unwrap();
        growing.end().unwrap();
        assert_eq!(reader.wait_with_output().unwrap().stdout, b"one\ntwo\n");
    }

    #[test]
    fn control_characters_of_a_path_do_not_reach_the_terminal() {
        let text = "run\truns/a\u{1b}[2J\u{7}b\r\nnext\u{202e}\n";
        assert_eq!(shown(text), "run\truns/a\\u{1b}[2J\\u{7}b\\r\nnext\\u{202e}\n");
        assert_eq!(shown("a ± b\n\n\tc"), "a ± b\n\n\tc");
    }
}
