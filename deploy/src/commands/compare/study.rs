//! A study as its author writes it: TOML in `deploy/studies`, or a file of one's own.
//!
//! Everything is a difference: a row trains the part's profile with a few keys changed, an evaluation is the row's task
//! with a few keys changed. So a new question is a new file, and no code.

use std::collections::BTreeMap;

use anyhow::{Context as _, bail, ensure};
use leadtime_eval::study::{Layout, Published};
use serde::Deserialize;
use toml::Table;

/// A question, and the tables that answer it.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Study {
    /// Its title.
    pub(super) title: String,
    /// What is compared and why, for somebody who knows nothing of it.
    pub(super) lead: String,
    /// Which policy of a run is judged.
    #[serde(default)]
    pub(super) judged: WhichPolicy,
    /// The tables.
    pub(super) parts: Vec<Part>,
}

/// Which of a run's policies is judged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum WhichPolicy {
    /// The one at the end of training: nothing was chosen by looking.
    #[default]
    Last,
    /// The one with the best mean success over 100 training episodes.
    Best,
}

/// A table: policies trained from one profile.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Part {
    /// Its short name.
    pub(super) name: String,
    /// Its title.
    pub(super) title: String,
    /// The configuration that every row starts from: a built-in one or a file.
    pub(super) profile: String,
    /// How the profile was chosen.
    #[serde(default)]
    pub(super) note: String,
    /// Environment steps of each training whose row does not set `learner.total_steps`; the profile's if left out.
    pub(super) steps: Option<u64>,
    /// The first of five training seeds: none that a search for the profile used, or saw results of.
    #[serde(default = "first_seed")]
    pub(super) first_seed: u64,
    /// Steps with `--quick`, of every row.
    pub(super) quick_steps: u64,
    /// How the table is laid out.
    #[serde(default)]
    pub(super) layout: Layout,
    /// What the evaluations of a grid differ in, as a figure's axis says it.
    #[serde(default)]
    pub(super) axis: String,
    /// The evaluation whose first episode is drawn for every row; none: no such figure.
    pub(super) pictured_on: Option<String>,
    /// Maps to draw side by side, each with an unaided flight; none: no such figure. The lander only.
    #[serde(default)]
    pub(super) maps: Vec<Map>,
    /// The evaluation whose first flights are drawn for every row; none: no such figure. The lander only.
    pub(super) trajectories_on: Option<String>,
    /// Measures of the main table.
    pub(super) columns: Vec<String>,
    /// Differences to state.
    #[serde(default)]
    pub(super) differences: Vec<DifferenceOf>,
    /// The people on whom policies are judged.
    pub(super) evaluations: Vec<Person>,
    /// The policies.
    pub(super) rows: Vec<Row>,
}

/// Where the seeds of most tables begin.
fn first_seed() -> u64 {
    201
}

/// A map to draw.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Map {
    /// The configuration whose map it is: a built-in one or a file.
    pub(super) profile: String,
    /// Its title.
    pub(super) title: String,
}

/// Two rows whose difference is stated, on one person.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DifferenceOf {
    /// The row whose mean is taken.
    pub(super) of: String,
    /// The row whose mean is subtracted.
    pub(super) minus: String,
    /// The evaluation.
    pub(super) on: String,
    /// The measure.
    pub(super) measure: String,
}

/// Somebody on whom policies are judged.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Person {
    /// Short name.
    pub(super) name: String,
    /// Title.
    pub(super) title: String,
    /// Where it stands on the axis of a grid's figure.
    pub(super) at: Option<f64>,
    /// What differs from the row's own training; nothing: the person it was trained on.
    #[serde(default)]
    pub(super) set: Table,
}

/// A policy.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Row {
    /// Short name.
    pub(super) name: String,
    /// Title; neighbours with the same title share a line of a grid.
    pub(super) title: String,
    /// A scripted player of the task, instead of a trained policy.
    pub(super) script: Option<String>,
    /// What differs from the profile in training.
    #[serde(default)]
    pub(super) set: Table,
    /// Evaluations by name; all if left out.
    #[serde(default)]
    pub(super) on: Vec<String>,
    /// The paper's figures: mean, or mean and standard deviation.
    #[serde(default)]
    paper: BTreeMap<String, Vec<f64>>,
    /// The same by evaluation.
    #[serde(default)]
    paper_on: BTreeMap<String, BTreeMap<String, Vec<f64>>>,
}

