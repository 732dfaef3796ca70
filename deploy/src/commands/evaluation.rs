//! What the commands that evaluate share: checking measures, printing and keeping a comparison.

use std::path::Path;

use anyhow::{Context as _, Error};
use leadtime_config::{Config, Override};
use leadtime_eval::measure::{Comparison, evaluated_measures};
use leadtime_proto::phrase::{counted, no_such};
use leadtime_runs::{EvaluationRecord, LoadedPolicy, Tasks};

use crate::output;

/// Loads a policy that is to act in its task with changes; refuses a change that would have no effect.
pub(super) fn load(
    tasks: &Tasks,
    runs: &Path,
    policy: &Path,
    changes: &[Override],
) -> anyhow::Result<LoadedPolicy> {
    changes.iter().try_for_each(Override::check_of_task)?;
    let loaded = LoadedPolicy::load(&tasks.registry, runs, policy, changes)?;
    let check = |change: &Override| loaded.config.check_evaluated(change, &tasks.registry);
    changes.iter().try_for_each(check)?;
    Ok(loaded)
}

/// Warns where a policy plays the episodes that its training began with.
pub(super) fn warn_of_own_episodes(policy: &LoadedPolicy, seed: u64) {
    if policy.config.seed == seed {
        tracing::warn!(
            policy = %policy.path.display(),
            "seed {seed} is that of its training, which began with these episodes; others tell more: take another --eval-seed"
        );
    }
}

/// Writes an evaluation into the directory of its run.
pub(super) fn save(record: &EvaluationRecord, run: &Path, config: &Config) -> anyhow::Result<()> {
    record
        .write(run, config)
        .with_context(|| format!("writing the evaluation into {}", run.display()))
}

/// Checks, before anything is played, that a task knows some measures.
pub(super) fn check_measures(config: &Config, measures: &[String]) -> anyhow::Result<()> {
    let known = evaluated_measures(&config.env.metrics);
    let unknown = measures.iter().find(|name| !known.contains(name));
    let no_such = |name: &String| no_such("measure", name, known.iter().map(String::as_str));
    unknown.map_or(Ok(()), |name| Err(Error::msg(no_such(name))))
}

/// Prints a comparison: every measure, or the main ones and how many there are beside them.
pub(super) fn print(comparison: &Comparison, all: bool) {
    output::line(comparison.text(all).trim_end());
    let n = comparison.n_further();
    if !all && n > 0 {
        output::note(&format!("({} with --all)", counted(n, "more measure")));
    }
}
