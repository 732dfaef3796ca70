//! From a task's name and settings to an environment: what every process does before the first step.
//!
//! A [`TaskSpec`] travels between processes as a name and JSON text. Each world exports one [`DomainEntry`]; the crate
//! above the worlds registers them, and a user's own domain joins by [`Registry::with`], in every process that steps it.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use leadtime_proto::TaskSpec;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::check::SettingError;
use crate::environment::{Environment, TwoPlayers};
use crate::error::TaskError;
use crate::notifier::{NotifierWorld, PlayedByTwo, TaskSettings};

/// Makes an environment from settings, given as JSON text.
type Builder = Arc<dyn Fn(&str) -> Result<Box<dyn Environment>, TaskError> + Send + Sync>;

/// Makes a task for two from the same settings.
type PairBuilder = Arc<dyn Fn(&str) -> Result<Box<dyn TwoPlayers>, TaskError> + Send + Sync>;

/// Writes into settings what only the task itself can say; `None` if nothing is missing.
type SettingsCompleter = Arc<dyn Fn(&str) -> Result<Option<String>, TaskError> + Send + Sync>;

/// The settings of a task that has nothing but a world.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WorldOnly<W: Default> {
    /// The only section that such a task has.
    pub world: W,
}

/// Everything that the rest of the program knows of a task: its name, how it is built and how it is evaluated.
#[derive(Clone)]
pub struct DomainEntry {
    name: String,
    builder: Builder,
    /// Where the listener can be played, too.
    pair_builder: Option<PairBuilder>,
    completer: Option<SettingsCompleter>,
    /// Its settings with their defaults, where the entry knows their type.
    defaults: Option<fn() -> Value>,
    /// Keys of `[world]` that differ while a policy is evaluated, as TOML.
    evaluation: &'static str,
    has_map: bool,
}

impl fmt::Debug for DomainEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("DomainEntry").field("name", &self.name).finish_non_exhaustive()
    }
}

impl DomainEntry {
    /// Describes a task that reads its settings itself: `builder` gets them as JSON,
    /// `{"world": ..., "human": ..., "notifier": ...}` as configured.
    pub fn from_builder<F>(name: &str, builder: F) -> Self
    where
        F: Fn(&str) -> Result<Box<dyn Environment>, TaskError> + Send + Sync + 'static,
    {
        let builder: Builder = Arc::new(builder);
        Self {
            name: name.to_owned(),
            builder,
            pair_builder: None,
            completer: None,
            defaults: None,
            evaluation: "",
            has_map: false,
        }
    }

    /// Says how settings are completed before they are kept and sent: with what has to be found out once and then holds for
    /// all processes of a run.
    pub fn completed_by<F>(mut self, complete: F) -> Self
    where
        F: Fn(&str) -> Result<Option<String>, TaskError> + Send + Sync + 'static,
    {
        self.completer = Some(Arc::new(complete));
        self
    }

    /// Describes the notifier task of a world.
    pub fn notifier<W: NotifierWorld>(name: &'static str) -> Self {
        let build = move |settings: &str| {
            let settings: TaskSettings<W> = read(name, settings)?;
            Ok(Box::new(settings.build()?) as Box<dyn Environment>)
        };
        let build_pair: PairBuilder = Arc::new(move |settings| {
            let settings: TaskSettings<W> = read(name, settings)?;
            Ok(Box::new(PlayedByTwo::new(settings.build()?)))
        });
        Self {
            defaults: Some(defaults::<TaskSettings<W>>),
            pair_builder: Some(build_pair),
            ..Self::from_builder(name, build)
        }
    }

    /// Describes a task without a listener, which has nothing but a world.
    pub fn world_only<W, E>(name: &'static str, make: fn(&W) -> Result<E, SettingError>) -> Self
    where
        W: Default + Serialize + DeserializeOwned + 'static,
        E: Environment + 'static,
    {
        let build = move |settings: &str| {
            let settings: WorldOnly<W> = read(name, settings)?;
            Ok(Box::new(make(&settings.world)?) as Box<dyn Environment>)
        };
        Self { defaults: Some(defaults::<WorldOnly<W>>), ..Self::from_builder(name, build) }
    }

    /// Returns the task's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the task's settings with their defaults, by section; `None` if only its builder knows them.
    pub fn defaults(&self) -> Option<Value> {
        self.defaults.map(|defaults| defaults())
    }

    /// Sets what differs of `[world]` while a policy is evaluated, as TOML: `max_steps = 7`.
    pub fn evaluated_with(mut self, world: &'static str) -> Self {
        self.evaluation = world;
        self
    }

    /// Says that the scenes are maps with zones, over which trajectories can be drawn.
    pub fn drawn_on_a_map(mut self) -> Self {
        self.has_map = true;
        self
    }
}

/// Writes down the defaults of settings.
fn defaults<S: Default + Serialize>() -> Value {
    // Settings are plain data, which can always be written.
    serde_json::to_value(S::default()).unwrap_or_default()
}

/// The tasks that a process can build.
#[derive(Clone, Debug, Default)]
pub struct Registry {
    entries: BTreeMap<String, DomainEntry>,
}

impl Registry {
    /// Adds a task, or replaces the one of that name.
    pub fn with_domain(mut self, entry: DomainEntry) -> Self {
        self.entries.insert(entry.name.clone(), entry);
        self
    }

