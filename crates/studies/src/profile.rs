//! From a profile and its differences to the configuration of a training, or of an evaluation.

use std::path::Path;

use leadtime_config::identity::{self, Change};
use leadtime_config::{Config, ConfigSource, Layer, Override};
use leadtime_proto::hex;
use leadtime_runs::Tasks;
use toml::Table;

use crate::catalog::{self, NamedStudy};
use crate::error::{Error, Placed as _, ensure};
use crate::request::StudyRequest;
use crate::study::{StudyPart, StudyRow, WhichPolicy};

/// Keys that options set, and which ones.
const OPTIONS: [(&str, &str); 3] =
    [("seed", "--seeds"), ("run.directory", "--runs"), ("run.name", "--runs")];
/// Digits of a configuration's hash in names and tables.
const HASH_DIGITS: usize = 10;

/// A part's profile, with the name that tables give it.
#[derive(Clone, Debug)]
pub(crate) struct Profile {
    /// The name of a built-in configuration, or its file.
    pub(crate) name: String,
    /// The complete configuration, checked.
    pub(crate) config: Config,
}

impl Profile {
    /// Loads the part's own profile, or the requested one for its domain.
    pub(crate) fn load(
        tasks: &Tasks,
        study: &str,
        part: &StudyPart,
        request: &StudyRequest,
    ) -> Result<Self, Error> {
        let own = of_study(tasks, study, &part.profile)?;
        for other in &request.profiles {
            let config = read(tasks, other).at("--profile")?;
            if config.domain == own.domain {
                return Ok(Self { name: other.display().to_string(), config });
            }
        }
        Ok(Self { name: part.profile.clone(), config: own })
    }

    /// Configures the training of a row: the profile, then the part's length, then the row's differences, then the
    /// request's.
    pub(crate) fn training(
        &self,
        tasks: &Tasks,
        part: &StudyPart,
        row: &StudyRow,
        request: &StudyRequest,
    ) -> Result<Config, Error> {
        for change in &request.set {
            let key = change.key();
            if let Some((_, option)) = OPTIONS.iter().find(|(known, _)| key == *known) {
                return Err(Error::Refused(format!(
                    "--set {key}: trainings of a study have seeds and names of their own; see {option}"
                )));
            }
        }
        let steps = |steps: u64| Layer::text("steps", format!("learner.total_steps = {steps}"));
        let shortened = request.steps.or(request.quick.then_some(part.quick_steps));
        let runs = Override::new("run.directory", request.runs.to_string_lossy().as_ref());
        let layers = part.steps.map(steps).into_iter().chain([Layer::table("`set`", &row.set)]);
        let layers = layers.chain(shortened.map(steps)).chain([Layer::option("--runs", &runs)]);
        let layers = layers.chain(request.set.iter().map(Layer::set));
        let mut config = self.config.with(layers, &tasks.registry)?;
        // A path need not be UTF-8, and a table is.
        config.run.directory.clone_from(&request.runs);
        Ok(config)
    }

    /// Lists the settings in which a training of which this policy is taken differs from the profile.
    pub(crate) fn differences(&self, config: &Config, policy: WhichPolicy) -> Vec<String> {
        let changes = identity::difference(&self.config.table, &config.table).into_iter();
        let decides =
            |change: &Change| change.key != "seed" && decides(&change.key, &config.table, policy);
        let sentence = |change: Change| match change.after.as_str() {
            "" => format!("{} left out", change.key),
            after => format!("{} = {after}", change.key),
        };
        changes.filter(decides).map(sentence).collect()
    }
}

/// Computes the first digits of the hash over everything that decides this policy of a training, its seed excepted.
pub(crate) fn hash(table: &Table, policy: WhichPolicy) -> String {
    let hash = match policy {
        WhichPolicy::Last => identity::of_training(table),
        WhichPolicy::Best => identity::of_best(table),
    };
    hex::encode(&hash).chars().take(HASH_DIGITS).collect()
}

/// Returns whether a key decides this policy of a training with these settings.
pub(crate) fn decides(key: &str, table: &Table, policy: WhichPolicy) -> bool {
    let is_best = policy == WhichPolicy::Best && identity::decides_best(key);
    is_best || identity::decides_weights(key, table)
}

/// Checks that every requested profile takes the place of some part's, and no two of the same.
pub(crate) fn check_profiles(
    tasks: &Tasks,
    studies: &[NamedStudy],
    request: &StudyRequest,
) -> Result<(), Error> {
    let mut seen = Vec::new();
    for file in &request.profiles {
        let domain = read(tasks, file).at("--profile")?.domain;
        let mut fits = false;
        let parts = studies
            .iter()
            .flat_map(|named| named.study.parts.iter().map(move |part| (named, part)));
        for (named, part) in parts.filter(|(_, part)| request.wants_part(part)) {
            fits |= of_study(tasks, &named.name, &part.profile)?.domain == domain;
        }
        let place = format!("--profile {}", file.display());
        ensure(fits, || {
            format!("{place}: no part that was asked for is about the domain `{domain}`")
        })?;
        ensure(!seen.contains(&domain), || {
            format!("{place}: there is another one for the domain `{domain}`")
        })?;
        seen.push(domain);
    }
    Ok(())
}

/// Reads a configuration that a study names. One that comes with the program means the built-in configurations, whatever lies
/// in the folder where it is carried out.
pub(crate) fn of_study(tasks: &Tasks, study: &str, profile: &str) -> Result<Config, Error> {
    let built_in = catalog::is_built_in(study).then(|| tasks.catalog.file(profile)).flatten();
    let Some(file) = built_in else { return read(tasks, Path::new(profile)) };
    let source = ConfigSource { file: Some(file), ..ConfigSource::default() };
    Ok(Config::load(&source, &tasks.catalog, &tasks.registry)?)
}

/// Reads a configuration as it is: a file or a built-in one.
pub(crate) fn read(tasks: &Tasks, file: &Path) -> Result<Config, Error> {
    Ok(tasks.configure(Some(file), ConfigSource::default())?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_built_in_study_means_built_in_profiles_and_ones_own_its_files() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("known");
        let name = file.to_str().unwrap();
        std::fs::write(&file, "base = \"lander\"\nseed = 6").unwrap();
        let mut tasks = Tasks::new();
        tasks.catalog.add(name, "base = \"lander\"\nseed = 5");
        let seed = |study: &str| of_study(&tasks, study, name).unwrap().seed;
        assert_eq!([seed("table1"), seed("my-study")], [5, 6]);
    }
}
