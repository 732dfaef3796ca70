//! The program as a value: what it can train on, and one door into it.

use std::process;

use clap::Parser as _;
use leadtime_proto::text::printable;
use leadtime_runs::Tasks;
use leadtime_sims::{Environment, TaskError};

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

    /// Adds a task: `name` becomes a domain like the built-in ones, for learner, actors and evaluation alike.
    ///
    /// `builder` gets the task's settings as JSON: `{"world": ..., "human": ..., "notifier": ...}` as configured.
    pub fn with_task<F>(mut self, name: &str, builder: F) -> Self
    where
        F: Fn(&str) -> Result<Box<dyn Environment>, TaskError> + Send + Sync + 'static,
    {
        self.tasks = self.tasks.with(name, builder);
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
        let done = match Cli::try_parse() {
            Ok(cli) => commands::dispatch(&self.tasks, cli.command),
            Err(answer) => refuse(&answer),
        };
        // The command's own failure says more than one to write its output.
        let written = output::finish();
        let done = done.and(written);
        let Failure { code, error } = done.err().unwrap_or(Failure::silent(ExitCode::Done));
        error.iter().for_each(output::error);
        process::ExitCode::from(code as u8)
    }
}

/// Prints what the command line is answered with instead of a command: help, version, or what is wrong with it.
fn refuse(answer: &clap::Error) -> Result<(), Failure> {
    if !answer.use_stderr() {
        output::keep(answer.print());
        return Ok(());
    }
    let text = answer.to_string();
    // It quotes what was typed.
    if printable(&text) != text.trim_end() || answer.print().is_err() {
        output::say(&printable(&text));
    }
    Err(Failure::silent(ExitCode::WrongInput))
}
