//! What the commands that evaluate share: checking measures, printing and keeping a comparison.

use std::path::Path;

use anyhow::{Context as _, Error};
use leadtime_config::Config;
use leadtime_eval::measure::{Comparison, evaluated_measures};
use leadtime_proto::phrase::{counted, no_such};
use leadtime_runs::EvaluationRecord;

use crate::output;

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
