//! The program as a value: what it can train on, and one door into it.

use std::{env, process};

use clap::error::{ContextKind, ContextValue, ErrorKind};
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

/// Finds the command that is asked for.
fn command_of<'a>(root: &'a clap::Command, args: &[String]) -> &'a clap::Command {
    args.iter().fold(root, |at, arg| at.find_subcommand(arg).unwrap_or(at))
}

/// Finds the option that a configuration's name was meant for, which was given without one: `-c lander` for `lander`.
fn meant_option(answer: &clap::Error, tasks: &Tasks, args: &[String]) -> Option<String> {
    if answer.kind() != ErrorKind::UnknownArgument {
        return None;
    }
    let ContextValue::String(name) = answer.get(ContextKind::InvalidArg)? else { return None };
    tasks.catalog.names().find(|known| known == name)?;
    let root = Cli::documented();
    let command = command_of(&root, args);
    let has = |long| command.get_arguments().any(|option| option.get_long() == Some(long));
    let options = [("domain", "--domain"), ("config", "-c")];
    let (_, option) = options.into_iter().find(|(long, _)| has(*long))?;
    Some(format!("{option} {name}"))
}

/// Finds the setting that an unknown option was meant for: `learner.learning_rate=1e-4` for `--learning-rate 1e-4`.
fn meant_setting(answer: &clap::Error, tasks: &Tasks, args: Vec<String>) -> Option<String> {
    let root = Cli::documented();
    let command = command_of(&root, &args);
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
    // Help is our own text, and longer than any message. Everything else quotes what was typed.
    let is_help = answer.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand;
    let is_fit = is_help || printable(&text) == text.trim_end();
    if !is_fit || answer.print().is_err() {
        output::say(&printable(&text));
    }
    let args: Vec<String> = env::args_os().map(|arg| arg.to_string_lossy().into_owned()).collect();
    if let Some(option) = meant_option(answer, tasks, &args) {
        output::say(&format!("\n  tip: did you mean '{}'?", printable(&option)));
    } else if let Some(setting) = meant_setting(answer, tasks, args) {
        output::say(&format!("\n  tip: settings are changed by '--set {}'", printable(&setting)));
    }
    Err(Failure::silent(ExitCode::WrongInput))
}
