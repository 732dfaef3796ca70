//! The program as a value: what it can train on, and one door into it.

use std::process;

use clap::Parser as _;
use leadtime_eval::measure::episode_seed;
use leadtime_proto::TaskSpec;
use leadtime_sims::Environment;
use leadtime_sims::registry::{Registry, TaskError};

use crate::cli::Cli;
use crate::commands;
use crate::config::Catalog;
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
        let cli = Cli::parse();
        let code = match commands::dispatch(&self, cli.command) {
            Ok(()) => ExitCode::Done,
            Err(Failure { code, error }) => {
                if let Some(error) = error {
                    output::say(&format!("error: {error:#}"));
                }
                code
            }
        };
        code.into()
    }
}
