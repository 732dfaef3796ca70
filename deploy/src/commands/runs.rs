//! `leadtime runs`: what there is, and how two runs differ.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use leadtime_config::identity::difference;
use leadtime_runs::layout::read_config;
use leadtime_runs::record::RecordError;
use leadtime_runs::{ForkOrigin, RunRecord, journal};
use leadtime_table::Table;
use serde::Serialize;
use serde_json::{Value, json};

use crate::cli::{RunsArgs, RunsCommand};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;

/// A run as it is listed.
#[derive(Debug, Default, Serialize)]
struct ListedRun {
    name: String,
    domain: String,
    state: &'static str,
    updates: u64,
    steps: u64,
    success: Option<f64>,
    episode_return: Option<f64>,
    /// Digest of the final weights; `None` while the run is unfinished.
    weights_sha256: Option<String>,
    /// Whether the same seed would give the same weights again; `None` while the run is unfinished.
    reproducible: Option<bool>,
    /// What the run was forked from.
    origin: Option<ForkOrigin>,
    started: String,
    /// Why the record cannot be read as one.
    problem: Option<String>,
}

/// Hexadecimal digits of a digest in a row.
const DIGEST_DIGITS: usize = 12;

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
        print(&rows);
        for ListedRun { name, problem, .. } in &rows {
            if let Some(problem) = problem {
                output::say(&format!("{name}: {problem}"));
            }
        }
    }
    Ok(())
}

fn print(rows: &[ListedRun]) {
    let head = "run domain state updates steps success return weights reproducible";
    let head = head.split(' ').chain(["forked from"]);
    let mut table = Table::new(head).left(&[0, 1, 2, 7, 8, 9]);
    for row in rows {
        table.push(cells(row));
    }
    output::line(table.text().trim_end());
}

fn cells(row: &ListedRun) -> [String; 10] {
    let none = || "-".to_owned();
    let number = |value: Option<f64>, digits| value.map_or_else(none, |x| format!("{x:.digits$}"));
    let cut = |digest: &str| digest.chars().take(DIGEST_DIGITS).collect::<String>();
    let reproducible = row.reproducible.map(|yes| if yes { "yes" } else { "no" });
    let origin = row.origin.as_ref();
    let origin = origin.map(|from| format!("{} {}", from.run, cut(&from.weights_sha256)));
    [
        row.name.clone(),
        row.domain.clone(),
        row.state.to_owned(),
        row.updates.to_string(),
        row.steps.to_string(),
        number(row.success, 2),
        number(row.episode_return, 1),
        row.weights_sha256.as_deref().map_or_else(none, cut),
        reproducible.unwrap_or("-").to_owned(),
        origin.unwrap_or_default(),
    ]
}

/// Describes a run's directory; `None` if it is none.
fn row(path: &Path) -> Option<ListedRun> {
    let is_run = ["run.json", "config.toml"].iter().any(|file| path.join(file).exists());
    is_run.then(|| match RunRecord::read(path) {
        Ok(record) => readable(path, record),
        Err(error) => unreadable(path, error),
    })
}

fn unreadable(path: &Path, error: RecordError) -> ListedRun {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned());
    ListedRun {
        name: name.unwrap_or_default(),
        domain: "-".to_owned(),
        state: "unreadable",
        problem: Some(format!("{:#}", anyhow::Error::from(error))),
        ..ListedRun::default()
    }
}

fn readable(path: &Path, record: RunRecord) -> ListedRun {
    let last = journal::read(path).ok().and_then(|mut lines| lines.pop()).unwrap_or_default();
    let number = |key: &str| last.get(key).and_then(Value::as_f64);
    let whole = |key: &str| last.get(key).and_then(Value::as_u64).unwrap_or(0);
    let reproducible = record.is_reproducible(path);
    ListedRun {
        name: record.name,
        domain: record.domain,
        state: if record.result.is_some() { "finished" } else { "unfinished" },
        reproducible,
        origin: record.origin,
        weights_sha256: record.result.map(|result| result.weights_sha256),
        updates: whole("update"),
        steps: whole("steps"),
        success: number("episodes/success"),
        episode_return: number("episodes/return"),
        started: record.started,
        problem: None,
    }
}

fn compare(args: &RunsArgs, first: &str, second: &str) -> anyhow::Result<()> {
    let open = |name: &str| -> anyhow::Result<_> {
        let path = directory(&args.runs, name)?;
        let record = RunRecord::read(&path)?;
        Ok((read_config(&path)?, readable(&path, record)))
    };
    let ((config_a, row_a), (config_b, row_b)) = (open(first)?, open(second)?);
    let changes = difference(&config_a, &config_b);
    let weights = match (&row_a.weights_sha256, &row_b.weights_sha256) {
        (Some(first), Some(second)) if first == second => "equal",
        (Some(_), Some(_)) => "differ",
        // A run has no final weights yet.
        _ => "unknown",
    };
    if args.json {
        let changes = changes.iter();
        let changes: Vec<_> =
            changes.map(|c| json!({"key": c.key, "first": c.before, "second": c.after})).collect();
        let runs = [row_a, row_b];
        output::json(&json!({"configuration": changes, "runs": runs, "weights": weights}));
        return Ok(());
    }
    for change in &changes {
        output::line(&change.to_string());
    }
    if changes.is_empty() {
        output::line("the configurations are equal");
    }
    print(&[row_a, row_b]);
    let until = if weights == "unknown" { " until both runs are finished" } else { "" };
    output::line(&format!("weights: {weights}{until}"));
    Ok(())
}

/// Finds a run by name or path.
pub(super) fn directory(runs: &Path, name: &str) -> anyhow::Result<PathBuf> {
    let candidates = [PathBuf::from(name), runs.join(name)];
    let found = candidates.into_iter().find(|path| path.join("run.json").exists());
    found.with_context(|| format!("there is no run `{name}` in {}", runs.display()))
}
