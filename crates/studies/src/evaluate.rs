//! Evaluates every row of a part under every condition, sampled and greedy, and sums it up.

use std::collections::BTreeMap;

use leadtime_config::Config;
use leadtime_episodes::Error as PlayError;
use leadtime_eval::measure::{
    Choice, Difference, Evaluation, PlaySettings, SpeechLog, Summary, evaluate_with,
    with_lead_times, with_outcomes, with_said,
};
use leadtime_numerics::stats::mean;
use leadtime_proto::TaskSpec;
use leadtime_runs::Tasks;
use leadtime_runs::build::n_cores;
use serde::Serialize;
use tokio_util::sync::CancellationToken;

use crate::cache::{EvalCache, file_name};
use crate::candidate::EvalCandidate;
use crate::error::Error;
use crate::plan::{PlannedPart, PlannedRow, Protocol, UNAIDED, bootstrap, disambiguate};
use crate::provenance;
use crate::result::{ConditionResult, PartResult, RowResult};
use crate::study::StatedDifference;
use crate::trainings::RowTrainings;

/// The measure that decides whether a training failed.
const SUCCESS: &str = "success";
/// Which metrics are computed for an episode, and how; raised when that changes, so that no evaluation is taken that
/// lacks one.
const METRICS: u32 = 2;

/// Evaluations by row and condition: one per training seed.
type Sampled = BTreeMap<(String, String), Vec<Evaluation>>;

/// What decides an evaluation of the unaided listener: domain, settings and seed. Two domains may have equal settings.
type UnaidedKey = (String, String, u64);

/// Evaluates policies; remembers what the unaided listener did in the same episodes.
#[derive(Debug)]
pub(crate) struct Evaluator<'a> {
    tasks: &'a Tasks,
    shutdown: &'a CancellationToken,
    /// Evaluations that were made before.
    pub(crate) cache: EvalCache,
    /// By what decides them.
    unaided: BTreeMap<UnaidedKey, Evaluation>,
}

/// The metrics that are computed for an episode beyond the task's own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
enum Detail {
    /// None beyond the measures of the task.
    Measures,
    /// Whether a hazard was averted or harm done, and its lead time.
    Lead,
    /// These, and what is said over its course.
    Course,
}

impl<'a> Evaluator<'a> {
    /// Makes an evaluator that stops when `shutdown` is cancelled.
    pub(crate) fn new(tasks: &'a Tasks, shutdown: &'a CancellationToken, cache: EvalCache) -> Self {
        Self { tasks, shutdown, cache, unaided: BTreeMap::new() }
    }

