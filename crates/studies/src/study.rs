//! A study as its author writes it: TOML in `studies/`, or a file of one's own.
//!
//! Everything is a difference: a row trains the part's profile with a few keys changed, an evaluation is the row's task
//! with a few keys changed. So a new question is a new file, and no code.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use toml::Table;

use leadtime_config::Layer;

use crate::error::{Error, Placed as _, ensure};

/// The most training seeds of a row.
const MAX_SEEDS: u64 = 1_000;

/// A question, and the tables that answer it.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Study {
    /// The title of its page.
    pub title: String,
    /// What is compared and why, for somebody who knows nothing of it.
    pub(crate) lead: String,
    /// Which policy of a run is evaluated.
    #[serde(default, rename = "judged")]
    pub(crate) policy: WhichPolicy,
    /// Training seeds of every row whose part or row does not say its own number; 10 if left out.
    pub(crate) seeds: Option<u64>,
    /// A training has failed if its success, with the listener it trained with, is further than this below the row's best.
    #[serde(default = "failed_below")]
    pub(crate) failed_below: f64,
    /// The tables of the study, in order.
    pub parts: Vec<StudyPart>,
}

/// Which of a run's policies is evaluated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum WhichPolicy {
    /// The one at the end of training: nothing was chosen by looking.
    #[default]
    Last,
    /// The best one by the held-out episodes of its training.
    Best,
}

/// A table: policies trained from one profile.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StudyPart {
    /// Its short name, which begins the names of its runs and figures.
    pub name: String,
    /// The heading over the table.
    pub(crate) title: String,
    /// The configuration that every row starts from: a built-in one or a file.
    pub(crate) profile: String,
    /// How the profile was chosen.
    #[serde(default)]
    pub(crate) note: String,
    /// Environment steps of each training whose row does not set `learner.total_steps`; the profile's if left out.
    pub(crate) steps: Option<u64>,
    /// Training seeds of every row that does not say its own number; the study's if left out.
    pub(crate) seeds: Option<u64>,
    /// The first training seed: none that a search for the profile used, or saw results of.
    #[serde(default = "first_seed")]
    pub(crate) first_seed: u64,
    /// Steps with `--quick`, of every row.
    pub(crate) quick_steps: u64,
    /// How the table is laid out.
    #[serde(default)]
    pub(crate) layout: Layout,
    /// What the evaluations of a grid differ in, as a figure's axis says it.
    #[serde(default)]
    pub(crate) axis: String,
    /// What these are, in the name of the figure's file.
    #[serde(default = "axis_name")]
    pub(crate) axis_name: String,
    /// The evaluation whose first episode is drawn for every row; none: no such figure.
    pub(crate) pictured_on: Option<String>,
    /// Maps to draw side by side, each with an unaided trajectory; none: no such figure. Only in a domain with maps.
    #[serde(default)]
    pub(crate) maps: Vec<StudyMap>,
    /// The evaluation whose first trajectories are drawn for every row; none: no such figure. Only in a domain with
    /// maps.
    pub(crate) trajectories_on: Option<String>,
    /// Measures of the main table.
    pub(crate) columns: Vec<String>,
    /// Differences to state under the table.
    #[serde(default)]
    pub(crate) differences: Vec<StatedDifference>,
    /// The conditions under which policies are evaluated.
    pub(crate) evaluations: Vec<StudyCondition>,
    /// The policies of the table, from top to bottom.
    pub rows: Vec<StudyRow>,
}

/// How a part is laid out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Layout {
    /// A line per policy and condition, a column per measure.
    #[default]
    Lines,
    /// A table per measure: a line per policy, a column per condition.
    Grid,
}

/// How far below the best of its row a training has failed.
fn failed_below() -> f64 {
    0.05
}

/// Where the seeds of most tables begin.
fn first_seed() -> u64 {
    201
}

