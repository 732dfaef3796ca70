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
#[expect(missing_docs, reason = "the sentence of each variant names its fields")]
pub enum Error {
    /// A study, or what is asked of it, is impossible; the sentence says what is allowed.
    #[error("{0}")]
    Refused(String),
    #[error("{place}")]
    At {
        place: String,
        #[source]
        error: Box<Error>,
    },
    #[error("{action} {}", path.display())]
    File { action: &'static str, path: PathBuf, source: io::Error },
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error(transparent)]
    Configure(#[from] ConfigureError),
    #[error(transparent)]
    Record(#[from] RecordError),
    #[error(transparent)]
    Policy(#[from] PolicyFileError),
    #[error(transparent)]
    Launch(#[from] LaunchError),
    #[error("run `{run}` failed: {last} (the whole log: {})", log.display())]
    Training {
        run: String,
        /// The exit code of its learner; `None` if it was killed, or no actor was left.
        code: Option<i32>,
        last: String,
        log: PathBuf,
    },
    #[error(transparent)]
    Task(#[from] TaskError),
    #[error(transparent)]
    Play(#[from] leadtime_episodes::Error),
    #[error(transparent)]
    Script(#[from] leadtime_scripts::Error),
    #[error(transparent)]
    Eval(#[from] leadtime_eval::Error),
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