    /// Evaluates the rows of a part.
    pub(crate) fn part(&mut self, planned: &PlannedPart) -> Result<PartResult, Error> {
        let mut sampled = Sampled::new();
        let rows = planned.rows.iter().map(|row| self.row(planned, row, &mut sampled));
        let rows = rows.collect::<Result<_, _>>()?;
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

    /// Evaluates a row under every condition, in every way of choosing.
    fn row(
        &mut self,
        planned: &PlannedPart,
        row: &PlannedRow,
        sampled: &mut Sampled,
    ) -> Result<RowResult, Error> {
        let (which, n_seeds) = (planned.protocol.policy, row.seeds.len());
        if let Some(search) = &row.search {
            search.bring(self.tasks, self.shutdown)?;
        }
        // A script has no distribution to draw from, and so one way of choosing.
        let both = [Choice::Sample, Choice::Greedy].into_iter();
        let choices = both.take(if row.row.script.is_some() { 1 } else { 2 });
        let candidates = choices.map(|choice| {
            Ok((choice, EvalCandidate::of(self.tasks, row, which, choice, n_seeds)?))
        });
        let candidates = candidates.collect::<Result<Vec<_>, Error>>()?;
        let (mut results, mut own) = (Vec::new(), None);
        for condition in &row.conditions {
            for &(choice, ref candidates) in &candidates {
                // Greedy choices are a check on the side, so they have no course.
                let detail = if choice == Choice::Sample { Detail::Course } else { Detail::Lead };
                let config = &condition.config;
                let by_seed = self.by_seed(planned, row, candidates, config, detail)?;
                results.push(ConditionResult {
                    evaluations: condition.names.clone(),
                    title: condition.titles.join(" = "),
                    choice,
                    summary: Summary::over_seeds(&row.row.title, &by_seed, &bootstrap()),
                });
                if choice == Choice::Sample && config.evaluation == row.config.evaluation {
                    own = Some(by_seed.clone());
                }
                if choice == Choice::Sample {
                    let key = |name: &String| (row.row.name.clone(), name.clone());
                    sampled.extend(condition.names.iter().map(|name| (key(name), by_seed.clone())));
                }
            }
        }
        let trainings = match candidates.first() {
            Some((_, sampled)) if row.trainings.len() > 1 => {
                let own = own.map_or_else(
                    || self.by_seed(planned, row, sampled, &row.config, Detail::Measures),
                    Ok,
                )?;
                row_trainings(&own, planned.protocol)
            }
            _ => None,
        };
        let mut settings = planned.profile.differences(&row.config, which);
        if let Some(search) = &row.search {
            settings.extend(search.facts()?);
        }
        Ok(RowResult {
            name: row.row.name.clone(),
            title: row.row.title.clone(),
            notification: row.notification(),
            settings,
            published: row.row.published(),
            results,
            trainings,
            runs: row.trainings.iter().map(provenance::run).collect::<Result<_, _>>()?,
        })
    }

    /// Evaluates a row's candidates under a condition, each on the episodes of its seed; a script's are one evaluation.
    fn by_seed(
        &mut self,
        planned: &PlannedPart,
        row: &PlannedRow,
        candidates: &[EvalCandidate],
        config: &Config,
        detail: Detail,
    ) -> Result<Vec<Evaluation>, Error> {
        let evaluated = candidates.iter().zip(&row.seeds).map(|(candidate, seed)| {
            let seed = planned.protocol.seed + seed;
            self.evaluation(candidate, config, Protocol { seed, ..planned.protocol }, detail)
        });
        let evaluated = evaluated.collect::<Result<Vec<_>, _>>()?;
        // A script is the same on all of them: its batches are no trainings.
        let joined = |all| Evaluation::joined(all).into_iter().collect();
        Ok(if row.row.script.is_some() { joined(evaluated) } else { evaluated })
    }

    /// Takes an evaluation that was made before, or makes it.
    fn evaluation(
        &mut self,
        candidate: &EvalCandidate,
        config: &Config,
        protocol: Protocol,
        detail: Detail,
    ) -> Result<Evaluation, Error> {
        let Protocol { n_episodes, seed, .. } = protocol;
        let task = &config.evaluation.task;
        let asked = (METRICS, &candidate.identity, task, seed, n_episodes, detail);
        let path = candidate.directory.join(file_name(&asked));
        if let Some(evaluation) = self.cache.take(&path) {
            // Rows with other titles may share a run.
            return Ok(Evaluation { player: candidate.player.name().to_owned(), ..evaluation });
        }
        let make = || self.tasks.registry.build(task);
        let (shutdown, settings) = (self.shutdown, PlaySettings::new(u64::from(n_episodes), seed));
        let stop = || shutdown.is_cancelled();
        let settings = settings.threads(n_cores()).stopped_by(&stop);
        let log = |_| SpeechLog::default();
        let (mut evaluation, said) = match evaluate_with(&make, &candidate.player, &settings, log) {
            Err(leadtime_eval::Error::Play(PlayError::Interrupted)) => {
                return Err(Error::Interrupted);
            }
            played => played?,
        };
        if detail != Detail::Measures {
            let is_alone = candidate.is_script(UNAIDED);
            let unaided = self.unaided(config, protocol)?;
            evaluation = with_lead_times(evaluation, unaided);
            if !is_alone {
                evaluation = with_outcomes(evaluation, unaided);
            }
            if detail == Detail::Course {
                evaluation = with_said(evaluation, unaided, &said);
            }
        }
        self.cache.keep(&path, &evaluation);
        Ok(evaluation)
    }

    fn unaided(&mut self, config: &Config, protocol: Protocol) -> Result<&Evaluation, Error> {
        let key = unaided_key(&config.evaluation.task, protocol.seed);
        if !self.unaided.contains_key(&key) {
            let unaided = EvalCandidate::script(&config.run.directory, UNAIDED, UNAIDED);
            let evaluation = self.evaluation(&unaided, config, protocol, Detail::Measures)?;
            self.unaided.insert(key.clone(), evaluation);
        }
        Ok(&self.unaided[&key])
    }
}

fn unaided_key(task: &TaskSpec, seed: u64) -> UnaidedKey {
    (task.domain.clone(), task.settings.clone(), seed)
}

/// Sums up how trainings came out; `None` where the task knows no success, or there is one training.
fn row_trainings(own: &[Evaluation], protocol: Protocol) -> Option<RowTrainings> {
    let success = |evaluation: &Evaluation| Some(mean(&evaluation.column(SUCCESS)?));
    let success = own.iter().map(success).collect::<Option<Vec<f64>>>()?;
    RowTrainings::new(success, protocol.failed_below, &bootstrap())
}

/// States a difference; `None` where a row was not asked for, or its task has no such measure.
fn difference(
    planned: &PlannedPart,
    stated: &StatedDifference,
    sampled: &Sampled,
) -> Option<Difference> {
    let StatedDifference { of, minus, on, measure } = stated;
    let evaluated = |row: &String| sampled.get(&(row.clone(), on.clone())).map(Vec::as_slice);
    let (a, b) = (evaluated(of)?, evaluated(minus)?);
    let [of, minus] = disambiguate([planned.row(of)?, planned.row(minus)?]);
    let minus = format!("{minus} (both on: {})", planned.part.condition(on)?.title);
    Difference::over_seeds((&of, a), (&minus, b), measure, &bootstrap())
}

#[cfg(test)]
#[path = "evaluate_tests.rs"]
mod tests;
