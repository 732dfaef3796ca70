//! The program as a value: what it can train on, and one door into it.

use std::path::Path;
use std::{fs, io, process};

use anyhow::Context as _;
use clap::Parser as _;
use leadtime_config::{Catalog, Config, ConfigSource, Layer};
use leadtime_eval::measure::episode_seed;
use leadtime_proto::TaskSpec;
use leadtime_proto::text::printable;
use leadtime_sims::Environment;
use leadtime_sims::registry::{Registry, TaskError};

use crate::cli::{Cli, SourceArgs};
use crate::commands;
use crate::exit::{ExitCode, Failure};
use crate::{output, threads};

/// The `leadtime` program, perhaps with tasks of the user's own.
///
/// # Example
///
/// ```no_run
/// fn main() -> std::process::ExitCode {
///     leadtime::Program::new().run()
/// }
/// ```
#[derive(Debug)]
pub struct Program {
    pub(crate) registry: Registry,
    pub(crate) catalog: Catalog,
}

impl Default for Program {
    fn default() -> Self {
        Self::new()
    }
}

impl Program {
    /// Makes the program with its built-in tasks.
    pub fn new() -> Self {
        Self { registry: Registry::builtin(), catalog: Catalog::built_in() }
    }

    /// Adds a task: `name` becomes a domain like the built-in ones, for learner, actors and evaluation alike.
    ///
    /// `builder` gets the task's settings as JSON: `{"world": ..., "human": ..., "notifier": ...}` as configured.
    pub fn with_task<F>(mut self, name: &str, builder: F) -> Self
    where
        F: Fn(&str) -> Result<Box<dyn Environment>, TaskError> + Send + Sync + 'static,
    {
        self.registry = self.registry.with(name, builder);
        self.catalog.add(name, &format!("domain = \"{name}\"\n"));
        self
    }

    /// Gives an added task default settings of its own, laid over the general ones; `leadtime config NAME` prints them.
    pub fn with_defaults(mut self, name: &str, defaults: &str) -> Self {
        self.catalog.add(name, defaults);
        self
    }

    /// Loads a configuration: the file, or the built-in one of that name, with the changes of the command line.
    ///
    /// # Errors
    ///
    /// If there is no such file or configuration, or if it is refused.
    pub(crate) fn configure(
        &self,
        args: &SourceArgs,
        name: Option<&str>,
    ) -> anyhow::Result<Config> {
        let file = args.config.as_deref().map(|file| self.read(file)).transpose()?;
        let SourceArgs { set, seed, runs, .. } = args.clone();
        let source = ConfigSource { file, set, seed, runs, name: name.map(str::to_owned) };
        Ok(Config::load(&source, &self.catalog, &self.registry)?)
    }

    /// Reads a configuration file, or finds the built-in configuration of that name.
    fn read(&self, file: &Path) -> anyhow::Result<Layer> {
        let shown = file.display();
        let built_in = file.to_str().and_then(|name| self.catalog.file(Some(name)));
        match (fs::read_to_string(file), built_in) {
            (Ok(text), _) => Ok(Layer::text(format!("configuration {shown}"), text)),
            (Err(_), Some(built_in)) => Ok(built_in),
            (Err(error), None) if error.kind() == io::ErrorKind::NotFound => {
                let names: Vec<&str> = self.catalog.names().collect();
                let names = names.join(", ");
                anyhow::bail!("there is no file {shown}; built-in configurations: {names}")
            }
            (Err(error), None) => Err(error).with_context(|| format!("reading {shown}")),
        }
    }

    /// Names the topics of a task in the order of their ids; none if nobody speaks in it, or if it cannot be built.
    pub(crate) fn topics(&self, task: &TaskSpec) -> Vec<&'static str> {
        let Ok(mut environment) = self.registry.build(task) else { return Vec::new() };
        let mut observation = vec![0.0; environment.spec().obs_dim];
        environment.reset(episode_seed(0, 0), &mut observation);
        environment.scene().map(|scene| scene.listener.topics).unwrap_or_default()
    }

    /// Reads the command line, does what it says, and returns the exit code.
    pub fn run(self) -> process::ExitCode {
        threads::pin();
        let cli = match Cli::try_parse() {
            Ok(cli) => cli,
            Err(error) => return usage(&error),
        };
        let code = match commands::dispatch(&self, cli.command) {
            Ok(()) => ExitCode::Done,
            Err(Failure { code, error }) => {
                if let Some(error) = error {
                    output::say(&printable(&format!("error: {error:#}")));
                }
                code
            }
        };
        code.into()
    }
}

/// Prints help, or what is wrong with the command line, which quotes what was typed.
fn usage(error: &clap::Error) -> process::ExitCode {
    let text = error.to_string();
    if error.use_stderr() && printable(&text) != text.trim_end() {
        output::say(&printable(&text));
    } else if error.print().is_err() {
        return ExitCode::WrongInput.into();
    }
    process::ExitCode::from(error.exit_code() as u8)
}