impl Study {
    /// Reads a study and checks that it is consistent in itself.
    ///
    /// # Errors
    ///
    /// One sentence: the line, or the name at fault.
    pub(super) fn parse(text: &str) -> anyhow::Result<Self> {
        let study: Self = toml::from_str(text)
            .map_err(|error| anyhow::anyhow!("{}", error.to_string().trim_end()))?;
        ensure!(!study.parts.is_empty(), "a study needs at least one of `parts`");
        distinct(study.parts.iter().map(|part| &part.name)).context("`parts`")?;
        for part in &study.parts {
            part.check().with_context(|| format!("part `{}`", part.name))?;
        }
        Ok(study)
    }
}

impl Part {
    fn check(&self) -> anyhow::Result<()> {
        distinct(self.rows.iter().map(|row| &row.name)).context("`rows`")?;
        distinct(self.evaluations.iter().map(|person| &person.name)).context("`evaluations`")?;
        ensure!(!self.columns.is_empty(), "`columns` is empty; allowed: at least one measure");
        ensure!(self.quick_steps > 0, "`quick_steps` is 0; allowed: at least 1");
        let named = |name: &String| self.evaluations.iter().any(|person| person.name == *name);
        for row in &self.rows {
            let people = row.on.iter().chain(row.paper_on.keys());
            for person in people {
                ensure!(named(person), "row `{}`: there is no evaluation `{person}`", row.name);
            }
            for person in row.paper_on.keys() {
                let judged = row.is_judged_on(person);
                ensure!(judged, "row `{}`: `paper_on.{person}`, where it is not judged", row.name);
            }
            let numbers = row.paper.iter().chain(row.paper_on.values().flatten());
            for (measure, numbers) in numbers {
                ensure!(
                    matches!(numbers.len(), 1 | 2),
                    "row `{}`: `{measure}` needs a mean, or a mean and a standard deviation",
                    row.name
                );
            }
        }
        let pictured =
            [("pictured_on", &self.pictured_on), ("trajectories_on", &self.trajectories_on)];
        for (key, person) in pictured {
            if let Some(person) = person {
                ensure!(named(person), "`{key}`: there is no evaluation `{person}`");
            }
        }
        for difference in &self.differences {
            let DifferenceOf { of, minus, on, .. } = difference;
            ensure!(named(on), "`differences`: there is no evaluation `{on}`");
            for name in [of, minus] {
                let row = self.rows.iter().find(|row| row.name == *name);
                let row =
                    row.with_context(|| format!("`differences`: there is no row `{name}`"))?;
                let judged = row.is_judged_on(on);
                ensure!(judged, "`differences`: row `{name}` is not judged on `{on}`");
            }
        }
        let unplaced = self.evaluations.iter().find(|person| person.at.is_none());
        if let (Layout::Grid, Some(person)) = (self.layout, unplaced) {
            bail!("`evaluations`: in a grid `{}` needs `at`, its place on the axis", person.name);
        }
        Ok(())
    }
}

impl Row {
    /// Tells whether the policy is judged on a person.
    pub(super) fn is_judged_on(&self, person: &str) -> bool {
        self.on.is_empty() || self.on.iter().any(|name| name == person)
    }

    /// Lists what was published about it.
    pub(super) fn published(&self) -> Vec<Published> {
        let published =
            |evaluation: Option<&String>, (measure, numbers): (&String, &Vec<f64>)| Published {
                evaluation: evaluation.cloned(),
                measure: measure.clone(),
                mean: numbers[0],
                deviation: numbers.get(1).copied(),
            };
        let anywhere = self.paper.iter().map(|entry| published(None, entry));
        let somewhere = self.paper_on.iter().flat_map(|(person, figures)| {
            figures.iter().map(move |entry| published(Some(person), entry))
        });
        anywhere.chain(somewhere).collect()
    }
}

/// Checks that names are plain words, each used once.
fn distinct<'a>(names: impl Iterator<Item = &'a String>) -> anyhow::Result<()> {
    let mut seen: Vec<&String> = Vec::new();
    for name in names {
        let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
        ensure!(
            !name.is_empty() && name.chars().all(plain),
            "`{name}` is not a name; allowed: a-z, 0-9 and _"
        );
        ensure!(!seen.contains(&name), "`{name}` is there twice");
        seen.push(name);
    }
    ensure!(!seen.is_empty(), "there is none");
    Ok(())
}

#[cfg(test)]
#[path = "study_tests.rs"]
mod tests;
