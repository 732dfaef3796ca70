//! How much is said on standard error, and how.

use std::ffi::OsString;
use std::path::PathBuf;

use clap::{Args, ValueEnum};

/// The place in the help of what every command takes: after its own options, however many they are.
const AT_THE_END: usize = 900;

/// How the log is written.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct LogArgs {
    /// How lines of the log are written.
    #[arg(long, global = true, value_name = "FORMAT", value_enum, default_value_t)]
    #[arg(display_order = AT_THE_END + 2)]
    pub log_format: LogFormat,
    /// Write the log to the end of this file instead of standard error. It is opened again when it was moved away, and on
    /// SIGHUP.
    #[arg(long, global = true, value_name = "FILE", display_order = AT_THE_END + 3)]
    pub log_file: Option<PathBuf>,
}

/// How lines of the log are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum LogFormat {
    /// For people.
    #[default]
    Text,
    /// One JSON object per line: time, level, target, message, run, actor, fields.
    Json,
}

impl LogArgs {
    /// Returns the options that give another process of ours the same.
    pub(crate) fn options(&self) -> Vec<OsString> {
        let is_json = self.log_format == LogFormat::Json;
        let format: Option<[OsString; 2]> = is_json.then(|| ["--log-format".into(), "json".into()]);
        let file = self.log_file.as_ref().map(|file| ["--log-file".into(), file.into()]);
        format.into_iter().chain(file).flatten().collect()
    }
}

/// How much is said on standard error.
#[derive(Clone, Copy, Debug, Args)]
pub(crate) struct Verbosity {
    /// Say nothing but warnings and results.
    #[arg(short, long, global = true, conflicts_with = "verbose", display_order = AT_THE_END)]
    pub quiet: bool,
    /// Also say what helps to find out why something goes wrong.
    #[arg(short, long, global = true, display_order = AT_THE_END + 1)]
    pub verbose: bool,
}

impl Verbosity {
    /// Returns the options that give another process of ours the same.
    pub(crate) fn options(self) -> &'static [&'static str] {
        match (self.quiet, self.verbose) {
            (true, _) => &["--quiet"],
            (_, true) => &["--verbose"],
            _ => &[],
        }
    }
}
