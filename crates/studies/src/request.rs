//! What is asked of a study: how much of it, on which seeds, and where everything lies.

use std::ops::Range;
use std::path::PathBuf;

use leadtime_config::Override;
use leadtime_runs::ProgramBuild;

use crate::study::{Study, StudyPart, StudyRow};

/// Evaluation episodes per training seed of every table.
pub const EPISODES: u32 = 100;
/// Where the evaluation seeds of every table begin.
pub const EVAL_SEED: u64 = 2_000_000;
/// Training seeds of a row, unless the study or the request says otherwise: of fewer, a training that fails one time in
/// ten is likely not to be seen.
const N_SEEDS: u64 = 10;

/// What is asked of a study.
#[derive(Clone, Debug)]
#[cfg_attr(test, derive(Default))]
pub struct StudyRequest {
    /// One training seed and few steps.
    pub quick: bool,
    /// Only these rows, as `row` or `part/row`; all if empty.
    pub rows: Vec<String>,
    /// Only these parts; all if empty.
    pub parts: Vec<String>,
    /// Changes to every training.
    pub set: Vec<Override>,
    /// Configurations that replace the study's own in the parts of their domains.
    pub profiles: Vec<PathBuf>,
    /// Training seeds; those of each row if left out.
    pub seeds: Option<Range<u64>>,
    /// Environment steps of every training.
    pub steps: Option<u64>,
    /// Evaluation episodes per training seed.
    pub episodes: u32,
    /// Seed of the evaluations, to which the training seed is added.
    pub eval_seed: u64,
    /// The directory that holds the runs.
    pub runs: PathBuf,
    /// The directory for pages and figures; the default one if left out.
    pub out: Option<PathBuf>,
    /// The command that made the request, as a page quotes it.
    pub command: String,
    /// The build that carries it out.
    pub build: ProgramBuild,
}

impl StudyRequest {
    pub(crate) fn wants_part(&self, part: &StudyPart) -> bool {
        self.parts.is_empty() || self.parts.contains(&part.name)
    }

    /// Returns whether a row is asked for, if its part is.
    pub(crate) fn wants_row(&self, part: &StudyPart, row: &StudyRow) -> bool {
        self.rows.is_empty() || self.rows.iter().any(|name| is_called(part, row, name))
    }

    /// Lists the training seeds of a row, or those of the episodes that a script plays: the most that a row of its part
    /// has.
    pub(crate) fn seeds(&self, study: &Study, part: &StudyPart, row: &StudyRow) -> Vec<u64> {
        let of = |row: &StudyRow| row.seeds.or(part.seeds).or(study.seeds).unwrap_or(N_SEEDS);
        let n_seeds = match row.script {
            None => of(row),
            Some(_) => part.rows.iter().map(of).max().unwrap_or(N_SEEDS),
        };
        let own = part.first_seed..part.first_seed + n_seeds;
        let seeds = self.seeds.clone().unwrap_or(own);
        seeds.take(if self.quick { 1 } else { usize::MAX }).collect()
    }

    /// Returns whether policies are evaluated over the episodes of every table.
    pub(crate) fn has_the_tables_episodes(&self) -> bool {
        (self.episodes, self.eval_seed) == (EPISODES, EVAL_SEED)
    }

    /// Returns whether whole studies are carried out as they are, but for `quick`.
    pub(crate) fn is_unchanged(&self) -> bool {
        self.rows.is_empty()
            && self.parts.is_empty()
            && self.set.is_empty()
            && self.profiles.is_empty()
            && self.steps.is_none()
            && self.seeds.is_none()
            && self.has_the_tables_episodes()
    }
}

/// Returns whether a row is meant by `row` or `part/row`.
pub(crate) fn is_called(part: &StudyPart, row: &StudyRow, name: &str) -> bool {
    match name.split_once('/') {
        Some((of, name)) => part.name == of && row.name == name,
        None => row.name == name,
    }
}
