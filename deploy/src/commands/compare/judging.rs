//! Judges every row of a part on every person, sampled and greedy, and sums it up.

use std::collections::BTreeMap;

use anyhow::Context as _;
use leadtime_eval::measure::{Choice, Evaluation, Player, Summary, lead_times};
use leadtime_eval::study::{Judged, PartResult, RowResult, with_claims};
use leadtime_numerics::stats::Bootstrap;
use serde::Serialize;
use tokio_util::sync::CancellationToken;

use super::cells::{Cells, Question};
use super::contender::{self, Contender};
use super::differences::{BySeed, Sampled, check_measures, difference};
use super::naming::notification;
use super::plan::{Evaluated, PlannedPart, PlannedRow};
use super::provenance;
use super::study::WhichPolicy;
use crate::cli::CompareArgs;
use crate::commands::evaluation;
use crate::exit::{ExitCode, Failure};
use leadtime_config::{Config, EvaluationAction};
use leadtime_runs::Tasks;

/// Seed of every interval: what is uncertain is the data.
const BOOTSTRAP_SEED: u64 = 1;
/// Who shows what happens when nobody speaks.
pub(super) const UNAIDED: &str = "unaided";

/// How intervals are made.
pub(super) fn bootstrap() -> Bootstrap {
    Bootstrap::new(BOOTSTRAP_SEED)
}

/// Judges policies; remembers what was judged before, and what the unaided person did in the same episodes.
#[derive(Debug)]
pub(super) struct Judge<'a> {
    pub(super) program: &'a Tasks,
    pub(super) args: &'a CompareArgs,
    pub(super) which: WhichPolicy,
    pub(super) shutdown: &'a CancellationToken,
    pub(super) cells: Cells,
    /// By task and seed.
    unaided: BTreeMap<(String, u64), Evaluation>,
}

