//! Talk: tracing events on standard error, above a progress bar if there is one.

use std::io::{self, IsTerminal as _, Write};
use std::sync::OnceLock;

use indicatif::MultiProgress;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::MakeWriter;

/// The bars of this process; log lines are written above them.
static BARS: OnceLock<MultiProgress> = OnceLock::new();

/// Starts logging at `level` (`info`, `warn`) unless `RUST_LOG` says otherwise.
pub fn start(level: &str) {
    // The network library explains every reconnect; its errors reach the person through ours.
    let default = || EnvFilter::new(format!("{level},zenoh=off"));
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| default());
    let colour = io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none();
    let started = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(AboveBars)
        .with_ansi(colour)
        .with_target(false)
        .try_init();
    if started.is_err() {
        tracing::debug!("logging was started by the embedding program");
    }
}

/// Returns the bars of this process.
pub fn bars() -> &'static MultiProgress {
    BARS.get_or_init(MultiProgress::new)
}

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
        bars().suspend(|| io::stderr().lock().write_all(bytes))?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().lock().flush()
    }
}
