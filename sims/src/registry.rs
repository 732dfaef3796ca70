//! From a task's name and settings to an environment: what every process does before the first step.
//!
//! A [`TaskSpec`] travels between processes as a name and JSON text. [`Registry::builtin`] knows the tasks of this
//! crate; a user's own domain joins by [`Registry::with`], in every process that steps it.
//!
//! | name | task | settings |
//! |---|---|---|
//! | `cartpole` | [`classic::CartPole`] | `{"world": CartPoleSettings}` |
//! | `lander` | [`NotifierEnv`] over [`Piloting`] | [`PilotingSettings`] |
//! | `highway` | [`NotifierEnv`] over [`Driving`] | [`DrivingSettings`] |
//! | `pilot` | [`PilotTask`] | `{"world": PilotTaskSettings}` |
//! | `cue_recall` | [`classic::CueRecall`] | `{"world": CueRecallSettings}` |
//! | `steakhouse` | [`NotifierEnv`] over [`Cooking`] | [`CookingSettings`] |

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use leadtime_proto::TaskSpec;
use leadtime_proto::spec::SpecError;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::classic;
use crate::cooking::{Cooking, CookingSettings};
use crate::driving::{Driving, DrivingSettings};
use crate::environment::Environment;
use crate::lander::{PilotTask, PilotTaskSettings};
use crate::notifier::NotifierEnv;
use crate::piloting::{Piloting, PilotingSettings};
use crate::setting::SettingError;

/// Why a task cannot be built.
#[derive(Debug, Error)]
pub enum TaskError {
    /// No task of that name.
    #[error("there is no domain `{domain}`; known: {}", known.join(", "))]
    UnknownDomain {
        /// As asked for.
        domain: String,
        /// What there is.
        known: Vec<String>,
    },
    /// The settings are not of the right form: an unknown key, a wrong type.
    #[error("settings of domain `{domain}` cannot be read: {source}")]
    Settings {
        /// The domain.
        domain: &'static str,
        /// Which key, and what is allowed.
        source: serde_json::Error,
    },
    /// A well-formed setting that is impossible.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// An action space that is impossible, for instance with too many choices.
    #[error("the task's action space is impossible")]
    Actions(#[from] SpecError),
}

/// Makes an environment from settings, given as JSON text.
pub type Builder = Arc<dyn Fn(&str) -> Result<Box<dyn Environment>, TaskError> + Send + Sync>;

/// Turns a task's settings for training into those for evaluation, both as JSON text.
type ForEvaluation = fn(&str) -> Result<String, TaskError>;

/// The settings of a task that has nothing but a world.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WorldOnly<W: Default> {
    /// The world.
    pub world: W,
}

/// The tasks that a process can build.
#[derive(Clone)]
pub struct Registry {
    builders: BTreeMap<String, Builder>,
    for_evaluation: BTreeMap<String, ForEvaluation>,
}

impl fmt::Debug for Registry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.builders.keys()).finish()
    }
}

impl Registry {
    /// Knows the tasks of this crate.
    pub fn builtin() -> Self {
        let none = Self { builders: BTreeMap::new(), for_evaluation: BTreeMap::new() };
        let mut registry = none
            .with("lander", |settings| {
                let PilotingSettings { world, human, notifier } = read("lander", settings)?;
                Ok(Box::new(NotifierEnv::new(Piloting::new(&world)?, &human, &notifier)?))
            })
            .with("steakhouse", |settings| {
                let CookingSettings { world, human, notifier } = read("steakhouse", settings)?;
                Ok(Box::new(NotifierEnv::new(Cooking::new(&world)?, &human, &notifier)?))
            })
            .with("highway", |settings| {
                let DrivingSettings { world, human, notifier } = read("highway", settings)?;
                Ok(Box::new(NotifierEnv::new(Driving::new(&world)?, &human, &notifier)?))
            })
            .with("pilot", |settings| {
                let settings: WorldOnly<PilotTaskSettings> = read("pilot", settings)?;
                Ok(Box::new(PilotTask::new(&settings.world)?))
            })
            .with("cartpole", |settings| {
                let settings: WorldOnly<classic::CartPoleSettings> = read("cartpole", settings)?;
                Ok(Box::new(classic::CartPole::new(&settings.world)?))
            })
            .with("cue_recall", |settings| {
                let settings: WorldOnly<classic::CueRecallSettings> = read("cue_recall", settings)?;
                Ok(Box::new(classic::CueRecall::new(&settings.world)?))
            });
        registry.for_evaluation.insert("lander".to_owned(), evaluate_piloting);
        registry.for_evaluation.insert("highway".to_owned(), evaluate_driving);
        registry
    }

    /// Adds a task, or replaces the one of that name.
    ///
    /// # Example
    ///
    /// ```
    /// use leadtime_proto::TaskSpec;
    /// use leadtime_sims::Registry;
    /// use leadtime_sims::classic::{CartPole, CartPoleSettings};
    ///
    /// let registry = Registry::builtin().with("short_pole", |_settings| {
    ///     Ok(Box::new(CartPole::new(&CartPoleSettings { max_steps: 20 })?))
    /// });
    /// let task = TaskSpec { domain: "short_pole".to_owned(), settings: "{}".to_owned() };
    /// assert_eq!(registry.build(&task)?.spec().obs_dim, 4);
    /// # Ok::<(), leadtime_sims::TaskError>(())
    /// ```
    pub fn with<F>(mut self, name: &str, builder: F) -> Self
    where
        F: Fn(&str) -> Result<Box<dyn Environment>, TaskError> + Send + Sync + 'static,
    {
        self.builders.insert(name.to_owned(), Arc::new(builder));
        self.for_evaluation.remove(name);
        self
    }

