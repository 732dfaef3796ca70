//! Policy files: they carry the whole configuration they were trained under, so one file is enough to judge them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context as _;
use leadtime_policy::{Parameters, read_metadata};
use sha2::{Digest as _, Sha256};

use crate::progress::sink::{BEST_POLICY, LAST_POLICY};
use crate::record::write_atomically;
use crate::{Program, output};
use leadtime_config::{Config, Override};

/// File in a forked run's directory that holds what it starts from.
const INITIAL_POLICY: &str = "initial.safetensors";
/// Metadata key of the configuration, as TOML.
const CONFIG: &str = "config";

/// A policy with everything that is needed to let it act.
#[derive(Debug)]
pub(super) struct LoadedPolicy {
    /// Where it was found.
    pub(super) path: PathBuf,
    /// What it was trained under, with changes for evaluation.
    pub(super) config: Config,
    /// The weights.
    pub(super) parameters: Parameters,
    /// SHA-256 over the file, in hexadecimal.
    pub(super) sha256: String,
}

/// Returns what goes into every policy file of a run.
pub(super) fn metadata(config: &Config, run: &str) -> BTreeMap<String, String> {
    let specification = serde_json::to_vec(&config.policy).unwrap_or_default();
    let digest = output::hex(&Sha256::digest(&specification));
    let entries = [
        ("domain", config.domain.to_string()),
        ("specification_sha256", digest),
        (CONFIG, config.table.to_string()),
        ("run", run.to_owned()),
        ("program", format!("leadtime {}", env!("CARGO_PKG_VERSION"))),
    ];
    entries.into_iter().map(|(key, value)| (key.to_owned(), value)).collect()
}

/// Loads a policy file, or the best policy of a run (its newest, where no best one is known).
///
/// # Errors
///
/// One sentence: what was not found, or what is wrong with it.
pub(super) fn load(
    program: &Program,
    runs: &Path,
    name: &str,
    changes: &[Override],
) -> anyhow::Result<LoadedPolicy> {
    let path = find(runs, name, [BEST_POLICY, LAST_POLICY])?;
    let bytes = std::fs::read(&path).with_context(|| format!("reading {}", path.display()))?;
    let not_ours = || format!("{} is not a policy of Leadtime", path.display());
    let metadata = read_metadata(&bytes).with_context(not_ours)?;
    let text = metadata.get(CONFIG).with_context(not_ours)?;
    let place = format!("the configuration in {}", path.display());
    let config = Config::stored(&place, text, changes, &program.registry)?;
    let parameters = Parameters::from_safetensors(&bytes, &config.policy)
        .with_context(|| format!("{} does not fit its task", path.display()))?;
    let sha256 = output::hex(&Sha256::digest(&bytes));
    Ok(LoadedPolicy { path, config, parameters, sha256 })
}

/// Reads the weights of another run that a new run is to start from.
///
/// # Errors
///
/// If there are none, or if they do not fit the new run's task and networks.
pub(super) fn read_fork(config: &Config, run: &str) -> anyhow::Result<Vec<u8>> {
    let path = find(&config.run.directory, run, [LAST_POLICY, BEST_POLICY]).context("--fork")?;
    let bytes = std::fs::read(&path).with_context(|| format!("reading {}", path.display()))?;
    Parameters::from_safetensors(&bytes, &config.policy)
        .with_context(|| format!("--fork {run}: {} does not fit this run", path.display()))?;
    Ok(bytes)
}

/// Puts them into the new run's directory, where every start of its learner finds them.
///
/// # Errors
///
/// Whatever the file system says, with the path.
pub(super) fn write_fork(directory: &Path, weights: &[u8]) -> anyhow::Result<()> {
    let path = directory.join(INITIAL_POLICY);
    write_atomically(&path, weights).with_context(|| format!("writing {}", path.display()))
}

/// Returns the weights that a forked run starts from.
pub(super) fn initial(directory: &Path) -> Option<Arc<[u8]>> {
    std::fs::read(directory.join(INITIAL_POLICY)).ok().map(Arc::from)
}

fn find(runs: &Path, name: &str, files: [&str; 2]) -> anyhow::Result<PathBuf> {
    let given = PathBuf::from(name);
    if given.is_file() {
        return Ok(given);
    }
    [given, runs.join(name)]
        .iter()
        .flat_map(|directory| files.map(|file| directory.join(file)))
        .find(|path| path.is_file())
        .with_context(|| {
            format!("`{name}` is no policy file, and no run in {} with a policy", runs.display())
        })
}
