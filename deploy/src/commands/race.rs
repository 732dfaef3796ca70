//! `leadtime race`: several seeds of one configuration, of which the hopeless are stopped at a quarter of the way.

use std::ffi::OsString;

use leadtime_proto::RunName;
use leadtime_runs::launch::Launch;
use leadtime_runs::race::{Race, RaceScore, RaceStage, Racer};
use leadtime_runs::supervise::Ended;
use leadtime_runs::{LoadedPolicy, Naming, Tasks};
use leadtime_table::Table;
use serde_json::{Value, json};
use tokio_util::sync::CancellationToken;

use super::launch::{carry_out, outcome};
use crate::cli::RaceArgs;
use crate::ending::{Watch, drain_on_request, unless_cancelled, unless_drained, watch};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output::{self, DRAW, EVALUATE, REPORT, WIDTH};

pub(super) async fn run(
    tasks: &Tasks,
    args: &RaceArgs,
    options: &[OsString],
) -> Result<(), Failure> {
    let config = args.source.load(tasks, None).blame(ExitCode::WrongInput)?;
    let name = args.name.as_deref().or(config.run.name.as_ref().map(RunName::as_str));
    let race = Race::plan(tasks, &config, name, args.racers, args.episodes);
    let mut race = race.blame(ExitCode::WrongInput)?;
    if let Some(n_keep) = args.keep {
        if n_keep > args.racers {
            let sentence = format!("--keep {n_keep}: there are only {} racers", args.racers);
            return Err(Failure::input(sentence));
        }
        race.n_keep = n_keep as usize;
    }
    if args.plan {
        if args.json {
            output::json(&race.cost());
        } else {
            output::line(&race.cost().to_string());
        }
        return Ok(());
    }
    race.check().blame(ExitCode::WrongInput)?;
    output::note(&race.cost().to_string());
    let shutdown = watch(Watch::SignalsAsSupervisor).blame(ExitCode::Failed)?;
    let drained = drain_on_request(&shutdown).blame(ExitCode::Failed)?;
    let mut work = RaceWork { tasks, args, options, shutdown: &shutdown, race };
    let carried_out = work.carry_out().await;
    if shutdown.is_cancelled() {
        output::note("\nThe same command goes on with the race.");
    }
    unless_drained(carried_out, &drained)?;
    Ok(())
}

/// A race under way.
struct RaceWork<'a> {
    tasks: &'a Tasks,
    args: &'a RaceArgs,
    options: &'a [OsString],
    shutdown: &'a CancellationToken,
    race: Race,
}

