//! Judges every row of a part on every person, sampled and greedy, and sums it up.

use std::collections::BTreeMap;

use anyhow::Context as _;
use leadtime_eval::measure::{Choice, Difference, Evaluation, Player, Summary, lead_times};
use leadtime_eval::study::{Judged, PartResult, RowResult, with_claims};
use leadtime_numerics::stats::Bootstrap;
use tokio_util::sync::CancellationToken;
use toml::Value;

use super::plan::{Evaluated, PlannedPart, PlannedRow, seeds};
use super::provenance;
use super::study::{DifferenceOf, WhichPolicy};
use crate::Program;
use crate::cli::CompareArgs;
use crate::commands::{judge, policy_file};
use crate::config::Config;
use crate::config::raw::EvaluationAction;
use crate::exit::{ExitCode, Failure};

/// Seed of every interval: what is uncertain is the data.
const BOOTSTRAP_SEED: u64 = 1;
/// Who shows what happens when nobody speaks.
const UNAIDED: &str = "unaided";

/// How intervals are made.
pub(super) fn bootstrap() -> Bootstrap {
    Bootstrap::new(BOOTSTRAP_SEED)
}

/// Judges policies; remembers what the unaided person did in the same episodes.
#[derive(Debug)]
pub(super) struct Judge<'a> {
    pub(super) program: &'a Program,
    pub(super) args: &'a CompareArgs,
    pub(super) which: WhichPolicy,
    pub(super) shutdown: &'a CancellationToken,
    /// By task and seed.
    unaided: BTreeMap<(String, u64), Evaluation>,
}

/// One evaluation per training seed.
type BySeed = Vec<Evaluation>;

/// Evaluations by row and person.
type Sampled = BTreeMap<(String, String), BySeed>;

impl<'a> Judge<'a> {
    /// Makes one.
    pub(super) fn new(
        program: &'a Program,
        args: &'a CompareArgs,
        which: WhichPolicy,
        shutdown: &'a CancellationToken,
    ) -> Self {
        Self { program, args, which, shutdown, unaided: BTreeMap::new() }
    }

    /// Judges the rows of a part.
    ///
    /// # Errors
    ///
    /// [`Failure`]: a policy that cannot be read, or the interruption.
    pub(super) fn part(&mut self, planned: &PlannedPart) -> Result<PartResult, Failure> {
        let mut rows = Vec::new();
        // Evaluations under the row's and the person's names, for differences.
        let mut sampled = Sampled::new();
        for row in &planned.rows {
            let judged = self.people(row, &mut sampled)?;
            rows.push(row_result(planned, row, judged)?);
        }
        let stated = planned.part.differences.iter();
        let differences = stated.filter_map(|d| difference(planned, d, &sampled)).collect();
        let part = &planned.part;
        Ok(PartResult {
            name: part.name.clone(),
            title: part.title.clone(),
            profile: provenance::profile(planned),
            layout: part.layout,
            columns: part.columns.clone(),
            rows,
            differences,
            pictures: Vec::new(),
        })
    }

    /// Judges a row on every person, in every way of choosing.
    fn people(&mut self, row: &PlannedRow, sampled: &mut Sampled) -> Result<Vec<Judged>, Failure> {
        let mut judged = Vec::new();
        let people = row.evaluations.iter();
        for (person, action) in people.flat_map(|p| actions(row).into_iter().map(move |a| (p, a))) {
            let by_seed = self.row(row, person, action)?;
            judged.push(sum_up(row, person, judge::choice(action), &by_seed));
            if action == EvaluationAction::Sample {
                let under = |name: &String| (row.row.name.clone(), name.clone());
                sampled.extend(person.names.iter().map(|name| (under(name), by_seed.clone())));
            }
        }
        Ok(judged)
    }

    /// Judges a row on a person: one evaluation per training seed.
    fn row(
        &mut self,
        row: &PlannedRow,
        person: &Evaluated,
        action: EvaluationAction,
    ) -> Result<BySeed, Failure> {
        let players = self.players(row, action)?;
        let mut by_seed = Vec::new();
        for (player, seed) in players.iter().zip(seeds(self.args)) {
            if self.shutdown.is_cancelled() {
                return Err(Failure::silent(ExitCode::Interrupted));
            }
            let seed = self.args.eval_seed + seed;
            let evaluation = self.evaluate(&person.config, player, seed)?;
            let mut environment = self
                .program
                .registry
                .build(&person.config.evaluation.task)
                .map_err(anyhow::Error::from)?;
            let unaided = self.unaided(&person.config, seed)?;
            let evaluation = match lead_times(&evaluation, unaided) {
                Some(leads) => evaluation.with_column("lead_time", &leads),
                None => evaluation,
            };
            // Greedy choices are a check on the side; their course is not told.
            by_seed.push(match action {
                EvaluationAction::Sample => {
                    with_claims(evaluation, unaided, environment.as_mut(), player)
                        .map_err(anyhow::Error::from)?
                }
                EvaluationAction::Greedy => evaluation,
            });
        }
        Ok(by_seed)
    }

