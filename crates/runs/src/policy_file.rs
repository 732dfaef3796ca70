//! Policy files: they carry the whole configuration they were trained under, so one file is enough to evaluate them.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use leadtime_config::{Config, ConfigError, Override};
use leadtime_eval::measure::{Choice, Player};
use leadtime_policy::{Parameters, read_metadata};
use leadtime_proto::phrase::with_causes;
use leadtime_proto::{PolicySpec, hex};
use leadtime_sims::registry::Registry;
use serde_json::json;
use thiserror::Error;

use crate::ForkOrigin;
use crate::command_line::shell_argument;
use crate::contents::{CONFIG, checkpoints, is_run};
use crate::digest::sha256;
use crate::find::did_you_mean_run;
use crate::regular;

/// File of the newest policy in a run directory.
pub const LAST_POLICY: &str = "policy.safetensors";
/// File of the best policy in a run directory.
pub const BEST_POLICY: &str = "best.safetensors";
/// Metadata key of the task's domain.
const DOMAIN_KEY: &str = "domain";
/// Metadata key of the configuration, as TOML.
const CONFIG_KEY: &str = "config";
/// Metadata key of the updates that made the policy.
pub(crate) const VERSION: &str = "policy_version";

/// Metadata key of the digest over the weights; files that older builds wrote do not have it.
pub(crate) const WEIGHTS_SHA256: &str = "weights_sha256";

/// Why a policy cannot be used.
#[derive(Debug, Error)]
pub enum PolicyFileError {
    /// There is no policy of that name, or the file holds something else; the sentence says what.
    #[error("{0}")]
    NoPolicy(String),
    /// The file cannot be read.
    #[error("reading {}", path.display())]
    Read {
        /// The file that was to be read.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The configuration in the file, or a change of it, is refused.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A change of the task needs another policy; the sentence says which change, and what it needs.
    #[error("{0}")]
    OtherTask(String),
    /// The weights are not those that were written.
    #[error(
        "{} is damaged: its weights are not those that were written; take the file from a copy{}",
        .0.display(), made_again(.0)
    )]
    Damaged(PathBuf),
    /// The weights are not those of the task's networks.
    #[error("{} does not fit its task", path.display())]
    Misfit {
        /// The file whose weights these are.
        path: PathBuf,
        /// Which tensor does not fit.
        source: leadtime_policy::Error,
    },
}

/// A policy with everything that is needed to let it act.
#[derive(Debug)]
pub struct LoadedPolicy {
    /// Where it was found.
    pub path: PathBuf,
    /// What it was trained under, with changes for evaluation.
    pub config: Config,
    /// The weights.
    pub parameters: Parameters,
    /// Updates that made it; 0 where the file does not say so.
    pub n_updates: u64,
    /// SHA-256 over the file, in hexadecimal.
    pub sha256: String,
}

impl LoadedPolicy {
    /// Loads a policy file, or the best policy of a run (its newest, where no best one is known).
    ///
    /// # Errors
    ///
    /// [`PolicyFileError`] if there is none, or if it does not fit its task after the changes.
    pub fn load(
        registry: &Registry,
        runs: &Path,
        name: &Path,
        changes: &[Override],
    ) -> Result<Self, PolicyFileError> {
        let path = find(runs, name, [BEST_POLICY, LAST_POLICY])?;
        let (bytes, metadata) = read(&path)?;
        let Some(text) = metadata.get(CONFIG_KEY) else {
            return Err(foreign(&path, "it has no configuration in its metadata"));
        };
        let place = format!("the configuration in {}", path.display());
        let config = Config::stored(&place, text, changes, registry)?;
        let read = weights(&path, &bytes, &metadata, &config.policy);
        if !changes.is_empty() && matches!(read, Err(PolicyFileError::Misfit { .. })) {
            let own = Config::stored(&place, text, &[], registry)?;
            if let Some(sentence) = other_shape(&own.policy, &config.policy, changes) {
                return Err(PolicyFileError::OtherTask(sentence));
            }
        }
        let (parameters, _) = read?;
        let n_updates = metadata.get(VERSION).and_then(|version| version.parse().ok());
        let (n_updates, sha256) = (n_updates.unwrap_or(0), sha256(&bytes));
        Ok(Self { path, config, parameters, n_updates, sha256 })
    }

