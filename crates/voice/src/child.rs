//! Programs of other people, which may be missing, slow or broken: nothing waits for them without a limit.

use std::io;
use std::process::{Command, ExitStatus, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use process_wrap::std::{ChildWrapper, CommandWrap, ProcessGroup};

use crate::error::VoiceError;

/// How long a program may take for a sentence.
pub(crate) const SENTENCE: Duration = Duration::from_secs(2);
/// After how many sentences without an answer in a row a program is given up.
pub(crate) const MAX_FAILURES: u32 = 3;
/// What a shell says of a command that is not there.
pub(crate) const NOT_FOUND: i32 = 127;
/// Pause between two looks whether it has ended.
const LOOK_EVERY: Duration = Duration::from_millis(2);

/// Starts a program in a process group of its own, so that whatever it starts ends with it.
pub(crate) fn spawn(command: Command) -> io::Result<Box<dyn ChildWrapper>> {
    CommandWrap::from(command).wrap(ProcessGroup::leader()).spawn()
}

pub(crate) fn shell(command: &str) -> Command {
    let mut shell = Command::new("sh");
    shell.args(["-c", command]);
    shell
}

/// Returns how a program ended, if it does within a time.
pub(crate) fn status_within(child: &mut dyn ChildWrapper, time: Duration) -> Option<ExitStatus> {
    let deadline = Instant::now() + time;
    loop {
        match child.try_wait() {
            Ok(Some(status)) => return Some(status),
            Ok(None) if Instant::now() < deadline => thread::sleep(LOOK_EVERY),
            _ => return None,
        }
    }
}

/// Ends a program and everything that it started.
pub(crate) fn end(child: &mut dyn ChildWrapper) {
    drop(child.start_kill());
    drop(child.wait());
}

/// Lets a program work, for at most [`SENTENCE`]; returns what it printed, or why there is nothing, in words.
///
/// What it prints has to fit into a pipe.
///
/// # Errors
///
/// [`VoiceError::Missing`] if there is no such program. That it fails or hangs is no error here.
pub(crate) fn output(
    mut command: Command,
    missing: impl FnOnce() -> VoiceError,
) -> Result<Result<String, String>, VoiceError> {
    let name = command.get_program().to_string_lossy().into_owned();
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null());
    let mut child = match spawn(command) {
        Ok(child) => child,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Err(missing()),
        Err(error) => return Ok(Err(format!("{name} cannot be started: {error}"))),
    };
    let Some(status) = status_within(child.as_mut(), SENTENCE) else {
        end(child.as_mut());
        return Ok(Err(format!("{name} took more than {} s", SENTENCE.as_secs())));
    };
    let mut printed = String::new();
    let read =
        child.stdout().take().map(|mut out| io::Read::read_to_string(&mut out, &mut printed));
    Ok(match read {
        Some(Ok(_)) if status.success() => Ok(printed),
        Some(Err(error)) => Err(format!("what {name} prints cannot be read: {error}")),
        _ => Err(format!("{name} ended with {status}")),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_that_hangs_fails_or_is_missing_is_told_in_words() {
        let missing = || VoiceError::Unknown("missing".to_owned());
        let run = |command: &str| output(shell(command), missing).unwrap();
        assert_eq!(run("echo words").unwrap(), "words\n");
        assert_eq!(run("exit 3").unwrap_err(), "sh ended with exit status: 3");
        let began = Instant::now();
        assert_eq!(run("sleep 60 & sleep 60").unwrap_err(), "sh took more than 2 s");
        assert!(began.elapsed() < Duration::from_secs(30), "nobody waits for its children");
        output(Command::new("no-such-program"), missing).unwrap_err();
    }
}
