//! `leadtime runs`: what there is, and how two runs differ.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use serde::Serialize;

use crate::cli::{RunsArgs, RunsCommand};
use crate::config::table::difference;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;
use crate::progress::journal;
use crate::record::RunRecord;
use crate::run_dir::read_config;

/// One line of the list.
#[derive(Debug, Serialize)]
struct Row {
    name: String,
    domain: String,
    state: &'static str,
    updates: u64,
    steps: u64,
    success: Option<f64>,
    episode_return: Option<f64>,
    started: String,
}

pub(super) fn run(args: &RunsArgs) -> Result<(), Failure> {
    match &args.command {
        None | Some(RunsCommand::List) => list(&args.runs, args.json),
        Some(RunsCommand::Compare { first, second }) => compare(args, first, second),
    }
    .blame(ExitCode::WrongInput)
}

fn list(runs: &Path, json: bool) -> anyhow::Result<()> {
    let mut rows = Vec::new();
    if runs.exists() {
        let entries = fs::read_dir(runs).with_context(|| format!("reading {}", runs.display()))?;
        rows.extend(entries.filter_map(Result::ok).filter_map(|entry| row(&entry.path())));
    }
    rows.sort_by(|a, b| (&a.started, &a.name).cmp(&(&b.started, &b.name)));
    if json {
        output::json(&rows);
    } else if rows.is_empty() {
        output::say(&format!("there are no runs in {}", runs.display()));
    } else {
        output::line(&format!(
            "{:<36} {:<11} {:<10} {:>9} {:>11} {:>8} {:>9}",
            "run", "domain", "state", "updates", "steps", "success", "return"
        ));
        for row in &rows {
            output::line(&text(row));
        }
    }
    Ok(())
}

fn text(row: &Row) -> String {
    let number = |value: Option<f64>, digits| {
        value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
    };
    format!(
        "{:<36} {:<11} {:<10} {:>9} {:>11} {:>8} {:>9}",
        row.name,
        row.domain,
        row.state,
        row.updates,
        row.steps,
        number(row.success, 2),
        number(row.episode_return, 1)
    )
}

fn row(path: &Path) -> Option<Row> {
    let record = RunRecord::read(&path.join("run.json")).ok()?;
    let last = journal::read(path).ok().and_then(|mut lines| lines.pop()).unwrap_or_default();
    let number = |key: &str| last.get(key).and_then(serde_json::Value::as_f64);
    let whole = |key: &str| last.get(key).and_then(serde_json::Value::as_u64).unwrap_or(0);
    Some(Row {
        name: record.name,
        domain: record.domain,
        state: if record.result.is_some() { "finished" } else { "unfinished" },
        updates: whole("update"),
        steps: whole("steps"),
        success: number("episodes/success"),
        episode_return: number("episodes/return"),
        started: record.started,
    })
}

fn compare(args: &RunsArgs, first: &str, second: &str) -> anyhow::Result<()> {
    let open = |name: &str| -> anyhow::Result<_> {
        let path = directory(&args.runs, name)?;
        Ok((read_config(&path)?, row(&path).context("the run has no readable record")?))
    };
    let ((config_a, row_a), (config_b, row_b)) = (open(first)?, open(second)?);
    let changes = difference(&config_a, &config_b);
    if args.json {
        let changes: Vec<_> = changes
            .iter()
            .map(|c| serde_json::json!({"key": c.key, "first": c.before, "second": c.after}))
            .collect();
        output::json(&serde_json::json!({"configuration": changes, "runs": [row_a, row_b]}));
        return Ok(());
    }
    for change in &changes {
        output::line(&change.to_string());
    }
    if changes.is_empty() {
        output::line("the configurations are equal");
    }
    for row in [row_a, row_b] {
        output::line(&text(&row));
    }
    Ok(())
}

/// Finds a run by name or path.
pub(super) fn directory(runs: &Path, name: &str) -> anyhow::Result<PathBuf> {
    let candidates = [PathBuf::from(name), runs.join(name)];
    let found = candidates.into_iter().find(|path| path.join("run.json").exists());
    found.with_context(|| format!("there is no run `{name}` in {}", runs.display()))
}