/// What the evaluations of most grids differ in.
fn axis_name() -> String {
    "people".to_owned()
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct StudyMap {
    /// The configuration whose map it is: a built-in one or a file.
    pub(crate) profile: String,
    /// What stands above it.
    pub(crate) title: String,
}

/// Two rows whose difference is stated, under one condition.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct StatedDifference {
    /// The row whose mean is taken.
    pub(crate) of: String,
    /// The row whose mean is subtracted.
    pub(crate) minus: String,
    /// Name of one of the part's evaluations.
    pub(crate) on: String,
    /// Name of the measure that is compared.
    pub(crate) measure: String,
}

/// A condition under which policies are evaluated: a listener, a map, a speed of speech.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct StudyCondition {
    /// Its short name, by which rows and figures refer to it.
    pub(crate) name: String,
    /// What tables call it.
    pub(crate) title: String,
    /// Where it stands on the axis of a grid's figure.
    pub(crate) at: Option<f64>,
    /// What differs from the row's own training; nothing: as it was trained.
    #[serde(default)]
    pub(crate) set: Table,
}

/// A policy, once per training seed.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StudyRow {
    /// Its short name, which is part of the names of its runs.
    pub name: String,
    /// What tables call it; neighbours with the same title share a line of a grid.
    pub(crate) title: String,
    /// A scripted player, instead of a trained policy: one of the task's, `searched` for the one that a search finds with the
    /// steps of a training, or `oracle` for one that plans on the episode itself.
    pub(crate) script: Option<String>,
    /// Training seeds; the part's if left out. A script plays as many batches of episodes as the row with the most.
    pub(crate) seeds: Option<u64>,
    /// What differs from the profile in training.
    #[serde(default)]
    pub(crate) set: Table,
    /// Evaluations by name; all if left out.
    #[serde(default)]
    pub(crate) on: Vec<String>,
    /// The paper's figures: mean, or mean and standard deviation.
    #[serde(default)]
    paper: BTreeMap<String, Vec<f64>>,
    /// The same by evaluation.
    #[serde(default)]
    paper_on: BTreeMap<String, BTreeMap<String, Vec<f64>>>,
}

/// A figure that a publication states.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Published {
    /// The condition it is about, by the name of an evaluation; `None` where the source does not say.
    pub(crate) evaluation: Option<String>,
    /// Name of the measure that it is a value of.
    pub(crate) measure: String,
    /// Its mean over training seeds.
    pub(crate) mean: f64,
    /// Its standard deviation over training seeds, if given.
    pub(crate) deviation: Option<f64>,
}

impl Study {
    /// Reads a study and checks that it is consistent in itself; `place` names it in errors.
    pub(crate) fn parse(place: &str, text: &str) -> Result<Self, Error> {
        let study: Self = leadtime_config::read([Layer::text(place, text)])?;
        study.check().at(place)?;
        Ok(study)
    }

    fn check(&self) -> Result<(), Error> {
        ensure(!self.parts.is_empty(), || "a study needs at least one of `parts`")?;
        distinct(self.parts.iter().map(|part| &part.name)).at("`parts`")?;
        let Self { seeds, failed_below, .. } = self;
        check_seeds(*seeds)?;
        ensure(*failed_below > 0.0 && *failed_below <= 1.0, || {
            format!("`failed_below` is {failed_below}; allowed: above 0, at most 1")
        })?;
        for part in &self.parts {
            part.check().at(format_args!("part `{}`", part.name))?;
        }
        Ok(())
    }
}

impl StudyPart {
    pub(crate) fn condition(&self, name: &str) -> Option<&StudyCondition> {
        self.evaluations.iter().find(|condition| condition.name == name)
    }

