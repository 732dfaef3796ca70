//! Why a study cannot be carried out.

use std::fmt::Display;
use std::io;
use std::path::{Path, PathBuf};

use leadtime_config::ConfigError;
use leadtime_runs::launch::LaunchError;
use leadtime_runs::policy_file::PolicyFileError;
use leadtime_runs::record::RecordError;
use leadtime_runs::tasks::ConfigureError;
use leadtime_sims::TaskError;
use thiserror::Error;

/// Why a study cannot be carried out.
#[derive(Debug, Error)]
pub enum Error {
    /// A study, or what is asked of it, is impossible; the sentence says what is allowed.
    #[error("{0}")]
    Refused(String),
    /// An error in one place: a study, a part, a row, an option.
    #[error("{place}")]
    At {
        /// The study, part, row or option.
        place: String,
        /// What is wrong there.
        #[source]
        error: Box<Error>,
    },
    /// A file cannot be read or written.
    #[error("{action} {}", path.display())]
    File {
        /// What was tried, such as `reading`.
        action: &'static str,
        /// The file or directory.
        path: PathBuf,
        /// What the system answered.
        source: io::Error,
    },
    /// A configuration is refused.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A configuration cannot be loaded.
    #[error(transparent)]
    Configure(#[from] ConfigureError),
    /// A run's record cannot be read.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// A run's policy cannot be used.
    #[error(transparent)]
    Policy(#[from] PolicyFileError),
    /// A training cannot be launched.
    #[error(transparent)]
    Launch(#[from] LaunchError),
    /// A training was launched and failed.
    #[error("run `{run}` failed: {last} (the whole log: {})", log.display())]
    Training {
        /// The run whose training failed.
        run: String,
        /// The exit code of its learner; `None` if it was killed, or no actor was left.
        code: Option<i32>,
        /// The last line that its processes logged.
        last: String,
        /// The file that collects what they logged.
        log: PathBuf,
    },
    /// The domain refuses its settings.
    #[error(transparent)]
    Task(#[from] TaskError),
    /// Episodes cannot be played.
    #[error(transparent)]
    Play(#[from] leadtime_episodes::Error),
    /// A script cannot be searched or used.
    #[error(transparent)]
    Script(#[from] leadtime_scripts::Error),
    /// An evaluation or a picture failed.
    #[error(transparent)]
    Eval(#[from] leadtime_eval::Error),
    /// The program was asked to end.
    #[error("interrupted")]
    Interrupted,
}

impl Error {
    /// Makes an error about a file, for `map_err`.
    pub(crate) fn file(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::File { action, path, source }
    }
}

/// Refuses what is asked unless `holds`.
pub(crate) fn ensure<S: Into<String>>(
    holds: bool,
    sentence: impl FnOnce() -> S,
) -> Result<(), Error> {
    if holds { Ok(()) } else { Err(Error::Refused(sentence().into())) }
}

/// Names the place of an error.
pub(crate) trait Placed<T> {
    /// Makes an error [`Error::At`] that place.
    fn at(self, place: impl Display) -> Result<T, Error>;
}

impl<T, E: Into<Error>> Placed<T> for Result<T, E> {
    fn at(self, place: impl Display) -> Result<T, Error> {
        self.map_err(|error| Error::At { place: place.to_string(), error: Box::new(error.into()) })
    }
}
