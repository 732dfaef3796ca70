//! `leadtime up --choose-lag`: how far acting runs ahead, found by trying it on this machine.
//!
//! The lag is part of what a run is, so it is chosen before the run begins and stands in its configuration afterwards.

use std::fs;
use std::time::Duration;

use anyhow::Context as _;
use leadtime_config::{Config, Override};
use leadtime_proto::Schedule;
use leadtime_runs::launch::Launch;
use leadtime_runs::policy_file::Fork;
use leadtime_runs::{Naming, Placement, Tasks};
use leadtime_table::Table;
use serde_json::{Value, json};
use tokio_util::sync::CancellationToken;

use super::launch::{carry_out, outcome};
use crate::cli::UpArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output::{self, WIDTH};

/// What is tried, in updates, fewest first: older policies make rollouts of less use.
const TRIED: [i64; 4] = [1, 2, 4, 8];
/// How long each is tried, its start included. Of its updates the first half is left out: actors join, caches fill.
const TRIAL: Duration = Duration::from_secs(4);
/// A lag is enough if it brings so much of what the best one brings.
const ENOUGH: f64 = 0.95;

/// Tries several lags, and returns the change of the configuration that takes the smallest one that is enough.
///
/// # Errors
///
/// [`Failure`] if the configuration has no lag or its run is begun, if a trial fails, if it is too short for an update, or if the
/// program is asked to end meanwhile.
pub(super) async fn choose(
    tasks: &Tasks,
    args: &UpArgs,
    config: &Config,
    placement: &Placement,
    shutdown: &CancellationToken,
) -> Result<Override, Failure> {
    refuse_without_a_choice(config)?;
    // By its file: in the trials' own directory of runs nothing has its name.
    let fork = args.run.fork.as_deref().map(|from| Fork::find(config, from));
    let fork = fork.transpose().context("--fork").blame(ExitCode::WrongInput)?;
    let folder = tempfile::tempdir().blame(ExitCode::WrongInput)?;
    let log = folder.path().join("log");
    let mut rates = Vec::new();
    for lag in TRIED {
        output::note(&format!("Trying learner.lag = {lag} for {TRIAL:?}"));
        let mut changes = vec![
            Override::new("learner.lag", lag),
            Override::new("run.name", format!("lag-{lag}")),
        ];
        if !args.listen.is_empty() {
            // The others join the run, and not its trials.
            changes.push(Override::new("run.actors_min", 1));
        }
        let mut source = args.source.changed(&changes);
        // Whatever else names a directory of runs, the trials are nobody's runs.
        source.runs = Some(folder.path().to_owned());
        let trial = source.load(tasks, None).blame(ExitCode::WrongInput)?;
        let what = Launch {
            fork: fork.as_deref(),
            stop_in: Some(TRIAL),
            stderr_log: Some(log.clone()),
            placement: placement.clone(),
            ..Launch::new(Naming::Resume, args.actors)
        };
        let launched = carry_out(&trial, &what, shutdown).await?;
        // A trial that was cut short tells nothing, however it ended.
        if shutdown.is_cancelled() {
            output::note("\nNo lag is chosen, and no run is begun.");
            return Err(Failure::silent(ExitCode::Interrupted));
        }
        let run = outcome(launched).inspect_err(|_silent| {
            if let Ok(text) = fs::read_to_string(&log) {
                output::say(text.trim_end());
            }
        })?;
        let metrics = fs::read_to_string(run.join("metrics.jsonl")).blame(ExitCode::WrongInput)?;
        let rate = rate(&metrics).ok_or_else(|| {
            Failure::input(format!(
                "--choose-lag: no update was made within {TRIAL:?} of the start; leave the option out, and set \
                 learner.lag by hand"
            ))
        })?;
        rates.push((lag, rate));
    }
    let chosen = smallest_enough(&rates);
    print(&rates, chosen, args.json);
    Ok(Override::new("learner.lag", chosen))
}

fn refuse_without_a_choice(config: &Config) -> Result<(), Failure> {
    if !matches!(config.learner.schedule(), Schedule::Lag(1..)) {
        let sentence = "--choose-lag is for `learner.mode = \"lag\"`; add --set learner.mode=lag, or leave it out";
        return Err(Failure::input(sentence));
    }
    let begun = config.run.name.as_ref().map(|name| config.run.directory.join(name.as_str()));
    match begun.filter(|run| run.exists()) {
        Some(run) => Err(Failure::input(format!(
            "--choose-lag: {} is begun and keeps its lag; leave the option out, or take another name",
            run.display()
        ))),
        None => Ok(()),
    }
}

/// Returns the median steps per second over the second half of a run's updates.
fn rate(metrics: &str) -> Option<f64> {
    let line = |line: &str| -> Option<f64> {
        let values: Value = serde_json::from_str(line).ok()?;
        values["system/steps_per_second"].as_f64()
    };
    let rates: Vec<f64> = metrics.lines().filter_map(line).collect();
    let mut later = rates[rates.len() / 2..].to_vec();
    later.sort_by(f64::total_cmp);
    later.get(later.len() / 2).copied()
}

/// Returns the smallest lag that brings nearly as much as the best one.
fn smallest_enough(rates: &[(i64, f64)]) -> i64 {
    let best = rates.iter().fold(0.0_f64, |best, (_, rate)| best.max(*rate));
    let enough = rates.iter().find(|(_, rate)| *rate >= ENOUGH * best);
    enough.map_or(TRIED[0], |(lag, _)| *lag)
}

fn print(rates: &[(i64, f64)], chosen: i64, as_json: bool) {
    if as_json {
        let tried = rates.iter().map(|(lag, rate)| json!({"lag": lag, "steps_per_second": rate}));
        return output::json(&json!({"tried": tried.collect::<Vec<_>>(), "lag": chosen}));
    }
    let mut table = Table::new(["learner.lag", "steps/s", ""].map(str::to_owned)).left(&[2]);
    for &(lag, rate) in rates {
        let note = if lag == chosen { "taken" } else { "" };
        table.push([lag.to_string(), format!("{rate:.0}"), note.to_owned()]);
    }
    output::line(table.text_within(WIDTH).trim_end());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_smallest_lag_that_brings_nearly_as_much_is_taken() {
        assert_eq!(smallest_enough(&[(1, 90.0), (2, 118.0), (4, 120.0), (8, 119.0)]), 2);
        assert_eq!(smallest_enough(&[(1, 100.0), (2, 99.0), (4, 97.0), (8, 104.0)]), 1);
        assert_eq!(smallest_enough(&[(1, 10.0), (2, 20.0), (4, 40.0), (8, 80.0)]), 8);
    }

    #[test]
    fn the_rate_is_that_of_the_later_updates() {
        let metrics = |rates: &[f64]| -> String {
            let line = |rate: &f64| format!("{{\"system/steps_per_second\": {rate}}}");
            rates.iter().map(line).collect::<Vec<_>>().join("\n")
        };
        assert_eq!(rate(&metrics(&[1.0, 2.0, 30.0, 50.0, 40.0])), Some(40.0));
        assert_eq!(rate(&(metrics(&[7.0]) + "\n{\"update\": 3, \"sys")), Some(7.0));
        assert_eq!(rate(""), None);
    }
}
