//! What several files' tests share.

use std::path::Path;

use leadtime_config::{Config, ConfigSource, Override};

use crate::Tasks;

/// Loads a built-in configuration with changes, for a run of seed 7; without a name if `name` is empty.
pub(crate) fn config(runs: &Path, base: &str, name: &str, set: &[&str]) -> Config {
    let tasks = Tasks::new();
    let source = ConfigSource {
        steps: None,
        file: tasks.catalog.file(base),
        set: set.iter().map(|text| Override::parse(text).unwrap()).collect(),
        seed: Some(7),
        runs: Some(runs.to_owned()),
        name: (!name.is_empty()).then(|| name.to_owned()),
    };
    Config::load(&source, &tasks.catalog, &tasks.registry).unwrap()
}
