//! `leadtime describe`: what a task shows, offers and pays.

use std::path::Path;

use anyhow::{Context as _, Error};
use leadtime_config::{Config, ConfigSource, Override};
use leadtime_eval::describe;
use leadtime_runs::{LoadedPolicy, Tasks};
use leadtime_table::{Table, WIDTH};
use serde_json::json;

use crate::cli::DescribeArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;

pub(super) fn run(tasks: &Tasks, args: &DescribeArgs) -> Result<(), Failure> {
    let config = load(tasks, &args.task, &args.set, &args.runs)?;
    let facts = tasks.facts(&config.task);
    if args.json {
        let Config { domain, description, env, .. } = &config;
        output::json(&json!({
            "domain": domain.as_str(),
            "observation": description.observation.quantities(),
            "actions": description.actions,
            "gate": env.actions.gate,
            "conditionals": env.actions.conditionals,
            "rewards": description.rewards,
            "metrics": env.metrics,
            "facts": facts.iter().map(|it| json!({"name": it.name, "meaning": it.meaning})).collect::<Vec<_>>(),
        }));
        return Ok(());
    }
    let write = if args.markdown { Table::markdown } else { Table::text };
    let width = (!args.markdown).then_some(WIDTH);
    output::line(describe(&config.description, &facts, write, width).trim_end());
    Ok(())
}

/// Finds the task's configuration: that of a policy, unless it is a file or a name of its own.
pub(super) fn load(
    tasks: &Tasks,
    task: &Path,
    set: &[Override],
    runs: &Path,
) -> Result<Config, Failure> {
    let set = set.to_vec();
    let is_text = task.extension().is_some_and(|extension| extension == "toml");
    let is_built_in = task.to_str().is_some_and(|name| tasks.catalog.file(name).is_some());
    let configure = |set| {
        tasks.workers.permit_configured();
        let source = ConfigSource { set, ..ConfigSource::default() };
        tasks.configure(Some(task), source).map_err(Error::new)
    };
    if is_text || is_built_in {
        return configure(set).blame(ExitCode::WrongInput);
    }
    match LoadedPolicy::load(&tasks.registry, runs, task, &set) {
        Ok(loaded) => Ok(loaded.config),
        // It may have been meant as the name of either.
        Err(error) if !task.exists() && !runs.join(task).exists() => {
            configure(set).context(error).blame(ExitCode::WrongInput)
        }
        Err(error) => Err(error).blame(ExitCode::WrongInput),
    }
}
