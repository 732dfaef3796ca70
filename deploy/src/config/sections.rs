//! Which sections a domain has, and of which types: the one place where domains differ.

use anyhow::anyhow;
use leadtime_learner::LearnerSettings;
use serde::Serialize;
use serde::de::DeserializeOwned;
use toml::Table;

use super::raw::{Absent, ActorSection, EvaluationSection, PolicySection, RawConfig, RunSection};

/// A configuration as typed structs, the task's sections as JSON.
#[derive(Clone, Debug)]
pub struct Typed {
    /// What to train on.
    pub domain: String,
    /// Seed of every random stream.
    pub seed: u64,
    /// `[run]`
    pub run: RunSection,
    /// `[policy]`
    pub policy: PolicySection,
    /// `[learner]`
    pub learner: LearnerSettings,
    /// `[actor]`
    pub actor: ActorSection,
    /// `[evaluation]`
    pub evaluation: EvaluationSection,
    /// `{"world": ..., "human": ..., "notifier": ...}`, as the task's builder wants it.
    pub settings: String,
}

/// Calls a function of this module for the types of a domain's sections.
macro_rules! for_domain {
    ($domain:expr, $call:ident ( $($arg:expr),* )) => {
        match $domain {
            "lander" => {
                use leadtime_sims::{human::HumanSettings, notifier::NotifierSettings, piloting::WorldSettings};
                $call::<WorldSettings, HumanSettings, NotifierSettings>($($arg),*)
            }
            "highway" => {
                use leadtime_sims::{driving::WorldSettings, human::HumanSettings, notifier::NotifierSettings};
                $call::<WorldSettings, HumanSettings, NotifierSettings>($($arg),*)
            }
            "steakhouse" => {
                use leadtime_sims::{cooking::WorldSettings, human::HumanSettings, notifier::NotifierSettings};
                $call::<WorldSettings, HumanSettings, NotifierSettings>($($arg),*)
            }
            "pilot" => $call::<leadtime_sims::lander::PilotTaskSettings, Absent, Absent>($($arg),*),
            "cartpole" => $call::<leadtime_sims::classic::CartPoleSettings, Absent, Absent>($($arg),*),
            "cue_recall" => $call::<leadtime_sims::classic::CueRecallSettings, Absent, Absent>($($arg),*),
            // A domain of the user's own checks its sections itself.
            _ => $call::<Table, Table, Table>($($arg),*),
        }
    };
}

/// Reads a person's text key by key, so that an unknown or wrong-typed one is reported with its line.
///
/// # Errors
///
/// The line, the key and what is allowed.
pub fn check_text(domain: &str, text: &str) -> anyhow::Result<()> {
    for_domain!(domain, read_text(text))
}

/// Fills in what a table leaves out and brings every value into its type.
///
/// # Errors
///
/// An unknown key or a wrong type, with what is allowed.
pub fn complete(domain: &str, table: Table) -> anyhow::Result<Table> {
    for_domain!(domain, rewrite(table))
}

/// Reads a table into typed structs.
///
/// # Errors
///
/// An unknown key or a wrong type, with what is allowed.
pub fn typed(domain: &str, table: Table) -> anyhow::Result<Typed> {
    for_domain!(domain, read_table(table))
}

fn read_text<W, H, N>(text: &str) -> anyhow::Result<()>
where
    W: DeserializeOwned + Default,
    H: DeserializeOwned + Default,
    N: DeserializeOwned + Default,
{
    toml::from_str::<RawConfig<W, H, N>>(text).map_err(readable)?;
    Ok(())
}

fn rewrite<W, H, N>(table: Table) -> anyhow::Result<Table>
where
    W: DeserializeOwned + Default + Serialize,
    H: DeserializeOwned + Default + Serialize,
    N: DeserializeOwned + Default + Serialize,
{
    let raw: RawConfig<W, H, N> = table.try_into().map_err(readable)?;
    Ok(Table::try_from(&raw)?)
}

fn read_table<W, H, N>(table: Table) -> anyhow::Result<Typed>
where
    W: DeserializeOwned + Default + Serialize,
    H: DeserializeOwned + Default + Serialize,
    N: DeserializeOwned + Default + Serialize,
{
    let raw: RawConfig<W, H, N> = table.try_into().map_err(readable)?;
    let mut settings = serde_json::Map::new();
    let sections = [
        ("world", serde_json::to_value(&raw.world)?),
        ("human", serde_json::to_value(&raw.human)?),
        ("notifier", serde_json::to_value(&raw.notifier)?),
    ];
    for (name, section) in sections {
        // A domain without people has no such section, and its builder does not want to see one.
        if name == "world" || section.as_object().is_some_and(|keys| !keys.is_empty()) {
            settings.insert(name.to_owned(), section);
        }
    }
    Ok(Typed {
        domain: raw.domain,
        seed: raw.seed,
        run: raw.run,
        policy: raw.policy,
        learner: raw.learner,
        actor: raw.actor,
        evaluation: raw.evaluation,
        settings: serde_json::Value::Object(settings).to_string(),
    })
}

/// A TOML error as a sentence of its own; its text ends with a line break.
#[expect(clippy::needless_pass_by_value, reason = "for `map_err`")]
pub(super) fn readable(error: toml::de::Error) -> anyhow::Error {
    anyhow!("{}", error.to_string().trim_end())
}