    /// Makes it a player under a name; without `action` it chooses as its configuration says.
    ///
    /// # Errors
    ///
    /// [`leadtime_eval::Error`] if the network cannot be built.
    pub fn player(
        &self,
        name: &str,
        action: Option<Choice>,
    ) -> Result<Player, leadtime_eval::Error> {
        let action = action.unwrap_or(self.config.evaluation.action);
        Ok(Player::policy(name, &self.config.policy, &self.parameters, action)?)
    }
}

/// The weights that a new run is to start from.
#[derive(Clone, Debug)]
pub struct Fork {
    /// What they are, for the run's record.
    pub origin: ForkOrigin,
    /// The bytes of the policy file that they were read from.
    pub bytes: Vec<u8>,
}

impl Fork {
    /// Finds the file that the weights are read from.
    ///
    /// # Errors
    ///
    /// [`PolicyFileError`] if there is none.
    pub fn find(config: &Config, run: &Path) -> Result<PathBuf, PolicyFileError> {
        find(&config.run.directory, run, [LAST_POLICY, BEST_POLICY])
    }

    /// Reads the newest weights of another run, or a policy file.
    ///
    /// # Errors
    ///
    /// [`PolicyFileError`] if there are none, or if they are of another task or do not fit the new run's networks.
    pub fn read(config: &Config, run: &Path) -> Result<Self, PolicyFileError> {
        let path = Self::find(config, run)?;
        let (bytes, metadata) = read(&path)?;
        let weights = weights(&path, &bytes, &metadata, &config.policy);
        let (_, weights_sha256) =
            weights.map_err(|error| of_another(error, config, run, &metadata))?;
        let origin = ForkOrigin { run: run.display().to_string(), weights_sha256 };
        Ok(Self { origin, bytes })
    }
}

/// Says in what the weights of a run are others than the new run needs, where they do not fit it.
fn of_another(
    error: PolicyFileError,
    config: &Config,
    run: &Path,
    metadata: &BTreeMap<String, String>,
) -> PolicyFileError {
    let PolicyFileError::Misfit { source, .. } = &error else { return error };
    let run = run.display();
    let domain = metadata.get(DOMAIN_KEY).filter(|domain| *domain != config.domain.as_str());
    PolicyFileError::NoPolicy(match domain {
        Some(domain) => format!(
            "`{run}` was trained on {domain}, and the new run is of {}; --fork needs a run of the same task",
            config.domain
        ),
        None => format!(
            "`{run}` has another observation, other choices or other networks (`policy`) than the new run: {}",
            with_causes(source)
        ),
    })
}

/// Returns the digest over the parameters in a policy file, as a run's result has it.
pub(crate) fn weights_digest(
    bytes: &[u8],
    policy: &PolicySpec,
) -> Result<String, leadtime_policy::Error> {
    Ok(hex::encode(&Parameters::from_safetensors(bytes, policy)?.digest()?))
}

/// Returns whether a run's directory holds a policy.
pub(crate) fn is_in(directory: &Path) -> bool {
    [LAST_POLICY, BEST_POLICY].iter().any(|name| directory.join(name).is_file())
}

/// Returns how many updates made a policy file; 0 if it is not there.
pub(crate) fn n_updates(path: &Path) -> io::Result<u64> {
    let Some(bytes) = regular::if_there(regular::read(path))? else { return Ok(0) };
    let version = read_metadata(&bytes).ok().and_then(|entries| entries.get(VERSION)?.parse().ok());
    // One that cannot be read is somebody's work all the same.
    Ok(version.unwrap_or(1))
}

/// Returns what goes into every policy file of a run: enough for somebody else's program to use it.
pub fn metadata(config: &Config, run: &str) -> BTreeMap<String, String> {
    let description = &config.description;
    let names = description.observation.quantities().into_iter().map(|quantity| quantity.name);
    let entries = [
        (DOMAIN_KEY, config.domain.to_string()),
        // Names, numbers and lists always are JSON.
        ("architecture", json!(config.policy).to_string()),
        ("observation", json!(names.collect::<Vec<_>>()).to_string()),
        ("actions", json!(description.actions).to_string()),
        (CONFIG_KEY, config.table.to_string()),
        ("run", run.to_owned()),
        ("program", format!("leadtime {}", env!("CARGO_PKG_VERSION"))),
    ];
    entries.into_iter().map(|(key, value)| (key.to_owned(), value)).collect()
}

