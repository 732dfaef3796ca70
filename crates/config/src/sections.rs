//! The sections about the task: which a domain has, and of which types.

use leadtime_highway::task::HighwayWorldSettings;
use leadtime_lander::pilot::PilotTaskSettings;
use leadtime_lander::task::LanderWorldSettings;
use leadtime_proto::TaskSpec;
use leadtime_sims::Registry;
use leadtime_sims::classic::{CartPoleSettings, CueRecallSettings};
use leadtime_sims::human::HumanSettings;
use leadtime_sims::notifier::NotifierSettings;
use leadtime_sims::registry::WorldOnly;
use leadtime_steakhouse::task::SteakhouseWorldSettings;
use leadtime_worker::{DOMAIN, PythonSettings};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use toml::Table;
use toml::de::{DeTable, DeValue};

use crate::error::ConfigError;
use crate::layers::Layers;

/// The sections that differ from domain to domain.
pub(crate) const SECTIONS: [&str; 3] = ["world", "human", "notifier"];

/// A task as configured.
#[derive(Debug)]
pub(crate) struct Task {
    /// Its sections, with every key that has a default.
    pub(crate) table: Table,
    /// The same as actors get them.
    pub(crate) spec: TaskSpec,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct NotifierSections<W> {
    world: W,
    human: HumanSettings,
    notifier: NotifierSettings,
}

/// Takes a task's sections out of a merged configuration.
pub(crate) fn take<'a>(root: &mut DeTable<'a>) -> DeTable<'a> {
    let entries = SECTIONS.iter().filter_map(|&name| Some((name, root.remove_entry(name)?)));
    // A domain without a listener has no such section, and its builder does not want to see one.
    let is_empty = |value: &DeValue<'_>| value.as_table().is_some_and(DeTable::is_empty);
    let kept = entries.filter(|(name, (_, value))| *name == "world" || !is_empty(value.get_ref()));
    kept.map(|(_, entry)| entry).collect()
}

/// Reads a task's sections into the types of its domain, and writes them down complete.
pub(crate) fn read<'a>(
    domain: &str,
    layers: &Layers<'a>,
    sections: DeTable<'a>,
) -> Result<Task, ConfigError> {
    let typed = match domain {
        "lander" => typed::<NotifierSections<LanderWorldSettings>>,
        "highway" => typed::<NotifierSections<HighwayWorldSettings>>,
        "steakhouse" => typed::<NotifierSections<SteakhouseWorldSettings>>,
        "pilot" => typed::<WorldOnly<PilotTaskSettings>>,
        "cartpole" => typed::<WorldOnly<CartPoleSettings>>,
        "cue_recall" => typed::<WorldOnly<CueRecallSettings>>,
        DOMAIN => typed::<WorldOnly<PythonSettings>>,
        // A domain of the user's own checks its sections itself.
        _ => typed::<Table>,
    };
    typed(domain, layers, sections)
}

/// Completes a task with what it has to find out itself; all others stay as they are.
pub(crate) fn complete(task: Task, registry: &Registry) -> Result<Task, ConfigError> {
    let Some(spec) = registry.complete(&task.spec).map_err(ConfigError::of)? else {
        return Ok(task);
    };
    let sections: Value = serde_json::from_str(&spec.settings).map_err(ConfigError::of)?;
    Ok(Task { table: Table::try_from(&sections).map_err(ConfigError::of)?, spec })
}

fn typed<'a, S: Serialize + DeserializeOwned>(
    domain: &str,
    layers: &Layers<'a>,
    sections: DeTable<'a>,
) -> Result<Task, ConfigError> {
    let sections: S = layers.read(sections)?;
    let json = serde_json::to_value(&sections).map_err(ConfigError::of)?;
    let table = Table::try_from(&sections).map_err(ConfigError::of)?;
    let spec = TaskSpec { domain: domain.to_owned(), settings: json.to_string() };
    Ok(Task { table, spec })
}