    fn check(&self) -> Result<(), Error> {
        distinct(self.rows.iter().map(|row| &row.name)).at("`rows`")?;
        distinct(self.evaluations.iter().map(|known| &known.name)).at("`evaluations`")?;
        ensure(!self.columns.is_empty(), || "`columns` is empty; allowed: at least one measure")?;
        distinct(std::iter::once(&self.axis_name)).at("`axis_name`")?;
        check_seeds(self.seeds)?;
        ensure(self.quick_steps > 0, || "`quick_steps` is 0; allowed: at least 1")?;
        let known = |name: &str| {
            let found = self.condition(name).is_some();
            ensure(found, || format!("there is no evaluation `{name}`"))
        };
        for row in &self.rows {
            row.check(&known).at(format_args!("row `{}`", row.name))?;
        }
        self.pictured_on.as_deref().map_or(Ok(()), &known).at("`pictured_on`")?;
        self.trajectories_on.as_deref().map_or(Ok(()), &known).at("`trajectories_on`")?;
        for StatedDifference { of, minus, on, .. } in &self.differences {
            known(on).at("`differences`")?;
            for name in [of, minus] {
                let row = self.rows.iter().find(|row| row.name == *name);
                let missing = || Error::Refused(format!("`differences`: there is no row `{name}`"));
                ensure(row.ok_or_else(missing)?.is_evaluated_on(on), || {
                    format!("`differences`: row `{name}` is not evaluated on `{on}`")
                })?;
            }
        }
        self.evaluations.iter().try_for_each(|StudyCondition { name, at, .. }| {
            ensure(self.layout != Layout::Grid || at.is_some(), || {
                format!("`evaluations`: in a grid `{name}` needs `at`, its place on the axis")
            })
        })
    }
}

impl StudyRow {
    fn check(&self, known: &dyn Fn(&str) -> Result<(), Error>) -> Result<(), Error> {
        check_seeds(self.seeds)?;
        ensure(self.script.is_none() || self.seeds.is_none(), || {
            "`seeds`: a script is not trained".to_owned()
        })?;
        self.on.iter().chain(self.paper_on.keys()).try_for_each(|name| known(name))?;
        for name in self.paper_on.keys() {
            ensure(self.is_evaluated_on(name), || {
                format!("`paper_on.{name}`, where it is not evaluated")
            })?;
        }
        for (measure, numbers) in self.paper.iter().chain(self.paper_on.values().flatten()) {
            ensure(matches!(numbers.len(), 1 | 2), || {
                format!("`{measure}` needs a mean, or a mean and a standard deviation")
            })?;
        }
        Ok(())
    }

    /// Returns whether the policy is evaluated under a condition.
    pub(crate) fn is_evaluated_on(&self, condition: &str) -> bool {
        self.on.is_empty() || self.on.iter().any(|name| name == condition)
    }

    /// Lists what was published about it.
    pub(crate) fn published(&self) -> Vec<Published> {
        let somewhere = self.paper_on.iter().map(|(condition, figures)| (Some(condition), figures));
        let all = std::iter::once((None, &self.paper)).chain(somewhere);
        let all = all.flat_map(|(on, figures)| figures.iter().map(move |figure| (on, figure)));
        let published = |(on, (measure, numbers)): (Option<&String>, (&String, &Vec<f64>))| {
            let (evaluation, measure) = (on.cloned(), measure.clone());
            Published { evaluation, measure, mean: numbers[0], deviation: numbers.get(1).copied() }
        };
        all.map(published).collect()
    }
}

fn check_seeds(seeds: Option<u64>) -> Result<(), Error> {
    let allowed = 1..=MAX_SEEDS;
    ensure(seeds.is_none_or(|seeds| allowed.contains(&seeds)), || {
        format!("`seeds` is {}; allowed: 1 to {MAX_SEEDS}", seeds.unwrap_or_default())
    })
}

/// Checks that names are plain words, each used once.
fn distinct<'a>(names: impl Iterator<Item = &'a String>) -> Result<(), Error> {
    let mut seen: Vec<&String> = Vec::new();
    for name in names {
        let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
        ensure(!name.is_empty() && name.chars().all(plain), || {
            format!("`{name}` is not a name; allowed: a-z, 0-9 and _")
        })?;
        ensure(!seen.contains(&name), || format!("`{name}` is there twice"))?;
        seen.push(name);
    }
    ensure(!seen.is_empty(), || "there is none")
}

#[cfg(test)]
#[path = "study_tests.rs"]
mod tests;