impl<'a> Judge<'a> {
    /// Makes one.
    pub(super) fn new(
        program: &'a Tasks,
        args: &'a CompareArgs,
        which: WhichPolicy,
        shutdown: &'a CancellationToken,
        cells: Cells,
    ) -> Self {
        Self { program, args, which, shutdown, cells, unaided: BTreeMap::new() }
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
            let judged = self.people(&planned.seeds, row, &mut sampled)?;
            rows.push(row_result(planned, row, judged)?);
        }
        if self.args.rows.is_empty() {
            check_measures(planned, &rows)?;
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

    /// Returns the evaluation seed that belongs to a part's first training seed.
    pub(super) fn first_seed(&self, planned: &PlannedPart) -> u64 {
        self.args.eval_seed + planned.seeds.first().copied().unwrap_or(0)
    }

    /// Returns a row's player of the first training seed, for figures; it samples.
    ///
    /// # Errors
    ///
    /// As [`contender::of`].
    pub(super) fn first_player(&self, row: &PlannedRow) -> anyhow::Result<Option<Player>> {
        let action = EvaluationAction::Sample;
        let contenders = contender::of(self.program, self.args, self.which, row, action, 1)?;
        Ok(contenders.into_iter().next().map(|first| first.player))
    }

    /// Judges a row on every person, in every way of choosing.
    fn people(
        &mut self,
        seeds: &[u64],
        row: &PlannedRow,
        sampled: &mut Sampled,
    ) -> Result<Vec<Judged>, Failure> {
        let mut judged = Vec::new();
        let people = row.evaluations.iter();
        for (person, action) in people.flat_map(|p| actions(row).into_iter().map(move |a| (p, a))) {
            let by_seed = self.row(seeds, row, person, action)?;
            judged.push(sum_up(row, person, evaluation::choice(action), &by_seed));
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
        seeds: &[u64],
        row: &PlannedRow,
        person: &Evaluated,
        action: EvaluationAction,
    ) -> Result<BySeed, Failure> {
        let contenders =
            contender::of(self.program, self.args, self.which, row, action, seeds.len())?;
        let mut by_seed = Vec::new();
        for (contender, seed) in contenders.iter().zip(seeds) {
            if self.shutdown.is_cancelled() {
                return Err(Failure::silent(ExitCode::Interrupted));
            }
            let told = Told::of(action);
            let seed = self.args.eval_seed + seed;
            by_seed.push(self.cell(contender, &person.config, told, seed)?);
        }
        Ok(by_seed)
    }

    /// Takes a cell that was judged before, or judges it.
    fn cell(
        &mut self,
        contender: &Contender,
        config: &Config,
        told: Told,
        seed: u64,
    ) -> anyhow::Result<Evaluation> {
        let question = self.question(contender, config, told, seed)?;
        let path = contender.directory.join(question.file());
        if let Some(evaluation) = self.cells.take(&path) {
            // Rows with other titles may share a run.
            return Ok(Evaluation { player: contender.player.name().to_owned(), ..evaluation });
        }
        let evaluation = evaluate(self.program, self.args, config, &contender.player, seed)?;
        let evaluation = match told {
            Told::Measures => evaluation,
            Told::Lead | Told::Course => {
                self.against_unaided(evaluation, contender, config, told)?
            }
        };
        self.cells.keep(&path, &evaluation);
        Ok(evaluation)
    }

    fn question(
        &self,
        contender: &Contender,
        config: &Config,
        told: Told,
        seed: u64,
    ) -> anyhow::Result<Question> {
        let task = &config.evaluation.task;
        let n_episodes = self.args.episodes;
        Ok(Question::new(&(&contender.identity, task, seed, n_episodes, told))?)
    }

    /// Adds what is told by comparison with the unaided person in the same episodes.
    fn against_unaided(
        &mut self,
        evaluation: Evaluation,
        contender: &Contender,
        config: &Config,
        told: Told,
    ) -> anyhow::Result<Evaluation> {
        let program = self.program;
        let unaided = self.unaided(config, evaluation.seed)?;
        let evaluation = match lead_times(&evaluation, unaided) {
            Some(leads) => evaluation.with_column("lead_time", &leads),
            None => evaluation,
        };
        Ok(match told {
            Told::Course => {
                let make = || program.registry.build(&config.evaluation.task);
                with_claims(evaluation, unaided, &make, &contender.player, evaluation::n_threads())?
            }
            Told::Measures | Told::Lead => evaluation,
        })
    }

    fn unaided(&mut self, config: &Config, seed: u64) -> anyhow::Result<&Evaluation> {
        let key = (config.evaluation.task.settings.clone(), seed);
        if !self.unaided.contains_key(&key) {
            let unaided = Contender::script(self.args, UNAIDED, UNAIDED);
            let evaluation = self.cell(&unaided, config, Told::Measures, seed)?;
            self.unaided.insert(key.clone(), evaluation);
        }
        self.unaided.get(&key).context("it was put there just now")
    }
}

/// What is told of an episode beyond the task's own measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
enum Told {
    /// Nothing.
    Measures,
    /// Its lead time.
    Lead,
    /// Its lead time and its course.
    Course,
}

impl Told {
    /// Greedy choices are a check on the side; their course is not told.
    fn of(action: EvaluationAction) -> Self {
        match action {
            EvaluationAction::Sample => Self::Course,
            EvaluationAction::Greedy => Self::Lead,
        }
    }
}

/// Plays the episodes of a cell.
fn evaluate(
    program: &Tasks,
    args: &CompareArgs,
    config: &Config,
    player: &Player,
    seed: u64,
) -> anyhow::Result<Evaluation> {
    let players = std::slice::from_ref(player);
    let judged = evaluation::evaluate_all(program, config, players, args.episodes, seed)?;
    judged.into_iter().next().context("one player gives one evaluation")
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

#[cfg(test)]
#[path = "judging_tests.rs"]
mod tests;
