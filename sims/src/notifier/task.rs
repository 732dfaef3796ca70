//! A notifier task as it is configured: a world, and how its listener and its notifier differ from the general ones.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer, Serialize};

use super::environment::NotifierEnv;
use super::settings::NotifierSettings;
use crate::Domain;
use crate::check::{SettingError, read_over};
use crate::error::TaskError;
use crate::human::HumanSettings;

/// What can be chosen about a world, and what its listener and its notifier are unless something else is given.
pub trait NotifierWorld: Default + Serialize + DeserializeOwned + 'static {
    /// The world that these settings make.
    type Task: Domain + 'static;

    /// Returns the defaults of the listener.
    fn human() -> HumanSettings {
        HumanSettings::default()
    }

    /// Returns the defaults of the notifier.
    fn notifier() -> NotifierSettings {
        NotifierSettings::default()
    }

    /// Makes the world.
    ///
    /// # Errors
    ///
    /// [`SettingError`] if a setting is out of its range, or does not fit another one.
    fn domain(&self) -> Result<Self::Task, SettingError>;
}

/// The settings of a notifier task: `{"world": ..., "human": ..., "notifier": ...}`.
///
/// Keys of the listener and of the notifier that are not given are those of the world ([`NotifierWorld`]), one by one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[serde(bound(serialize = "W: Serialize", deserialize = "W: NotifierWorld"))]
pub struct TaskSettings<W> {
    /// `[world]`: where the task takes place, and what is paid.
    pub world: W,
    /// The listener in it.
    #[serde(deserialize_with = "over_human::<_, W>")]
    pub human: HumanSettings,
    /// What the notifier may say and what it sees.
    #[serde(deserialize_with = "over_notifier::<_, W>")]
    pub notifier: NotifierSettings,
}

impl<W: NotifierWorld> Default for TaskSettings<W> {
    fn default() -> Self {
        Self { world: W::default(), human: W::human(), notifier: W::notifier() }
    }
}

impl<W: NotifierWorld> TaskSettings<W> {
    /// Joins the world with its listener and its notifier.
    ///
    /// # Errors
    ///
    /// [`TaskError`] if a setting of the world, the listener or the notifier is out of its range, or does not fit
    /// another one.
    pub fn build(&self) -> Result<NotifierEnv<W::Task>, TaskError> {
        NotifierEnv::new(self.world.domain()?, &self.human, &self.notifier)
    }
}

fn over_human<'de, D: Deserializer<'de>, W: NotifierWorld>(
    given: D,
) -> Result<HumanSettings, D::Error> {
    read_over(&W::human(), given)
}

fn over_notifier<'de, D: Deserializer<'de>, W: NotifierWorld>(
    given: D,
) -> Result<NotifierSettings, D::Error> {
    read_over(&W::notifier(), given)
}