    fn evaluate(&self, config: &Config, player: &Player, seed: u64) -> anyhow::Result<Evaluation> {
        let n_episodes = self.args.episodes;
        let players = std::slice::from_ref(player);
        let judged = judge::evaluate_all(self.program, config, players, n_episodes, seed)?;
        judged.into_iter().next().context("one player gives one evaluation")
    }

    fn unaided(&mut self, config: &Config, seed: u64) -> anyhow::Result<&Evaluation> {
        let key = (config.evaluation.task.settings.clone(), seed);
        if !self.unaided.contains_key(&key) {
            let evaluation = self.evaluate(config, &Player::baseline(UNAIDED), seed)?;
            self.unaided.insert(key.clone(), evaluation);
        }
        self.unaided.get(&key).context("it was put there just now")
    }

    /// Returns the row's player for every training seed.
    pub(super) fn players(
        &self,
        row: &PlannedRow,
        action: EvaluationAction,
    ) -> anyhow::Result<Vec<Player>> {
        let title = &row.row.title;
        if let Some(script) = &row.row.script {
            return Ok(seeds(self.args).iter().map(|_| Player::baseline(script)).collect());
        }
        let player = |training: &super::plan::Training| {
            let file = training.policy(self.which);
            let file = file.to_str().context("the path is not UTF-8")?;
            let runs = &training.config.run.directory;
            let loaded = policy_file::load(self.program, runs, file, &[])?;
            judge::policy(title, &row.config, &loaded.parameters, action)
        };
        row.trainings.iter().map(player).collect()
    }
}

/// A script has no distribution to draw from.
fn actions(row: &PlannedRow) -> Vec<EvaluationAction> {
    let both = [EvaluationAction::Sample, EvaluationAction::Greedy];
    both.into_iter().take(if row.row.script.is_some() { 1 } else { 2 }).collect()
}

fn sum_up(row: &PlannedRow, person: &Evaluated, choice: Choice, by_seed: &BySeed) -> Judged {
    Judged {
        evaluations: person.names.clone(),
        title: person.titles.join(" = "),
        choice,
        summary: Summary::over_seeds(&row.row.title, by_seed, &bootstrap()),
    }
}

fn row_result(
    planned: &PlannedPart,
    row: &PlannedRow,
    judged: Vec<Judged>,
) -> anyhow::Result<RowResult> {
    Ok(RowResult {
        name: row.row.name.clone(),
        title: row.row.title.clone(),
        notification: notification(row),
        settings: planned.profile.differences(&row.config),
        published: row.row.published(),
        judged,
        runs: row.trainings.iter().map(provenance::run).collect::<Result<_, _>>()?,
    })
}

/// Names the type of a row's notifications.
fn notification(row: &PlannedRow) -> String {
    if row.row.script.is_some() {
        return "scripted".to_owned();
    }
    let section = row.config.table.get("notifier");
    let kind = section.and_then(|section| section.get("notification")).and_then(Value::as_str);
    kind.unwrap_or_default().replace('_', " ")
}

fn difference(
    planned: &PlannedPart,
    stated: &DifferenceOf,
    sampled: &Sampled,
) -> Option<Difference> {
    let DifferenceOf { of, minus, on, measure } = stated;
    let evaluated = |row: &String| sampled.get(&(row.clone(), on.clone())).map(Vec::as_slice);
    let title = |name: &String| {
        let row = planned.part.rows.iter().find(|row| row.name == *name)?;
        Some(row.title.to_lowercase())
    };
    let person = planned.part.evaluations.iter().find(|person| person.name == *on)?;
    let (a, b) = (evaluated(of)?, evaluated(minus)?);
    let minus = format!("{} (both on: {})", title(minus)?, person.title);
    Difference::over_seeds((&title(of)?, a), (&minus, b), measure, &bootstrap())
}
