//! What a study needs: which trainings, under which names, and who is judged on whom.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
use leadtime_proto::RunName;

use super::catalog::Named;
use super::configure::{self, Profile};
use super::flights::{self, PlannedMap};
use super::study::{Part, Row, WhichPolicy};
use crate::cli::CompareArgs;
use leadtime_config::Config;
use leadtime_runs::RunRecord;
use leadtime_runs::Tasks;
use leadtime_runs::journal;

/// The longest name of a run.
const MAX_NAME: usize = 64;
/// Training seeds of a table, where the command line does not say.
const TABLE_SEEDS: u64 = 5;

/// A study, ready to be carried out.
#[derive(Clone, Debug)]
pub(super) struct Plan {
    /// The study.
    pub(super) named: Named,
    /// Its parts, as far as they were asked for.
    pub(super) parts: Vec<PlannedPart>,
}

/// A part, ready to be carried out.
#[derive(Clone, Debug)]
pub(super) struct PlannedPart {
    /// The part.
    pub(super) part: Part,
    /// What its rows start from.
    pub(super) profile: Profile,
    /// The seeds that its rows are trained and judged on.
    pub(super) seeds: Vec<u64>,
    /// Its rows, as far as they were asked for.
    pub(super) rows: Vec<PlannedRow>,
    /// The maps to draw.
    pub(super) maps: Vec<PlannedMap>,
}

/// A row, ready to be carried out.
#[derive(Clone, Debug)]
pub(super) struct PlannedRow {
    /// The row.
    pub(super) row: Row,
    /// Its training, without a seed; a script's task as well.
    pub(super) config: Config,
    /// One training per seed; none for a script.
    pub(super) trainings: Vec<Training>,
    /// On whom it is judged.
    pub(super) evaluations: Vec<Evaluated>,
}

/// A run that must be finished before its policy can be judged.
#[derive(Clone, Debug)]
pub(super) struct Training {
    /// Its name: what it is for, what it computes, its seed.
    pub(super) name: RunName,
    /// Its configuration.
    pub(super) config: Config,
    /// First digits of the hash over what it computes.
    pub(super) hash: String,
}

/// A person on whom a row is judged.
#[derive(Clone, Debug)]
pub(super) struct Evaluated {
    /// The evaluations of the study that come to this.
    pub(super) names: Vec<String>,
    /// Their titles.
    pub(super) titles: Vec<String>,
    /// The task.
    pub(super) config: Config,
}

impl Plan {
    /// Plans a study.
    ///
    /// # Errors
    ///
    /// One sentence: an unknown row or part, or what is wrong with a setting.
    pub(super) fn new(program: &Tasks, named: Named, args: &CompareArgs) -> anyhow::Result<Self> {
        let wanted = |part: &&Part| args.parts.is_empty() || args.parts.contains(&part.name);
        let mut parts = Vec::new();
        for part in named.study.parts.iter().filter(wanted) {
            let planned = plan_part(program, &named.name, part, args)
                .with_context(|| format!("study {}, part {}", named.name, part.name))?;
            // A part of which no row was asked for.
            if !planned.rows.is_empty() {
                parts.push(planned);
            }
        }
        Ok(Self { named, parts })
    }

    /// Lists the trainings, each once.
    pub(super) fn trainings(&self) -> Vec<&Training> {
        let mut all: Vec<&Training> = Vec::new();
        for training in self.parts.iter().flat_map(|part| &part.rows).flat_map(|row| &row.trainings)
        {
            if !all.iter().any(|known| known.is_same(training)) {
                all.push(training);
            }
        }
        all
    }
}

/// Lists the trainings of several studies, each once, and gives those that compute the same the same name.
pub(super) fn share(plans: &mut [Plan]) -> Vec<Training> {
    let mut all: Vec<Training> = Vec::new();
    let rows = plans.iter_mut().flat_map(|plan| &mut plan.parts).flat_map(|part| &mut part.rows);
    for training in rows.flat_map(|row| &mut row.trainings) {
        match all.iter().find(|known| known.is_same(training)) {
            Some(known) => *training = known.clone(),
            None => all.push(training.clone()),
        }
    }
    all
}

/// Checks that every row and part on the command line is somewhere.
///
/// # Errors
///
/// One sentence that names it, and what there is.
pub(super) fn check_choice(studies: &[Named], args: &CompareArgs) -> anyhow::Result<()> {
    let parts = || studies.iter().flat_map(|named| &named.study.parts);
    for wanted in &args.parts {
        let known: Vec<&str> = parts().map(|part| part.name.as_str()).collect();
        let found = known.contains(&wanted.as_str());
        ensure!(found, "there is no part `{wanted}`; known: {}", known.join(", "));
    }
    for wanted in &args.rows {
        let rows = || parts().flat_map(|part| part.rows.iter().map(move |row| (part, row)));
        let found = rows().any(|(part, row)| is_called(part, row, wanted));
        let known: Vec<String> =
            rows().map(|(part, row)| format!("{}/{}", part.name, row.name)).collect();
        ensure!(found, "there is no row `{wanted}`; known: {}", known.join(", "));
    }
    Ok(())
}

fn is_called(part: &Part, row: &Row, name: &str) -> bool {
    match name.split_once('/') {
        Some((of, name)) => part.name == of && row.name == name,
        None => row.name == name,
    }
}

