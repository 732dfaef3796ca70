//! `leadtime runs`: lists runs, compares two, and removes old ones.

use std::io::{self, IsTerminal as _};
use std::path::Path;

use anyhow::Context as _;
use leadtime_config::identity::difference;
use leadtime_proto::phrase::counted;
use leadtime_runs::layout::read_config;
use leadtime_runs::prune::{self, OldRun, PruneRule, StaysBecause, old_runs};
use leadtime_runs::{ListedRun, RunRecord, find_run};
use serde_json::json;

use crate::cli::{PruneArgs, RunsArgs, RunsCommand};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::{output, terminal};

pub(super) fn run(args: &RunsArgs) -> Result<(), Failure> {
    match &args.command {
        None | Some(RunsCommand::List) => list(args),
        Some(RunsCommand::Compare { first, second }) => compare(args, first, second),
        Some(RunsCommand::Prune(which)) => prune(args, *which),
    }
    .blame(ExitCode::WrongInput)
}

fn list(args: &RunsArgs) -> anyhow::Result<()> {
    let runs = &args.runs;
    let rows = ListedRun::all(runs).with_context(|| format!("reading {}", runs.display()))?;
    if args.json {
        output::json(&rows);
    } else if rows.is_empty() {
        output::say(&format!("there are no runs in {}", runs.display()));
    } else {
        print(&rows, args.all);
        for ListedRun { name, problem, .. } in &rows {
            if let Some(problem) = problem {
                output::say(&format!("{name}: {problem}"));
            }
        }
    }
    Ok(())
}

/// Lists the old runs, and removes them if that is wanted.
fn prune(args: &RunsArgs, which: PruneArgs) -> anyhow::Result<()> {
    let runs = &args.runs;
    let rule = PruneRule { older: which.older, keep_best: which.keep_best };
    let is_there = runs.symlink_metadata().is_ok();
    let mut old = if is_there {
        old_runs(runs, rule).with_context(|| format!("reading {}", runs.display()))?
    } else {
        Vec::new()
    };
    let mut failed = None;
    for run in old.iter_mut().filter(|run| which.yes && run.stays.is_none()) {
        let removed = prune::remove(runs, run);
        run.stays = match removed {
            Ok(true) => None,
            Ok(false) => Some(StaysBecause::InUse),
            // What became of the others is told all the same.
            Err(error) => {
                let what = format!("removing {}", runs.join(&run.name).display());
                failed = failed.or(Some(anyhow::Error::from(error).context(what)));
                Some(StaysBecause::CannotRemove)
            }
        };
    }
    let done = failed.map_or(Ok(()), Err);
    if args.json {
        output::json(&old);
        return done;
    }
    let gone = if which.yes { "removed" } else { "would be removed" };
    for OldRun { name, days, bytes, stays } in &old {
        let fate = match stays {
            None => gone,
            Some(StaysBecause::InUse) => "stays: it is in use",
            Some(StaysBecause::Best) => "stays: it is the best of its configuration",
            Some(StaysBecause::Unreadable) => {
                "stays: it cannot be read, so it may be the best of its configuration"
            }
            Some(StaysBecause::CannotRemove) => "stays: it cannot be removed",
        };
        let (size, age) = (*bytes as f64 / 1e6, counted(*days, "day"));
        output::line(&format!("{name}  {size:.1} MB, {age} old: {fate}"));
    }
    let n_going = old.iter().filter(|run| run.stays.is_none()).count();
    if !is_there {
        // The directory may be misspelt, and a disk fills that should have been swept.
        output::say(&format!("there are no runs in {}", runs.display()));
    } else if n_going == 0 {
        output::say("no run is to be removed");
    } else if !which.yes {
        output::note("Nothing was removed; --yes does it.");
    }
    done
}

/// Prints the columns for which a terminal has room, or all. Scripts get every main column.
fn print(rows: &[ListedRun], all: bool) {
    let table = ListedRun::table(rows, all);
    let is_whole = all || !io::stdout().is_terminal();
    let text = if is_whole { table.text() } else { table.text_within(terminal::columns()) };
    output::line(text.trim_end());
}

fn compare(args: &RunsArgs, first: &Path, second: &Path) -> anyhow::Result<()> {
    let open = |name: &Path| -> anyhow::Result<_> {
        let path = find_run(&args.runs, name)?;
        let record = RunRecord::read(&path)?;
        Ok((read_config(&path)?, ListedRun::new(&path, record)))
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
    print(&[row_a, row_b], args.all);
    let until = if weights == "unknown" { " until both runs are finished" } else { "" };
    output::line(&format!("weights: {weights}{until}"));
    Ok(())
}
