//! `leadtime describe`: what a task shows, offers and pays.

use std::path::Path;

use leadtime_config::{Config, ConfigSource, Override};
use leadtime_eval::describe;
use leadtime_proto::phrase::did_you_mean;
use leadtime_proto::text::quoted;
use leadtime_runs::{LoadedPolicy, Tasks, did_you_mean_run};
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
    let is_text = task.extension().is_some_and(|extension| extension == "toml");
    let is_built_in = task.to_str().is_some_and(|name| tasks.catalog.file(name).is_some());
    if is_text || is_built_in {
        tasks.workers.permit_configured();
        let source = ConfigSource { set: set.to_vec(), ..ConfigSource::default() };
        return tasks.configure(Some(task), source).blame(ExitCode::WrongInput);
    }
    // It may have been meant as the name of either.
    if !task.exists() && !runs.join(task).exists() {
        return Err(Failure::input(nothing(tasks, task, runs)));
    }
    let loaded = LoadedPolicy::load(&tasks.registry, runs, task, set);
    loaded.map(|loaded| loaded.config).blame(ExitCode::WrongInput)
}

/// Says that nothing has that name, and which one was meant.
fn nothing(tasks: &Tasks, task: &Path, runs: &Path) -> String {
    let name = task.to_string_lossy();
    let known: Vec<&str> = tasks.catalog.names().collect();
    let meant = [did_you_mean(&name, known.iter().copied()), did_you_mean_run(runs, task)];
    let meant = meant.into_iter().find(|meant| !meant.is_empty());
    format!(
        "`{}` is no file, no run in {}, and no built-in configuration{} Known: {}",
        quoted(&name),
        runs.display(),
        meant.unwrap_or_else(|| ".".to_owned()),
        known.join(", ")
    )
}