impl RaceWork<'_> {
    async fn carry_out(&mut self) -> Result<(), Failure> {
        let everybody: Vec<usize> = (0..self.race.racers.len()).collect();
        self.stage(&everybody, RaceStage::Quarter).await?;
        let going_on = self.race.stop_hopeless().blame(ExitCode::WrongInput)?;
        self.stage(&going_on, RaceStage::Final).await?;
        let Some(winner) = self.race.winner() else {
            tracing::error!("no racer has reached the end");
            return Err(Failure::silent(ExitCode::Failed));
        };
        self.print(winner);
        Ok(())
    }

    /// Trains racers as far as a stage needs, one after the other, and compares them.
    async fn stage(&mut self, racers: &[usize], stage: RaceStage) -> Result<(), Failure> {
        for (place, &racer) in (1..).zip(racers) {
            if self.race.score(racer, stage).is_some() && self.race.is_trained(racer, stage) {
                continue;
            }
            let (name, n) = (self.name(racer), racers.len());
            let until = match stage {
                RaceStage::Quarter => format!("update {}", self.race.quarter()),
                RaceStage::Final => "the end".to_owned(),
            };
            output::note(&format!("\nRacer {place} of {n}, to {until}: {name}"));
            if !self.race.is_trained(racer, stage) && !self.train(racer, stage).await? {
                continue;
            }
            let score = self.rate(racer, stage).await?;
            output::note(&format!("{name}: {}", words(Some(&score))));
            self.race.keep(racer, stage, score).blame(ExitCode::WrongInput)?;
        }
        Ok(())
    }

    /// Trains a racer. Returns false if its training failed, which ends its race and nobody else's.
    async fn train(&self, racer: usize, stage: RaceStage) -> Result<bool, Failure> {
        let quarter = self.race.quarter();
        let what = Launch {
            stop_after: (stage == RaceStage::Quarter).then(|| quarter.to_string()),
            options: self.options,
            ..Launch::new(Naming::Resume, self.args.actors)
        };
        let config = &self.race.racers[racer].config;
        let launched = carry_out(config, &what, self.shutdown).await?;
        if launched.ended == Ended::Learner(Some(ExitCode::Failed as i32)) {
            tracing::warn!("{} has dropped out: its training failed", self.name(racer));
            return Ok(false);
        }
        outcome(launched).map(|_run| true)
    }

    /// Evaluates a racer on the episodes of a stage.
    async fn rate(&self, racer: usize, stage: RaceStage) -> Result<RaceScore, Failure> {
        let path = self.race.policy(racer, stage).blame(ExitCode::WrongInput)?;
        let (tasks, race) = (self.tasks.clone(), self.race.clone());
        let work = move || {
            let policy = LoadedPolicy::load(&tasks.registry, &path, &path, &[]);
            let policy = policy.blame(ExitCode::WrongInput)?;
            Ok(race.rate(&tasks, &policy, stage)?)
        };
        unless_cancelled(self.shutdown, work).await
    }

    fn name(&self, racer: usize) -> String {
        let name = self.race.racers[racer].config.run.name.as_ref();
        name.map(ToString::to_string).unwrap_or_default()
    }

    fn print(&self, winner: usize) {
        let directory = &self.race.racers[winner].directory;
        if self.args.json {
            let rows = (0..self.race.racers.len()).map(|racer| self.row(racer, winner));
            output::json(&json!({
                "winner": self.name(winner),
                "run": directory.display().to_string(),
                "racers": rows.collect::<Vec<_>>(),
            }));
            return;
        }
        let head = ["run", "at a quarter", "at the end", ""].map(str::to_owned);
        let mut table = Table::new(head).left(&[0, 3]).dispensable(&[1]);
        for racer in 0..self.race.racers.len() {
            let [quarter, last] = [RaceStage::Quarter, RaceStage::Final]
                .map(|stage| words(self.race.score(racer, stage)));
            table.push([self.name(racer), quarter, last, self.fate(racer, winner).to_owned()]);
        }
        output::line(table.text_within(WIDTH).trim_end());
        output::line(&format!("\nWinner: {}", directory.display()));
        output::next(directory, &[EVALUATE, DRAW, REPORT]);
        let is_unfinished = |racer: &Racer| racer.record.is_stopped && racer.record.last.is_none();
        if let Some(racer) = self.race.racers.iter().position(is_unfinished) {
            let (path, name) = (&self.race.racers[racer].directory, self.name(racer));
            let words = ["up".into(), "-c".into(), path.join("config.toml").into()];
            let command = words.into_iter().chain(["--name".into(), name.into()]);
            let told = "A racer that was stopped is an ordinary run, and goes on like this:";
            output::note(&format!("\n{told}\n  {}", output::command(command)));
        }
    }

    /// Describes a racer as JSON.
    fn row(&self, racer: usize, winner: usize) -> Value {
        let score = |stage| {
            self.race.score(racer, stage).map(|score| {
                json!({
                    "updates": score.updates,
                    "measure": if score.is_success { "success" } else { "return" },
                    "mean": score.mean(),
                    "error": score.error(),
                    "episodes": score.scores.len(),
                })
            })
        };
        json!({
            "run": self.name(racer),
            "seed": self.race.racers[racer].config.seed,
            "state": self.fate(racer, winner),
            "quarter": score(RaceStage::Quarter),
            "end": score(RaceStage::Final),
        })
    }

    /// Says what became of a racer.
    fn fate(&self, racer: usize, winner: usize) -> &'static str {
        if racer == winner {
            "winner"
        } else if self.race.racers[racer].record.is_stopped {
            "stopped"
        } else if self.race.score(racer, RaceStage::Final).is_some() {
            "finished"
        } else {
            "dropped out"
        }
    }
}

/// Says how a racer did, with the standard error.
fn words(score: Option<&RaceScore>) -> String {
    let Some(score) = score else { return "-".to_owned() };
    let digits = if score.is_success { 2 } else { 1 };
    format!("{:.digits$} \u{b1} {:.digits$}", score.mean(), score.error())
}