/// Says what a file is that holds no safetensors: most often it is one of a few things.
pub fn what_it_is(bytes: &[u8], error: &dyn std::error::Error) -> String {
    let start = bytes.get(..1_024).unwrap_or(bytes);
    let text = str::from_utf8(start).or_else(|error| match error.error_len() {
        // Cut inside of a character.
        None => str::from_utf8(&start[..error.valid_up_to()]),
        Some(_) => Err(error),
    });
    let is_text = |text: &&str| !text.contains('\0') && !text.trim().is_empty();
    match text.ok().filter(is_text).map(|text| text.trim_start().to_lowercase()) {
        _ if bytes.is_empty() => "it is empty".to_owned(),
        Some(text) if text.starts_with("version https://git-lfs") => {
            "it is a Git LFS pointer; fetch the file itself with `git lfs pull`".to_owned()
        }
        Some(text) if text.starts_with("<!doctype") || text.starts_with("<html") => {
            "it is an HTML page; download the file itself".to_owned()
        }
        Some(_) => "it is text".to_owned(),
        None => with_causes(error),
    }
}

fn read(path: &Path) -> Result<(Vec<u8>, BTreeMap<String, String>), PolicyFileError> {
    let unread = |source| PolicyFileError::Read { path: path.to_owned(), source };
    let bytes = regular::read(path).map_err(unread)?;
    match read_metadata(&bytes) {
        Ok(metadata) => Ok((bytes, metadata)),
        Err(error) => Err(foreign(path, &what_it_is(&bytes, &error))),
    }
}

/// Reads the weights in a policy file, and checks them by the digest that was written with them; returns both.
fn weights(
    path: &Path,
    bytes: &[u8],
    metadata: &BTreeMap<String, String>,
    policy: &PolicySpec,
) -> Result<(Parameters, String), PolicyFileError> {
    let misfit = |source| PolicyFileError::Misfit { path: path.to_owned(), source };
    let parameters = Parameters::from_safetensors(bytes, policy).map_err(misfit)?;
    let digest = hex::encode(&parameters.digest().map_err(misfit)?);
    match metadata.get(WEIGHTS_SHA256) {
        Some(written) if *written != digest => Err(PolicyFileError::Damaged(path.to_owned())),
        _ => Ok((parameters, digest)),
    }
}

/// Says what changes of a task have to do with what its policy observes and chooses; `None` if they change neither.
fn other_shape(own: &PolicySpec, changed: &PolicySpec, changes: &[Override]) -> Option<String> {
    let with: Vec<String> = changes.iter().map(|change| format!("`{change}`")).collect();
    let leave = if with.len() == 1 { "leave it out" } else { "leave out what changes that" };
    let differ = |does: &str, [own, changed]: [usize; 2], what: &str| {
        let with = with.join(" and ");
        let says = format!("the policy {does} {own} {what}; with {with} the task has {changed}");
        (own != changed).then(|| format!("{says}: {leave}"))
    };
    let specs = [own, changed];
    let observed = differ("observes", specs.map(|spec| spec.obs_dim), "numbers");
    observed.or_else(|| differ("has", specs.map(|spec| spec.actions.n_choices()), "choices"))
}

fn foreign(path: &Path, reason: &str) -> PolicyFileError {
    let (shown, again) = (path.display(), made_again(path));
    PolicyFileError::NoPolicy(format!("{shown} is not a policy of Leadtime: {reason}{again}"))
}

/// Says how a run writes a policy of its own again, if it can: a learner that finds none takes it from the newest checkpoint.
fn made_again(path: &Path) -> String {
    let is_own = [LAST_POLICY, BEST_POLICY].iter().any(|name| path.ends_with(name));
    let directory = path.parent().filter(|directory| is_own && is_run(directory));
    let Some(directory) = directory else { return String::new() };
    if !checkpoints(directory).is_ok_and(|found| !found.is_empty()) {
        return String::new();
    }
    let config = shell_argument(directory.join(CONFIG).as_os_str());
    format!("; remove it, and `leadtime up -c {config}` writes it again from the run's checkpoints")
}

