//! `[world]` of the domain `python`.

use std::collections::BTreeMap;
use std::time::Duration;

use leadtime_proto::limits::{MAX_CHOICES, MAX_HEADS};
use leadtime_proto::{ActionSpec, EnvSpec, Head};
use leadtime_sims::SettingError;
use leadtime_sims::check::{require, require_within};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::{Map, Value};

/// The name of the domain in configurations.
pub const DOMAIN: &str = "python";
/// The most environments that one worker steps.
const MAX_BATCH: u32 = 1_024;
/// The longest observation, in numbers.
pub(crate) const MAX_OBS_DIM: usize = 1 << 18;
/// The most metrics of an episode.
const MAX_METRICS: usize = 64;
/// What stands in the configuration where the worker is to be asked.
const ASK: &str = "ask";

/// How an environment is put back where it was.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SnapshotKind {
    /// By its episode's seed and actions, which are played again.
    #[default]
    Replay,
    /// By a pickle of the environment.
    Pickle,
    /// Not at all: one that moves begins an episode.
    None,
}

/// What the environments look like, as a worker says it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorldSpec {
    /// Length of an observation.
    pub obs_dim: usize,
    /// The heads of an action.
    pub heads: Vec<Head>,
    /// Versions of Python and of the packages that step the environments; those that are named must be the same everywhere.
    #[serde(default)]
    pub versions: BTreeMap<String, String>,
}

/// Where the specification comes from.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum SpecSetting {
    /// A worker is asked, once; what it says is stored with the configuration.
    #[default]
    Ask,
    /// It is written down.
    Known(WorldSpec),
}

impl Serialize for SpecSetting {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Ask => ASK.serialize(serializer),
            Self::Known(spec) => spec.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for SpecSetting {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        match Value::deserialize(deserializer)? {
            Value::String(word) if word == ASK => Ok(Self::Ask),
            table @ Value::Object(_) => {
                serde_json::from_value(table).map(Self::Known).map_err(D::Error::custom)
            }
            other => Err(D::Error::custom(format!(
                "`world.spec` is {other}; allowed: \"ask\", or a table with obs_dim and heads"
            ))),
        }
    }
}

/// The settings; `configs/python.toml` says what each means.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PythonSettings {
    /// The command that starts a worker.
    pub worker: String,
    /// Whatever the environments are made with.
    pub env: Map<String, Value>,
    /// What they look like.
    pub spec: SpecSetting,
    /// Numbers of `info` at the end of an episode that become its metrics.
    pub metrics: Vec<String>,
    /// How they are put back.
    pub snapshot: SnapshotKind,
    /// Environments that one worker steps.
    pub batch: u32,
    /// How long a worker may be silent.
    #[serde(with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required")]
    pub step_timeout: Duration,
}

impl Default for PythonSettings {
    fn default() -> Self {
        Self {
            worker: "python3 -m leadtime.worker".to_owned(),
            env: Map::new(),
            spec: SpecSetting::Ask,
            metrics: Vec::new(),
            snapshot: SnapshotKind::Replay,
            batch: 16,
            step_timeout: Duration::from_secs(10),
        }
    }
}

impl PythonSettings {
    /// Checks what can be checked without a worker.
    pub(crate) fn check(&self) -> Result<(), SettingError> {
        let command = &self.worker;
        let fits = !command.trim().is_empty() && !command.contains('\0');
        require(fits, "world.worker", format!("{command:?}"), "a command of the shell")?;
        require_within("world.batch", self.batch, 1..=MAX_BATCH, "environments per worker")?;
        let (timeout, day) = (self.step_timeout, Duration::from_hours(24));
        let fits = (Duration::from_millis(10)..=day).contains(&timeout);
        require(fits, "world.step_timeout", format!("{timeout:?}"), "10ms to 24h")?;
        let (n_metrics, named) = (self.metrics.len(), self.metrics.iter().all(|it| !it.is_empty()));
        let fits = n_metrics <= MAX_METRICS && named;
        require(fits, "world.metrics", n_metrics, format!("up to {MAX_METRICS} names"))?;
        let SpecSetting::Known(spec) = &self.spec else { return Ok(()) };
        require_within("world.spec.obs_dim", spec.obs_dim, 1..=MAX_OBS_DIM, "numbers")?;
        require_within("world.spec.heads", spec.heads.len(), 1..=MAX_HEADS, "heads")?;
        let n_choices: usize = spec.heads.iter().map(|head| head.n_choices).sum();
        let fits = n_choices <= MAX_CHOICES && spec.heads.iter().all(|head| head.n_choices >= 1);
        let given = format!("{n_choices} choices in all");
        require(fits, "world.spec.heads", given, format!("1 to {MAX_CHOICES} choices in all"))
    }
}