    /// Adds a task that reads its settings itself, or replaces the one of that name.
    ///
    /// # Example
    ///
    /// ```
    /// use leadtime_proto::TaskSpec;
    /// use leadtime_sims::Registry;
    /// use leadtime_sims::classic::{CartPole, CartPoleSettings};
    ///
    /// let registry = Registry::default().with("short_pole", |_settings| {
    ///     Ok(Box::new(CartPole::new(&CartPoleSettings { max_steps: 20 })?))
    /// });
    /// let task = TaskSpec { domain: "short_pole".to_owned(), settings: "{}".to_owned() };
    /// assert_eq!(registry.build(&task)?.spec().obs_dim, 4);
    /// # Ok::<(), leadtime_sims::TaskError>(())
    /// ```
    pub fn with<F>(self, name: &str, builder: F) -> Self
    where
        F: Fn(&str) -> Result<Box<dyn Environment>, TaskError> + Send + Sync + 'static,
    {
        self.with_domain(DomainEntry::from_builder(name, builder))
    }

    /// Lists the names of the tasks, in alphabetical order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.entries.keys().map(String::as_str)
    }

    /// Returns whether the scenes of a domain are maps with zones, over which trajectories can be drawn.
    pub fn has_map(&self, domain: &str) -> bool {
        self.entries.get(domain).is_some_and(|entry| entry.has_map)
    }

    /// Returns whether a task may have to find out what it is before it is built.
    pub fn asks(&self, domain: &str) -> bool {
        self.entries.get(domain).is_some_and(|entry| entry.completer.is_some())
    }

    /// Returns a task with complete settings, where something is missing that only the task itself can say.
    ///
    /// # Errors
    ///
    /// [`TaskError`] if the settings are wrong, or what is missing cannot be found out.
    pub fn complete(&self, task: &TaskSpec) -> Result<Option<TaskSpec>, TaskError> {
        let completer = self.entries.get(&task.domain).and_then(|it| it.completer.as_ref());
        let Some(complete) = completer else { return Ok(None) };
        let settings = complete(&task.settings)?;
        Ok(settings.map(|settings| TaskSpec { settings, ..task.clone() }))
    }

    /// Builds the environment of a task; it must be reset before the first step.
    ///
    /// # Errors
    ///
    /// [`TaskError`] if no world has that name, if a key is unknown or of the wrong type, or if a value is out of its
    /// range. It names the key, what was given and what is allowed.
    pub fn build(&self, task: &TaskSpec) -> Result<Box<dyn Environment>, TaskError> {
        let Some(entry) = self.entries.get(&task.domain) else {
            let known = self.names().map(str::to_owned).collect();
            return Err(TaskError::UnknownDomain { domain: task.domain.clone(), known });
        };
        let environment = (entry.builder)(&task.settings)?;
        environment.spec().check()?;
        Ok(environment)
    }

    /// Builds a task for two, in which the listener is played, too; `None` if there is no listener in it.
    ///
    /// # Errors
    ///
    /// [`TaskError`] if no world has that name, or its settings are wrong, as for [`Registry::build`].
    pub fn build_pair(&self, task: &TaskSpec) -> Result<Option<Box<dyn TwoPlayers>>, TaskError> {
        let builder = self.entries.get(&task.domain).and_then(|entry| entry.pair_builder.as_ref());
        let Some(build) = builder else {
            // A setting that is wrong is reported all the same.
            return self.build(task).map(|_| None);
        };
        build(&task.settings).map(Some)
    }

    /// Returns what differs of a task's `[world]` while a policy is evaluated, as TOML; what a user sets in
    /// `[evaluation.world]` comes on top.
    pub fn evaluation_world(&self, domain: &str) -> &'static str {
        self.entries.get(domain).map_or("", |entry| entry.evaluation)
    }
}

/// Reads a domain's settings; for builders.
///
/// # Errors
///
/// [`TaskError::Settings`] naming the key that is unknown or of the wrong type, and where it stands.
pub fn read<T: DeserializeOwned>(domain: &'static str, settings: &str) -> Result<T, TaskError> {
    serde_json::from_str(settings).map_err(|fault| TaskError::Settings { domain, fault })
}
