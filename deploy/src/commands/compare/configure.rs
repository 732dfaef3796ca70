//! From a profile and its differences to the configuration of a training, or of an evaluation.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail, ensure};
use toml::Table;

use super::catalog::Named;
use super::study::{Part, Person, Row};
use crate::cli::{CompareArgs, SourceArgs};
use leadtime_config::identity::{self, difference};
use leadtime_config::{Config, Layer, Override};
use leadtime_runs::Tasks;
use leadtime_runs::digest::hex;

/// Keys that options set, and which ones.
const OPTIONS: [(&str, &str); 3] =
    [("seed", "--seeds"), ("run.directory", "--runs"), ("run.name", "--runs")];
/// Digits of a configuration's hash in names and tables.
const HASH_DIGITS: usize = 10;

/// A part's profile, with the name that tables give it.
#[derive(Clone, Debug)]
pub(super) struct Profile {
    /// What it is called.
    pub(super) name: String,
    /// The complete configuration.
    pub(super) config: Config,
}

impl Profile {
    /// Loads the part's own profile, or the one on the command line for its domain.
    ///
    /// # Errors
    ///
    /// One sentence: what is wrong with a configuration.
    pub(super) fn load(program: &Tasks, part: &Part, args: &CompareArgs) -> anyhow::Result<Self> {
        let own = read(program, Path::new(&part.profile))?;
        for other in &args.profile {
            let config = read(program, other).context("--profile")?;
            if config.domain == own.domain {
                return Ok(Self { name: other.display().to_string(), config });
            }
        }
        Ok(Self { name: part.profile.clone(), config: own })
    }

    /// Configures the training of a row: the profile, then the part's length, then the row's differences, then the command
    /// line's.
    ///
    /// # Errors
    ///
    /// One sentence: the key at fault.
    pub(super) fn training(
        &self,
        program: &Tasks,
        part: &Part,
        row: &Row,
        args: &CompareArgs,
    ) -> anyhow::Result<Config> {
        for change in &args.set {
            let key = change.key();
            if let Some((_, option)) = OPTIONS.iter().find(|(known, _)| key == *known) {
                bail!(
                    "--set {key}: trainings of a study have seeds and names of their own; see {option}"
                );
            }
        }
        let steps = |steps: u64| Layer::text("steps", format!("learner.total_steps = {steps}"));
        let runs = Override::new("run.directory", args.runs.to_string_lossy().as_ref());
        let layers = part.steps.map(steps).into_iter();
        let layers = layers
            .chain([Layer::table("`set`", &row.set)])
            .chain(args.steps.or(args.quick.then_some(part.quick_steps)).map(steps))
            .chain([Layer::option("--runs", &runs)])
            .chain(args.set.iter().map(Layer::set));
        let mut config = self.config.with(layers, &program.registry)?;
        config.run.directory.clone_from(&args.runs);
        Ok(config)
    }

    /// Lists the settings in which a training differs from the profile.
    pub(super) fn differences(&self, config: &Config) -> Vec<String> {
        let changes = difference(&self.config.table, &config.table).into_iter();
        let told = changes.filter(|change| change.key != "seed" && !identity::is_free(&change.key));
        told.map(|change| match change.after.as_str() {
            "" => format!("{} left out", change.key),
            after => format!("{} = {after}", change.key),
        })
        .collect()
    }
}

/// Configures the evaluation of a row on a person.
///
/// # Errors
///
/// One sentence: the key at fault.
pub(super) fn evaluation(
    program: &Tasks,
    training: &Config,
    person: &Person,
) -> anyhow::Result<Config> {
    Ok(training.with([Layer::table("`set`", &person.set)], &program.registry)?)
}

/// Gives a training its seed and its name.
///
/// # Errors
///
/// As [`Config::with`].
pub(super) fn seeded(
    program: &Tasks,
    training: &Config,
    seed: u64,
    name: &str,
) -> anyhow::Result<Config> {
    let text = format!("seed = {seed}\nrun.name = \"{name}\"\n");
    Ok(training.with([Layer::text("--seeds", text)], &program.registry)?)
}

/// Computes the first digits of the hash over everything in a complete table that decides what a training computes, its
/// seed excepted.
pub(super) fn hash(table: &Table) -> String {
    hex(&identity::of_training(table)).chars().take(HASH_DIGITS).collect()
}

/// Checks that every profile on the command line takes the place of some part's, and no two of the same.
///
/// # Errors
///
/// One sentence that names it.
pub(super) fn check_profiles(
    program: &Tasks,
    studies: &[Named],
    args: &CompareArgs,
) -> anyhow::Result<()> {
    let parts = || studies.iter().flat_map(|named| &named.study.parts);
    let asked = |part: &&Part| args.parts.is_empty() || args.parts.contains(&part.name);
    let mut seen = Vec::new();
    for file in &args.profile {
        let domain = read(program, file).context("--profile")?.domain;
        let mut fits = false;
        for part in parts().filter(asked) {
            fits |= read(program, Path::new(&part.profile))?.domain == domain;
        }
        ensure!(
            fits,
            "--profile {}: no part that was asked for is about the domain `{domain}`",
            file.display()
        );
        ensure!(
            !seen.contains(&domain),
            "--profile {}: there is another one for the domain `{domain}`",
            file.display()
        );
        seen.push(domain);
    }
    Ok(())
}

/// Reads a configuration as it is: a built-in one or a file.
///
/// # Errors
///
/// One sentence: what is wrong with it.
pub(super) fn read(program: &Tasks, file: &Path) -> anyhow::Result<Config> {
    let source = SourceArgs { config: Some(PathBuf::from(file)), ..SourceArgs::default() };
    Ok(source.load(program, None)?)
}
