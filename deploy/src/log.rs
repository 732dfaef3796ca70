//! Begins the log that the command line asks for, and tells whether a person wants to read it.

use std::env;

use anyhow::Context as _;
use leadtime_process::log_file;
use leadtime_process::logging::{self, LogStyle};

use crate::cli::{LogArgs, LogFormat};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::terminal;

/// Starts logging at `level` (`info`, `warn`) unless `RUST_LOG` says otherwise; refuses what is not a filter, and a file
/// that cannot be opened.
pub(crate) fn start(level: &str, how: &LogArgs) -> Result<(), Failure> {
    let filter = logging::filter(level, env::var(logging::VARIABLE));
    let filter = filter.blame(ExitCode::WrongInput)?;
    if let Some(path) = &how.log_file {
        let opened = log_file::open(path);
        opened
            .with_context(|| format!("--log-file {}", path.display()))
            .blame(ExitCode::WrongInput)?;
    }
    let is_watched = terminal::is_watched() && how.log_file.is_none();
    let style = LogStyle {
        is_json: how.log_format == LogFormat::Json,
        is_watched,
        is_coloured: is_watched && env::var_os("NO_COLOR").is_none(),
        write: terminal::print,
    };
    logging::start(filter, style);
    Ok(())
}

/// Tells whether a person wants to hear more than warnings and results.
pub(crate) fn is_chatty() -> bool {
    tracing::enabled!(tracing::Level::INFO)
}
