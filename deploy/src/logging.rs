//! Logging: tracing events on standard error, above a progress bar if there is one.

use std::env::{self, VarError};
use std::io::{self, IsTerminal as _, Write};
use std::sync::OnceLock;

use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::MakeWriter;

use crate::exit::Failure;

/// The variable that says what to log.
const VARIABLE: &str = "RUST_LOG";

/// The bars of this process; log lines are written above them.
static BARS: OnceLock<MultiProgress> = OnceLock::new();

/// Starts logging at `level` (`info`, `warn`) unless `RUST_LOG` says otherwise; refuses what is not a filter.
pub(crate) fn start(level: &str) -> Result<(), Failure> {
    let colour = io::stderr().is_terminal() && env::var_os("NO_COLOR").is_none();
    let started = tracing_subscriber::fmt()
        .with_env_filter(filter(level, env::var(VARIABLE))?)
        .with_writer(AboveBars)
        .with_ansi(colour)
        .with_target(false)
        .try_init();
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
        Ok(_) | Err(VarError::NotPresent) => Ok(EnvFilter::new(format!("{level},zenoh=off"))),
    }
}

/// Makes a bar for a person who watches; `None` where standard error is no terminal.
pub(crate) fn bar(template: &str) -> Option<ProgressBar> {
    let style =
        || ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    io::stderr().is_terminal().then(|| bars().add(ProgressBar::new(0).with_style(style())))
}

fn bars() -> &'static MultiProgress {
    BARS.get_or_init(MultiProgress::new)
}

/// Writes to standard error; a line that cannot be written, on a full disk for one, is dropped and ends nothing.
#[derive(Clone, Copy, Debug)]
struct AboveBars;

impl<'a> MakeWriter<'a> for AboveBars {
    type Writer = Self;

    fn make_writer(&'a self) -> Self {
        *self
    }
}

impl Write for AboveBars {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        // No error is returned: the subscriber would answer it with `eprintln!`, which panics for the same reason. And
        // not `suspend`, which panics where the terminal is gone.
        drop(if bars().is_hidden() {
            io::stderr().lock().write_all(bytes)
        } else {
            bars().println(String::from_utf8_lossy(bytes).trim_end_matches('\n'))
        });
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
