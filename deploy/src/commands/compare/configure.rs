//! From a profile and its differences to the configuration of a training, or of an evaluation.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail, ensure};
use sha2::{Digest as _, Sha256};
use toml::{Table, Value};

use super::catalog::Named;
use super::study::{Part, Person, Row};
use crate::Program;
use crate::cli::{CompareArgs, ConfigSource};
use crate::config::table::{deciding, difference, overlay};
use crate::config::{self, Config};
use crate::output;

/// Sections and keys that do not decide what a training computes, or that are named apart from the configuration.
const FREE: [&str; 4] = ["run.", "actor.", "evaluation.", "seed"];
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
    /// The complete table.
    pub(super) table: Table,
}

impl Profile {
    /// Loads the part's own profile, or the one on the command line for its domain.
    ///
    /// # Errors
    ///
    /// One sentence: what is wrong with a configuration.
    pub(super) fn load(program: &Program, part: &Part, args: &CompareArgs) -> anyhow::Result<Self> {
        let own = read(program, Path::new(&part.profile))?;
        for other in &args.profile {
            let config = read(program, other).context("--profile")?;
            if config.domain == own.domain {
                return Ok(Self { name: other.display().to_string(), table: config.table });
            }
        }
        Ok(Self { name: part.profile.clone(), table: own.table })
    }

    /// Configures the training of a row: the profile, then the part's length, then the row's differences, then the command
    /// line's.
    ///
    /// # Errors
    ///
    /// One sentence: the key at fault.
    pub(super) fn training(
        &self,
        program: &Program,
        part: &Part,
        row: &Row,
        args: &CompareArgs,
    ) -> anyhow::Result<Config> {
        let mut table = self.table.clone();
        put_steps(&mut table, part.steps)?;
        overlay(&mut table, &row.set);
        put_steps(&mut table, args.steps.or(args.quick.then_some(part.quick_steps)))?;
        let runs = args.runs.to_str().context("--runs: the path is not UTF-8")?;
        put(&mut table, "run", "directory", runs.into());
        for assignment in &args.set {
            let key = assignment.key();
            if let Some((_, option)) = OPTIONS.iter().find(|(known, _)| key == *known) {
                bail!(
                    "--set {key}: trainings of a study have seeds and names of their own; see {option}"
                );
            }
            assignment.apply(&mut table);
            let checked = Config::from_table(table.clone(), &program.registry);
            checked.with_context(|| format!("--set {}", assignment.key()))?;
        }
        Config::from_table(table, &program.registry)
    }

    /// Lists the settings in which a training differs from the profile.
    pub(super) fn differences(&self, config: &Config) -> Vec<String> {
        let changes = difference(&self.table, &config.table).into_iter();
        let told = changes.filter(|change| !is_free(&change.key));
        told.map(|change| match change.after.as_str() {
            "" => format!("{} left out", change.key),
            after => format!("{} = {after}", change.key),
        })
        .collect()
    }
}

/// Sets the length of a training, where one is given.
fn put_steps(table: &mut Table, steps: Option<u64>) -> anyhow::Result<()> {
    if let Some(steps) = steps {
        put(table, "learner", "total_steps", i64::try_from(steps)?.into());
    }
    Ok(())
}

/// Configures the evaluation of a row on a person.
///
/// # Errors
///
/// One sentence: the key at fault.
pub(super) fn evaluation(
    program: &Program,
    training: &Config,
    person: &Person,
) -> anyhow::Result<Config> {
    let mut table = training.table.clone();
    overlay(&mut table, &person.set);
    Config::from_table(table, &program.registry)
}

/// Gives a training its seed and its name.
///
/// # Errors
///
/// As [`Config::from_table`].
pub(super) fn seeded(
    program: &Program,
    training: &Config,
    seed: u64,
    name: &str,
) -> anyhow::Result<Config> {
    let mut table = training.table.clone();
    table.insert("seed".to_owned(), i64::try_from(seed)?.into());
    put(&mut table, "run", "name", name.into());
    Config::from_table(table, &program.registry)
}

/// Computes the first digits of the hash over everything in a complete table that decides what a training computes, its
/// seed excepted.
pub(super) fn hash(table: &Table) -> String {
    let mut hash = Sha256::new();
    for (key, value) in deciding(table).iter().filter(|(key, _)| !is_free(key)) {
        hash.update(format!("{key}={value}\n"));
    }
    output::hex(&hash.finalize()).chars().take(HASH_DIGITS).collect()
}

fn is_free(key: &str) -> bool {
    FREE.iter().any(|free| key == *free || (free.ends_with('.') && key.starts_with(free)))
}

/// Checks that every profile on the command line takes the place of some part's, and no two of the same.
///
/// # Errors
///
/// One sentence that names it.
pub(super) fn check_profiles(
    program: &Program,
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
pub(super) fn read(program: &Program, file: &Path) -> anyhow::Result<Config> {
    let source = ConfigSource { config: Some(PathBuf::from(file)), ..ConfigSource::default() };
    config::load(&source, None, &program.catalog, &program.registry)
}

fn put(table: &mut Table, section: &str, key: &str, value: Value) {
    let below = table.entry(section).or_insert_with(|| Value::Table(Table::new()));
    if let Some(below) = below.as_table_mut() {
        below.insert(key.to_owned(), value);
    }
}
