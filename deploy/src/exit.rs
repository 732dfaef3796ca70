//! How the program ends: one closed list of exit codes, and failures that know theirs.
//!
//! A library's typed error becomes a [`Failure`] where a command knows what caused it: the input, the peer or the
//! program. The program prints it once, as `error: ...` with its causes.

use std::fmt;

/// Why the program ended; the numbers are part of its interface (`leadtime --help` lists them).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum ExitCode {
    /// The command succeeded.
    Done = 0,
    /// A bug in the program, or a failed check (conformance out of bounds, smoke below its mark).
    Failed = 1,
    /// Unusable input or output: arguments, configuration, files, directories, addresses, standard output.
    WrongInput = 2,
    /// A peer or the network is unreachable, was lost, or rejected us.
    PeerLost = 3,
    /// Ctrl-C, SIGTERM, SIGHUP, or the end of the supervising process.
    Interrupted = 130,
}

/// The paragraph of `--help` that lists the exit codes.
pub(crate) const EXIT_CODE_HELP: &str = "Exit codes:\n  \
    0    done\n  \
    1    a bug in the program, or a failed check\n  \
    2    unusable input or output: arguments, configuration, files, addresses\n  \
    3    a peer or the network is unreachable, was lost, or rejected us\n  \
    130  interrupted (Ctrl-C, SIGTERM, SIGHUP, supervisor gone)";

impl ExitCode {
    /// Every code, in ascending order.
    pub(crate) const ALL: [Self; 5] =
        [Self::Done, Self::Failed, Self::WrongInput, Self::PeerLost, Self::Interrupted];

    /// Returns the code that a process of ours ended with; [`ExitCode::Failed`] for any other number.
    pub(crate) fn from_status(code: i32) -> Self {
        Self::ALL.into_iter().find(|known| *known as i32 == code).unwrap_or(Self::Failed)
    }
}

/// An error and the exit code that it leads to.
#[derive(Debug)]
pub(crate) struct Failure {
    /// The exit code: what caused the error.
    pub code: ExitCode,
    /// The error to print; `None` if it has been reported (by a child process, or on standard output).
    pub error: Option<anyhow::Error>,
}

impl Failure {
    /// Makes a failure of an error and the exit code of what caused it.
    pub(crate) fn of(code: ExitCode, error: impl Into<anyhow::Error>) -> Self {
        Self { code, error: Some(error.into()) }
    }

    /// Makes a failure that has been reported.
    pub(crate) fn silent(code: ExitCode) -> Self {
        Self { code, error: None }
    }

    /// Makes a failure caused by the input, from one sentence.
    pub(crate) fn input(sentence: impl fmt::Display + fmt::Debug + Send + Sync + 'static) -> Self {
        Self::of(ExitCode::WrongInput, anyhow::Error::msg(sentence))
    }
}

impl From<anyhow::Error> for Failure {
    fn from(error: anyhow::Error) -> Self {
        Self::of(ExitCode::Failed, error)
    }
}

impl From<leadtime_eval::Error> for Failure {
    fn from(error: leadtime_eval::Error) -> Self {
        Self::of(ExitCode::Failed, error)
    }
}

/// Gives an error the exit code of what caused it.
pub(crate) trait Blame<T> {
    /// Makes the error a [`Failure`] with this exit code.
    fn blame(self, code: ExitCode) -> Result<T, Failure>;
}

impl<T, E: Into<anyhow::Error>> Blame<T> for Result<T, E> {
    fn blame(self, code: ExitCode) -> Result<T, Failure> {
        self.map_err(|error| Failure::of(code, error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn help_lists_every_exit_code() {
        for code in ExitCode::ALL {
            let line = format!("\n  {:<4} ", code as u8);
            assert!(EXIT_CODE_HELP.contains(&line), "{code:?} is missing");
        }
    }

    #[test]
    fn an_unknown_exit_status_counts_as_a_bug() {
        assert_eq!(ExitCode::from_status(130), ExitCode::Interrupted);
        assert_eq!(ExitCode::from_status(101), ExitCode::Failed);
    }
}