fn plan_part(
    program: &Tasks,
    study: &str,
    part: &Part,
    args: &CompareArgs,
) -> anyhow::Result<PlannedPart> {
    let profile = Profile::load(program, part, args)?;
    let wanted =
        |row: &&Row| args.rows.is_empty() || args.rows.iter().any(|n| is_called(part, row, n));
    let seeds = seeds(part, args);
    let rows = part.rows.iter().filter(wanted).map(|row| {
        let stem = format!("{study}-{}-{}", part.name, row.name).replace('_', "-");
        let config = profile.training(program, part, row, args);
        config
            .and_then(|config| plan_row(program, &stem, part, row, config, &seeds))
            .with_context(|| format!("row {}", row.name))
    });
    let rows = rows.collect::<anyhow::Result<Vec<_>>>()?;
    let maps = flights::plan(program, part, &profile)?;
    Ok(PlannedPart { part: part.clone(), profile, seeds, rows, maps })
}

fn plan_row(
    program: &Tasks,
    stem: &str,
    part: &Part,
    row: &Row,
    config: Config,
    seeds: &[u64],
) -> anyhow::Result<PlannedRow> {
    let mut evaluations: Vec<Evaluated> = Vec::new();
    for person in part.evaluations.iter().filter(|person| row.is_judged_on(&person.name)) {
        // A script was trained on nobody.
        if row.script.is_some() && person.set.is_empty() {
            continue;
        }
        let evaluated = configure::evaluation(program, &config, person)
            .with_context(|| format!("evaluation {}", person.name))?;
        let same = |known: &&mut Evaluated| known.config.evaluation == evaluated.evaluation;
        if let Some(known) = evaluations.iter_mut().find(same) {
            known.names.push(person.name.clone());
            known.titles.push(person.title.clone());
        } else {
            let (names, titles) = (vec![person.name.clone()], vec![person.title.clone()]);
            evaluations.push(Evaluated { names, titles, config: evaluated });
        }
    }
    let mut trainings = Vec::new();
    if row.script.is_none() {
        let hash = configure::hash(&config.table);
        for &seed in seeds {
            trainings.push(plan_training(program, stem, &config, &hash, seed)?);
        }
    }
    Ok(PlannedRow { row: row.clone(), config, trainings, evaluations })
}

/// Lists the training seeds: those of the command line, or the part's own.
fn seeds(part: &Part, args: &CompareArgs) -> Vec<u64> {
    let own = part.first_seed..part.first_seed + TABLE_SEEDS;
    let seeds = args.seeds.clone().unwrap_or(own);
    seeds.take(if args.quick { 1 } else { usize::MAX }).collect()
}

fn plan_training(
    program: &Tasks,
    stem: &str,
    config: &Config,
    hash: &str,
    seed: u64,
) -> anyhow::Result<Training> {
    let suffix = format!("-{hash}-s{seed}");
    let name = existing(&config.run.directory, &suffix).unwrap_or_else(|| {
        let room = MAX_NAME - suffix.len();
        let stem: String = stem.chars().take(room).collect();
        format!("{}{suffix}", stem.trim_end_matches('-'))
    });
    let config = configure::seeded(program, config, seed, &name)?;
    Ok(Training { name: RunName::new(name)?, config, hash: hash.to_owned() })
}

/// Finds a run that computes the same, whatever study it was made for; of several a finished one, the first by name.
fn existing(runs: &Path, suffix: &str) -> Option<String> {
    let entries = std::fs::read_dir(runs).ok()?.filter_map(Result::ok);
    let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
    let is_run =
        |name: &String| name.ends_with(suffix) && runs.join(name).join("run.json").exists();
    names.filter(is_run).min_by_key(|name| (!is_finished(&runs.join(name)), name.clone()))
}

/// Tells whether the run in a directory has reached its end.
fn is_finished(directory: &Path) -> bool {
    let record = RunRecord::read(directory);
    record.is_ok_and(|record| record.result.is_some())
}

impl Training {
    /// Returns its directory.
    pub(super) fn directory(&self) -> PathBuf {
        self.config.run.directory.join(self.name.as_str())
    }

    /// Returns the file for what its processes say.
    pub(super) fn log(&self) -> PathBuf {
        self.config.run.directory.join(format!("{}.log", self.name))
    }

    /// Returns the file of the policy that is judged.
    pub(super) fn policy(&self, which: WhichPolicy) -> PathBuf {
        use leadtime_runs::policy_file::{BEST_POLICY, LAST_POLICY};
        let directory = self.directory();
        let best = directory.join(BEST_POLICY);
        // A run in which no hundred episodes ended knows no best one.
        if which == WhichPolicy::Best && best.exists() { best } else { directory.join(LAST_POLICY) }
    }

    /// Tells whether the run has reached its end.
    pub(super) fn is_finished(&self) -> bool {
        is_finished(&self.directory())
    }

    /// Returns the environment steps that it was trained on so far, and in all.
    pub(super) fn steps(&self) -> [u64; 2] {
        let all = self.config.learner.n_updates() * self.config.steps_per_update();
        let done = if self.is_finished() { all } else { journal::last_steps(&self.directory()) };
        [done.min(all), all]
    }

    fn is_same(&self, other: &Self) -> bool {
        self.hash == other.hash && self.config.seed == other.config.seed
    }
}

#[cfg(test)]
#[path = "plan_tests.rs"]
mod tests;