    /// Lists the names of the tasks, in alphabetical order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.builders.keys().map(String::as_str)
    }

    /// Builds the environment of a task; it must be reset before the first step.
    ///
    /// # Errors
    ///
    /// [`TaskError`] naming the key, what was given and what is allowed.
    pub fn build(&self, task: &TaskSpec) -> Result<Box<dyn Environment>, TaskError> {
        let Some(builder) = self.builders.get(&task.domain) else {
            let known = self.names().map(str::to_owned).collect();
            return Err(TaskError::UnknownDomain { domain: task.domain.clone(), known });
        };
        let environment = builder(&task.settings)?;
        environment.spec().actions.check()?;
        Ok(environment)
    }

    /// Returns the task as a policy is measured in it, where that differs from how it is trained.
    ///
    /// # Errors
    ///
    /// [`TaskError`] if the settings cannot be read.
    pub fn for_evaluation(&self, task: &TaskSpec) -> Result<TaskSpec, TaskError> {
        let settings = match self.for_evaluation.get(&task.domain) {
            Some(convert) => convert(&task.settings)?,
            None => task.settings.clone(),
        };
        Ok(TaskSpec { domain: task.domain.clone(), settings })
    }
}

fn evaluate_piloting(settings: &str) -> Result<String, TaskError> {
    let settings: PilotingSettings = read("lander", settings)?;
    serde_json::to_string(&settings.for_evaluation())
        .map_err(|source| TaskError::Settings { domain: "lander", source })
}

fn evaluate_driving(settings: &str) -> Result<String, TaskError> {
    let settings: DrivingSettings = read("highway", settings)?;
    serde_json::to_string(&settings.for_evaluation())
        .map_err(|source| TaskError::Settings { domain: "highway", source })
}

/// Builds the environment of one of the built-in tasks.
///
/// # Errors
///
/// As [`Registry::build`].
pub fn build(task: &TaskSpec) -> Result<Box<dyn Environment>, TaskError> {
    Registry::builtin().build(task)
}

/// Reads a domain's settings; for builders.
///
/// # Errors
///
/// [`TaskError::Settings`] naming the key that is unknown or of the wrong type, and where it stands.
pub fn read<T: DeserializeOwned>(domain: &'static str, settings: &str) -> Result<T, TaskError> {
    serde_json::from_str(settings).map_err(|source| TaskError::Settings { domain, source })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refuse(domain: &str, settings: &str) -> String {
        let task = TaskSpec { domain: domain.to_owned(), settings: settings.to_owned() };
        build(&task).err().expect("the task is refused").to_string()
    }

    #[test]
    fn every_builtin_task_has_a_default() {
        let registry = Registry::builtin();
        for name in registry.names() {
            let task = TaskSpec { domain: name.to_owned(), settings: "{}".to_owned() };
            let environment = registry.build(&task).unwrap();
            assert!(environment.spec().obs_dim > 0, "{name}");
        }
    }

    #[test]
    fn what_cannot_be_built_says_why() {
        let text = refuse("lunar", "{}");
        assert!(
            text.starts_with(
                "there is no domain `lunar`; known: cartpole, cue_recall, highway, lander, pilot, \
                 steakhouse"
            ),
            "{text}"
        );
        let text = refuse("cartpole", r#"{"world": {"max_step": 5}}"#);
        assert!(text.contains("unknown field `max_step`, expected `max_steps`"), "{text}");
        let text = refuse("cartpole", r#"{"human": {}}"#);
        assert!(text.contains("unknown field `human`, expected `world`"), "{text}");
        let text = refuse("cartpole", r#"{"world": {"max_steps": 0}}"#);
        assert_eq!(text, "`world.max_steps` is 0; allowed: 1 to 100000 steps");
        let text = refuse("lander", r#"{"notifier": {"topics": []}}"#);
        assert!(
            text.starts_with("`notifier.topics` is []; allowed: at least one of ascend"),
            "{text}"
        );
        let text = refuse("lander", r#"{"human": {"reaction_delay": {"fixed": "two"}}}"#);
        assert!(text.contains("invalid type: string \"two\", expected u32"), "{text}");
        let words: Vec<u32> = (1..40).collect();
        let text = refuse("lander", &format!(r#"{{"notifier": {{"words": {words:?}}}}}"#));
        assert!(text.contains("action space is impossible"), "{text}");
    }

    #[test]
    fn evaluation_lets_an_episode_go_on_after_a_zone() {
        let registry = Registry::builtin();
        let task = |domain: &str, settings: &str| TaskSpec {
            domain: domain.to_owned(),
            settings: settings.to_owned(),
        };
        let lander = task("lander", r#"{"world": {"max_steps": 7}}"#);
        let settings = registry.for_evaluation(&lander).unwrap().settings;
        let settings: PilotingSettings = serde_json::from_str(&settings).unwrap();
        assert_eq!((settings.world.zone_ends_episode, settings.world.max_steps), (false, 7));
        let pole = task("cartpole", "{}");
        assert_eq!(registry.for_evaluation(&pole).unwrap(), pole);
    }
}
