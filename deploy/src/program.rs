//! The program as a value: what it can train on, and one door into it.

use std::{env, process};

use clap::error::{ContextKind, ContextValue};
use leadtime_proto::text::printable;
use leadtime_runs::Tasks;
use leadtime_sims::DomainEntry;

use crate::cli::Cli;
use crate::exit::{ExitCode, Failure};
use crate::{commands, crash, output, threads};

/// The `leadtime` program, perhaps with tasks of the user's own.
///
/// # Example
///
/// ```no_run
/// fn main() -> std::process::ExitCode {
///     leadtime::Program::new().run()
/// }
/// ```
#[derive(Debug, Default)]
pub struct Program {
    tasks: Tasks,
}

impl Program {
    /// Makes the program with its built-in tasks.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a world: it becomes a domain like the built-in ones, for learner, actors and evaluation alike.
    ///
    /// `leadtime config NAME` prints the defaults of its settings, and `leadtime check -c NAME` plays it and reports what
    /// breaks the promise of equal bits.
    pub fn with_domain(mut self, entry: DomainEntry) -> Self {
        self.tasks = self.tasks.with_domain(entry);
        self
    }

    /// Gives an added task default settings of its own, laid over the general ones; `leadtime config NAME` prints them.
    pub fn with_defaults(mut self, name: &str, defaults: &str) -> Self {
        self.tasks.catalog.add(name, defaults);
        self
    }

    /// Reads the command line, does what it says, and returns the exit code.
    pub fn run(self) -> process::ExitCode {
        crash::end_on_panic();
        threads::pin();
        let done = match Cli::read() {
            Ok(cli) => commands::dispatch(&self.tasks, cli),
            Err(answer) => refuse(&answer, &self.tasks),
        };
        // The command's own failure says more than one to write its output.
        let written = output::finish();
        let done = done.and(written);
        let Failure { mut code, error } = done.err().unwrap_or(Failure::silent(ExitCode::Done));
        if let Some(error) = error {
            let message = format!("{error:#}");
            if crash::is_about_files(&message) {
                code = ExitCode::WrongInput;
            }
            output::error(&crash::with_remedy(message));
        }
        process::ExitCode::from(code as u8)
    }
}

/// Finds the setting that an unknown option was meant for: `learner.learning_rate=1e-4` for `--learning-rate 1e-4`.
fn meant_setting(
    answer: &clap::Error,
    tasks: &Tasks,
    args: impl Iterator<Item = String>,
) -> Option<String> {
    let args: Vec<String> = args.collect();
    let root = Cli::documented();
    let command = args.iter().fold(&root, |at, arg| at.find_subcommand(arg).unwrap_or(at));
    command.get_arguments().find(|option| option.get_long() == Some("set"))?;
    let ContextValue::String(option) = answer.get(ContextKind::InvalidArg)? else { return None };
    let name = option.trim_start_matches('-').split('=').next()?.replace('-', "_");
    let key = tasks.catalog.key(&name)?;
    let mut given =
        args.into_iter().skip_while(|arg| arg.split('=').next() != option.split('=').next());
    let here = given.next()?;
    let value = here.split_once('=').map(|(_, value)| value.to_owned()).or_else(|| given.next());
    Some(format!("{key}={}", value.unwrap_or_else(|| "VALUE".to_owned())))
}

/// Prints what the command line is answered with instead of a command: help, version, or what is wrong with it.
fn refuse(answer: &clap::Error, tasks: &Tasks) -> Result<(), Failure> {
    if !answer.use_stderr() {
        output::keep(answer.print());
        return Ok(());
    }
    let text = answer.to_string();
    // It quotes what was typed.
    if printable(&text) != text.trim_end() || answer.print().is_err() {
        output::say(&printable(&text));
    }
    let args = env::args_os().map(|arg| arg.to_string_lossy().into_owned());
    if let Some(setting) = meant_setting(answer, tasks, args) {
        output::say(&format!("\n  tip: settings are changed by '--set {}'", printable(&setting)));
    }
    Err(Failure::silent(ExitCode::WrongInput))
}