impl WorldSpec {
    /// Returns what actors and learner know of the environments.
    pub(crate) fn env_spec(&self, metrics: &[String]) -> EnvSpec {
        let actions =
            ActionSpec { heads: self.heads.clone(), gate: None, conditionals: Vec::new() };
        EnvSpec { obs_dim: self.obs_dim, actions, metrics: metrics.to_vec() }
    }

    /// Says how a worker's environments differ from these, if they do.
    pub(crate) fn difference(&self, found: &Self) -> Option<String> {
        let heads = |spec: &Self| {
            let heads = spec.heads.iter().map(|head| format!("{} {}", head.name, head.n_choices));
            heads.collect::<Vec<_>>().join(", ")
        };
        if self.obs_dim != found.obs_dim {
            return Some(format!(
                "observations of {} numbers, not {}",
                found.obs_dim, self.obs_dim
            ));
        }
        if self.heads != found.heads {
            return Some(format!("heads {}, not {}", heads(found), heads(self)));
        }
        self.versions.iter().find_map(|(package, version)| {
            let here = found.versions.get(package).map_or("none", String::as_str);
            (here != version).then(|| format!("{package} {here}, not {version}"))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_survive_the_way_through_a_file() {
        let known = WorldSpec {
            obs_dim: 4,
            heads: vec![Head { name: "action".to_owned(), n_choices: 2 }],
            versions: [("numpy".to_owned(), "2.4.6".to_owned())].into(),
        };
        for spec in [SpecSetting::Ask, SpecSetting::Known(known)] {
            let settings = PythonSettings { spec, ..PythonSettings::default() };
            settings.check().unwrap();
            let text = serde_json::to_string(&settings).unwrap();
            assert_eq!(serde_json::from_str::<PythonSettings>(&text).unwrap(), settings, "{text}");
        }
        assert!(serde_json::from_str::<PythonSettings>(r#"{"spec": 3}"#).is_err());
    }

    #[test]
    fn impossible_settings_are_named() {
        let refused = |change: fn(&mut PythonSettings)| {
            let mut settings = PythonSettings::default();
            change(&mut settings);
            settings.check().unwrap_err().key
        };
        assert_eq!(refused(|it| it.worker = " ".to_owned()), "world.worker");
        assert_eq!(refused(|it| it.batch = 0), "world.batch");
        assert_eq!(refused(|it| it.step_timeout = Duration::ZERO), "world.step_timeout");
        assert_eq!(refused(|it| it.metrics = vec![String::new()]), "world.metrics");
        let heads = |it: &mut PythonSettings| {
            let heads = vec![Head { name: "a".to_owned(), n_choices: 65 }];
            it.spec =
                SpecSetting::Known(WorldSpec { obs_dim: 1, heads, versions: BTreeMap::new() });
        };
        assert_eq!(refused(heads), "world.spec.heads");
    }

    #[test]
    fn a_version_that_is_not_named_may_be_any() {
        let spec = |versions: &[(&str, &str)]| {
            let versions = versions.iter().map(|(a, b)| ((*a).to_owned(), (*b).to_owned()));
            WorldSpec { obs_dim: 1, heads: Vec::new(), versions: versions.collect() }
        };
        let here = spec(&[("numpy", "2.4"), ("python", "3.11")]);
        assert_eq!(spec(&[("python", "3.11")]).difference(&here), None);
        let other = spec(&[("numpy", "2.3")]).difference(&here);
        assert_eq!(other.as_deref(), Some("numpy 2.4, not 2.3"));
    }
}
