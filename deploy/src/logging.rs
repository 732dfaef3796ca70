//! Logging: tracing events on standard error, or in a file.

use std::env::{self, VarError};
use std::fmt;
use std::io::{self, Write};

use anyhow::Context as _;
use leadtime_runs::clock;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::Layer as _;
use tracing_subscriber::fmt::MakeWriter;
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::time::FormatTime;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;

use crate::cli::{LogArgs, LogFormat};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::log_line::JsonLine;
use crate::{log_file, refused, terminal};

/// The variable that says what to log.
const VARIABLE: &str = "RUST_LOG";

/// Starts logging at `level` (`info`, `warn`) unless `RUST_LOG` says otherwise; refuses what is not a filter, and a file
/// that cannot be opened.
pub(crate) fn start(level: &str, how: &LogArgs) -> Result<(), Failure> {
    let filter = filter(level, env::var(VARIABLE))?;
    if let Some(path) = &how.log_file {
        let opened = log_file::open(path);
        opened
            .with_context(|| format!("--log-file {}", path.display()))
            .blame(ExitCode::WrongInput)?;
    }
    let is_watched = terminal::is_watched() && how.log_file.is_none();
    let colour = is_watched && env::var_os("NO_COLOR").is_none();
    let lines = tracing_subscriber::fmt::layer().with_writer(LogOutput);
    let lines = match how.log_format {
        LogFormat::Json => lines.event_format(JsonLine).boxed(),
        LogFormat::Text => {
            let lines = lines.with_timer(TimeStamp { is_watched });
            lines.with_ansi(colour).with_target(false).boxed()
        }
    };
    let shown = lines.with_filter(filter);
    let started = tracing_subscriber::registry().with(shown).with(refused::layer()).try_init();
    if started.is_err() {
        tracing::debug!("logging was started by the embedding program");
    }
    Ok(())
}

fn filter(level: &str, wanted: Result<String, VarError>) -> Result<EnvFilter, Failure> {
    let help = "write a level (`debug`) or `module=level,...`";
    let refused = |reason: String| Failure::input(format!("{VARIABLE} {reason}; {help}"));
    match wanted {
        Ok(wanted) if !wanted.trim().is_empty() => EnvFilter::try_new(&wanted)
            .map_err(|error| refused(format!("is `{wanted}`, which is not a filter: {error}"))),
        Err(VarError::NotUnicode(_)) => Err(refused("is not text".to_owned())),
        // The network library explains every reconnect; its errors reach the person through ours.
        Ok(_) | Err(VarError::NotPresent) => {
            Ok(EnvFilter::new(format!("{level},zenoh=off,symphonia=warn")))
        }
    }
}

/// Writes the time of day for a person who watches, the date and time where they read it later.
#[derive(Clone, Copy, Debug)]
struct TimeStamp {
    is_watched: bool,
}

impl FormatTime for TimeStamp {
    fn format_time(&self, out: &mut Writer<'_>) -> fmt::Result {
        out.write_str(&if self.is_watched { clock::time_of_day() } else { clock::utc_now() })
    }
}

/// Tells whether a person wants to hear more than warnings and results.
pub(crate) fn is_chatty() -> bool {
    tracing::enabled!(tracing::Level::INFO)
}

/// Writes to the log file, or to standard error; a line that cannot be written, on a full disk for one, is dropped and ends
/// nothing.
#[derive(Clone, Copy, Debug)]
struct LogOutput;

impl<'a> MakeWriter<'a> for LogOutput {
    type Writer = Self;

    fn make_writer(&'a self) -> Self {
        *self
    }
}

impl Write for LogOutput {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        // No error is returned: the subscriber would answer it with `eprintln!`, which panics for the same reason.
        if !log_file::write(bytes) {
            terminal::print(&String::from_utf8_lossy(bytes));
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_filter_that_does_not_parse_is_refused() {
        for wanted in ["debug", "leadtime_link=trace,warn", ""] {
            filter("info", Ok(wanted.to_owned())).unwrap();
        }
        let error = filter("info", Ok("leadtime=loud".to_owned())).unwrap_err();
        assert!(format!("{error:?}").contains("RUST_LOG is `leadtime=loud`"), "{error:?}");
    }
}
