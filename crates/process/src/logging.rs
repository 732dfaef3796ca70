//! Logging: tracing events in the log file, or wherever the caller writes them.

use std::env::VarError;
use std::fmt;
use std::io::{self, Write};

use leadtime_runs::clock;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::Layer as _;
use tracing_subscriber::fmt::MakeWriter;
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::time::FormatTime;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;

use crate::error::Error;
use crate::log_line::JsonLine;
use crate::{log_file, refused};

/// The variable that says what to log.
pub const VARIABLE: &str = "RUST_LOG";

/// What is logged.
#[derive(Debug)]
pub struct LogFilter(EnvFilter);

/// How lines of the log look, and who writes them where there is no log file.
#[derive(Clone, Copy, Debug)]
pub struct LogStyle {
    /// Each is one JSON object, for machines.
    pub is_json: bool,
    /// A person watches as they come: the time of day is enough.
    pub is_watched: bool,
    /// They have colours.
    pub is_coloured: bool,
    /// Writes lines, and drops what cannot be written.
    pub write: fn(&str),
}

/// Starts logging, unless the embedding program has done so.
pub fn start(filter: LogFilter, style: LogStyle) {
    let lines = tracing_subscriber::fmt::layer().with_writer(LogOutput { write: style.write });
    let lines = if style.is_json {
        lines.event_format(JsonLine).boxed()
    } else {
        let lines = lines.with_timer(TimeStamp { is_watched: style.is_watched });
        lines.with_ansi(style.is_coloured).with_target(false).boxed()
    };
    let shown = lines.with_filter(filter.0);
    let started = tracing_subscriber::registry().with(shown).with(refused::layer()).try_init();
    if started.is_err() {
        tracing::debug!("logging was started by the embedding program");
    }
}

/// Reads what [`VARIABLE`] says; where it says nothing, `level` (`info`, `warn`) holds.
///
/// # Errors
///
/// [`Error::Filter`] if that is not a filter.
pub fn filter(level: &str, wanted: Result<String, VarError>) -> Result<LogFilter, Error> {
    let refused = |reason: String| Error::Filter(format!("{VARIABLE} {reason}"));
    match wanted {
        Ok(wanted) if !wanted.trim().is_empty() => EnvFilter::try_new(&wanted)
            .map_err(|error| refused(format!("is `{wanted}`, which is not a filter: {error}"))),
        Err(VarError::NotUnicode(_)) => Err(refused("is not text".to_owned())),
        // The network library explains every reconnect; its errors reach the person through ours.
        Ok(_) | Err(VarError::NotPresent) => {
            Ok(EnvFilter::new(format!("{level},zenoh=off,symphonia=warn")))
        }
    }
    .map(LogFilter)
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

/// Writes to the log file, or as the caller does; a line that cannot be written, on a full disk for one, is dropped and ends
/// nothing.
#[derive(Clone, Copy, Debug)]
struct LogOutput {
    write: fn(&str),
}

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
            (self.write)(&String::from_utf8_lossy(bytes));
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
        assert!(error.to_string().starts_with("RUST_LOG is `leadtime=loud`"), "{error}");
    }
}
