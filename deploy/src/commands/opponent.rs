//! Who `--baseline` means: a script of the task, a script in a file, or the oracle.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use leadtime_eval::measure::Player;
use leadtime_runs::regular;
use leadtime_scripts::{Oracle, OracleBase, Script, ScriptPlayer};
use leadtime_sims::Environment;
use toml::Table;

/// The name of the clairvoyant player.
pub(super) const ORACLE: &str = "oracle";

/// Makes the players that `--baseline` names, in order; the oracle mends what the task's scripts and those in the files do.
pub(super) fn opponents(
    names: &[PathBuf],
    environment: &dyn Environment,
) -> anyhow::Result<Vec<Player>> {
    let files = names.iter().filter(|name| is_file(name));
    let scripts = files.map(|name| Ok((name, read(name)?)));
    let scripts = scripts.collect::<anyhow::Result<Vec<_>>>()?;
    let n_of = |wanted: &str| scripts.iter().filter(|(file, _)| stem(file) == wanted).count();
    let player = |path: &PathBuf| {
        let name = &path.to_string_lossy().into_owned();
        if let Some((_, script)) = scripts.iter().find(|(file, _)| *file == path) {
            // Two files of one name are told apart by their paths.
            let short = stem(path);
            let shown = if n_of(&short) > 1 { name } else { &short };
            return Player::scripted(shown, Box::new(ScriptPlayer::new(script.clone())));
        }
        // A world may have a script of that name.
        if name == ORACLE && !environment.baselines().contains(&ORACLE) {
            let written = scripts.iter().map(|(_, script)| OracleBase::Script(script.clone()));
            let bases = written.chain(named_bases(environment)).collect();
            return Player::scripted(ORACLE, Box::new(Oracle::new(bases)));
        }
        Player::baseline(name)
    };
    Ok(names.iter().map(player).collect())
}

/// Warns where a script plays the episodes by which its search chose it.
pub(super) fn warn_of_own_episodes(names: &[PathBuf], seed: u64) {
    for file in names.iter().filter(|name| is_file(name)) {
        let text = regular::read_to_string(file).unwrap_or_default();
        let searched = text.parse::<Table>().ok();
        let searched = searched.and_then(|text| text.get("search")?.get("seed")?.as_integer());
        if searched.is_some_and(|searched| u64::try_from(searched) == Ok(seed)) {
            tracing::warn!(
                script = %file.display(),
                "seed {seed} is that of its search, which chose it by these episodes; others tell more: take another --eval-seed"
            );
        }
    }
}

/// Lists the task's own scripts.
pub(super) fn named_bases(environment: &dyn Environment) -> impl Iterator<Item = OracleBase> {
    environment.baselines().iter().map(|&name| OracleBase::Named(name.to_owned()))
}

fn is_file(name: &Path) -> bool {
    name.extension().is_some_and(|extension| extension == "toml")
}

fn stem(name: &Path) -> String {
    name.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned())
}

fn read(file: &Path) -> anyhow::Result<Script> {
    let text = regular::read_to_string(file);
    let text = text.with_context(|| format!("reading {}", file.display()))?;
    let script = Script::read(&text).with_context(|| format!("script {}", file.display()))?;
    for oddity in script.oddities() {
        tracing::warn!("script {}: {oddity}", file.display());
    }
    Ok(script)
}
