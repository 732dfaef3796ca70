//! What can be trained on: the worlds that build environments, and the configurations that come with them.

use std::io;
use std::path::{Path, PathBuf};

use leadtime_config::{Catalog, Config, ConfigError, ConfigSource, Layer};
use leadtime_proto::phrase::no_such;
use leadtime_proto::{EnvId, TaskSpec};
use leadtime_sims::{DomainEntry, EpisodeSeed, Fact, Registry};
use leadtime_worker::Workers;
use thiserror::Error;

use crate::regular;

/// Why a configuration cannot be loaded.
#[derive(Debug, Error)]
pub enum ConfigureError {
    /// There is neither a file nor a built-in configuration of that name.
    #[error("{0}")]
    NotFound(String),
    /// The file cannot be read.
    #[error("reading {}", file.display())]
    Read {
        /// The file that was to be read.
        file: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The configuration is refused.
    #[error(transparent)]
    Config(#[from] ConfigError),
}

/// Every task that the commands know, by name.
#[derive(Clone, Debug)]
pub struct Tasks {
    /// Builds the environments.
    pub registry: Registry,
    /// The built-in configurations.
    pub catalog: Catalog,
    /// The processes that step worlds in Python, and what may be executed for them: nothing, unless a command says so.
    pub workers: Workers,
}

impl Default for Tasks {
    fn default() -> Self {
        Self::new()
    }
}

impl Tasks {
    /// Returns the built-in tasks.
    pub fn new() -> Self {
        let workers = Workers::default();
        let registry = leadtime_worlds::builtin().with_domain(leadtime_worker::entry(&workers));
        Self { registry, catalog: Catalog::built_in(), workers }
    }

    /// Adds a task with its own default settings over the general ones.
    pub fn with_domain(mut self, entry: DomainEntry) -> Self {
        let name = entry.name().to_owned();
        self.catalog.add(&name, &format!("domain = \"{name}\"\n"));
        if let Some(sections) = entry.defaults() {
            self.catalog.add_defaults(&name, &sections);
        }
        self.registry = self.registry.with_domain(entry);
        self
    }

    /// Tells whether a domain comes with the program.
    pub fn is_built_in(domain: &str) -> bool {
        leadtime_worlds::builtin().names().any(|known| known == domain)
    }

    /// Loads a configuration: a file, or the built-in one of that name, with the changes of `source`.
    ///
    /// # Errors
    ///
    /// [`ConfigureError`] if there is no such file or configuration, or if it is refused.
    pub fn configure(
        &self,
        file: Option<&Path>,
        source: ConfigSource,
    ) -> Result<Config, ConfigureError> {
        let file = file.map(|file| self.read(file)).transpose()?;
        Ok(Config::load(&ConfigSource { file, ..source }, &self.catalog, &self.registry)?)
    }

    fn read(&self, file: &Path) -> Result<Layer, ConfigureError> {
        let built_in = file.to_str().and_then(|name| self.catalog.file(name));
        match (regular::read_to_string(file), built_in) {
            (Ok(text), _) => Ok(Layer::text(format!("configuration {}", file.display()), text)),
            (Err(_), Some(built_in)) => Ok(built_in),
            (Err(error), None) if error.kind() == io::ErrorKind::NotFound => {
                let names: Vec<&str> = self.catalog.names().collect();
                let name = file.to_string_lossy();
                Err(ConfigureError::NotFound(no_such("file or configuration", &name, names)))
            }
            (Err(source), None) => Err(ConfigureError::Read { file: file.to_owned(), source }),
        }
    }

    /// Names the topics of a task in the order of their ids; none if nobody speaks in it, or if it cannot be built.
    pub fn topics(&self, task: &TaskSpec) -> Vec<&'static str> {
        let Ok(mut environment) = self.registry.build(task) else { return Vec::new() };
        let mut observation = vec![0.0; environment.spec().obs_dim];
        let first = EpisodeSeed { run_seed: 0, env_id: EnvId(0), episode: 0 };
        environment.reset(first, &mut observation);
        environment.scene().map(|scene| scene.listener.topics).unwrap_or_default()
    }

    /// Lists the facts that a task tells; none if it tells none, or if it cannot be built.
    pub fn facts(&self, task: &TaskSpec) -> Vec<Fact> {
        self.registry.build(task).map(|environment| environment.facts()).unwrap_or_default()
    }
}