fn find(runs: &Path, name: &Path, files: [&str; 2]) -> Result<PathBuf, PolicyFileError> {
    if name.is_file() {
        return Ok(name.to_owned());
    }
    let directories = [name.to_owned(), runs.join(name)];
    let mut paths = directories.iter().flat_map(|directory| files.map(|file| directory.join(file)));
    paths.find(|path| path.is_file()).ok_or_else(|| {
        let meant = did_you_mean_run(runs, name);
        let (name, runs) = (name.display(), runs.display());
        PolicyFileError::NoPolicy(format!(
            "`{name}` is no policy file, and no run in {runs} with a policy{meant}"
        ))
    })
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn a_run_whose_name_is_misspelt_is_guessed() {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(dir.path().join("lander-1")).unwrap();
        let says = |name: &str| {
            let files = [BEST_POLICY, LAST_POLICY];
            find(dir.path(), Path::new(name), files).unwrap_err().to_string()
        };
        assert!(says("landr-1").ends_with("; did you mean `lander-1`?"), "{}", says("landr-1"));
        assert!(says("moon").ends_with(" with a policy"), "{}", says("moon"));
        assert!(says("lander-1").ends_with(" with a policy"), "{}", says("lander-1"));
    }

    #[test]
    fn weights_of_another_task_are_told_from_those_of_another_shape() {
        let runs = tempfile::tempdir().unwrap();
        let file = runs.path().join("one.safetensors");
        let config = |base, set: &[&str]| crate::test_support::config(runs.path(), base, "s", set);
        let one = config("cartpole", &[]);
        let parameters = Parameters::initialize(&one.policy, 1).unwrap();
        fs::write(&file, parameters.to_safetensors(&metadata(&one, "one")).unwrap()).unwrap();
        let fork = |config: &Config| Fork::read(config, &file).map_err(|error| error.to_string());
        fork(&one).unwrap();
        let other = fork(&config("lander", &[])).unwrap_err();
        let told = "was trained on cartpole, and the new run is of lander; --fork needs a run of the same task";
        assert!(other.ends_with(told), "{other}");
        let wider = fork(&config("cartpole", &["policy.hidden=[32]"])).unwrap_err();
        assert!(wider.contains("other networks (`policy`) than the new run: "), "{wider}");
    }

    #[test]
    fn a_change_that_needs_another_policy_is_told_in_the_numbers_of_the_task() {
        let dir = tempfile::tempdir().unwrap();
        let config = crate::test_support::config(dir.path(), "lander", "r", &[]);
        let parameters = Parameters::initialize(&config.policy, 1).unwrap();
        let file = dir.path().join("p.safetensors");
        fs::write(&file, parameters.to_safetensors(&metadata(&config, "r")).unwrap()).unwrap();
        let registry = crate::Tasks::new().registry;
        let load = |change: &str| {
            let changes = [Override::parse(change).unwrap()];
            LoadedPolicy::load(&registry, dir.path(), &file, &changes)
        };
        load("human.reaction_delay=3").unwrap();
        let told = load("notifier.history=1").unwrap_err().to_string();
        let n = config.policy.obs_dim;
        let begins =
            format!("the policy observes {n} numbers; with `notifier.history = 1` the task has ");
        assert!(told.starts_with(&begins) && told.ends_with(": leave it out"), "{told}");
    }

    #[test]
    fn files_that_are_often_taken_for_policies_are_recognised() {
        let error = io::Error::other("header too large");
        let is = |bytes: &[u8]| what_it_is(bytes, &error);
        assert!(is(b"version https://git-lfs.github.com/spec/v1\noid sha256:00").contains("LFS"));
        assert!(is(b"\n<!DOCTYPE html><html>").contains("HTML"));
        assert_eq!(is("not a policy, nor \u{e4} one".as_bytes()), "it is text");
        assert_eq!(is(b""), "it is empty");
        assert_eq!(is(&[0; 64]), "header too large");
    }

    #[test]
    fn a_damaged_policy_of_a_run_that_has_checkpoints_can_be_made_again() {
        let runs = tempfile::tempdir().unwrap();
        let run = runs.path().join("r");
        fs::create_dir_all(run.join("checkpoints")).unwrap();
        let (best, config) = (run.join(BEST_POLICY), run.join("config.toml"));
        let refused = || {
            fs::write(&best, "").unwrap();
            Fork::read(&crate::test_support::config(runs.path(), "cartpole", "s", &[]), &best)
                .unwrap_err()
                .to_string()
        };
        fs::write(&config, "").unwrap();
        assert!(refused().ends_with("it is empty"), "{}", refused());
        fs::write(run.join("checkpoints/000000000001.checkpoint"), "state").unwrap();
        let again = format!(
            "it is empty; remove it, and `leadtime up -c {}` writes it again from the run's checkpoints",
            config.display()
        );
        assert!(refused().ends_with(&again), "{}", refused());
        let damaged = PolicyFileError::Damaged(best.clone()).to_string();
        assert!(damaged.contains("from a copy; remove it, and"), "{damaged}");
        let other = PolicyFileError::Damaged(run.join("copy.safetensors")).to_string();
        assert!(other.ends_with("take the file from a copy"), "{other}");
    }
}
