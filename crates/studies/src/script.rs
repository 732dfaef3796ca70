//! The scripts of a row that the task does not have: one that is searched, and the oracle that mends what it does.
//!
//! A searched script is a file next to the runs, `scripts/<key>.toml`, named after everything that decides it but the program. It
//! is searched once, in the task that the row trains on and with as many steps as a training has. Later uses read the
//! file, whichever build has written it.

use std::fs;
use std::path::{Path, PathBuf};

use leadtime_config::Config;
use leadtime_eval::measure::Player;
use leadtime_runs::build::n_cores;
use leadtime_runs::{Tasks, regular, write_atomically};
use leadtime_scripts::{
    Error as ScriptError, Oracle, OracleBase, Script, ScriptPlayer, SearchSettings, search,
};
use serde::Serialize;
use tokio_util::sync::CancellationToken;

use crate::cache::file_name;
use crate::error::{Error, Placed as _};

/// What a row calls the script that is searched for it.
const SEARCHED: &str = "searched";
/// What a row calls the clairvoyant player.
const ORACLE: &str = "oracle";
/// The folder of the scripts, next to the runs.
const FOLDER: &str = "scripts";
/// How scripts are searched; a change that finds others adds 1.
const SEARCH_SCHEMA: u32 = 1;

/// Which of the two a row is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ScriptKind {
    Searched,
    Oracle,
}

/// A search that must be done before the row can be evaluated.
#[derive(Clone, Debug)]
pub(crate) struct PlannedSearch {
    kind: ScriptKind,
    config: Config,
    seed: u64,
    path: PathBuf,
}

/// What decides a searched script, the program excepted.
#[derive(Serialize)]
struct SearchKey<'a> {
    schema: u32,
    domain: &'a str,
    settings: &'a str,
    n_steps: u64,
    seed: u64,
}

impl PlannedSearch {
    /// Plans the search for a row; `None` if its script is one of the task's own.
    pub(crate) fn new(script: &str, config: &Config, seed: u64) -> Option<Self> {
        let kind = match script {
            SEARCHED => ScriptKind::Searched,
            ORACLE => ScriptKind::Oracle,
            _ => return None,
        };
        let key = SearchKey {
            schema: SEARCH_SCHEMA,
            domain: &config.task.domain,
            settings: &config.task.settings,
            n_steps: config.learner.total_steps,
            seed,
        };
        let path = config.run.directory.join(FOLDER).join(format!("{}.toml", file_name(&key)));
        Some(Self { kind, config: config.clone(), seed, path })
    }

    /// Returns whether the row is the script itself: as policies, it is evaluated as it was made, too.
    pub(crate) fn is_searched(&self) -> bool {
        self.kind == ScriptKind::Searched
    }

    /// Searches the script, unless that was done before.
    pub(crate) fn bring(&self, tasks: &Tasks, shutdown: &CancellationToken) -> Result<(), Error> {
        if self.path.exists() {
            return Ok(());
        }
        let (task, n_steps, seed) = (&self.config.task, self.config.learner.total_steps, self.seed);
        let make = || tasks.registry.build(task);
        let stop = || shutdown.is_cancelled();
        let settings = SearchSettings { n_steps, seed, n_threads: n_cores(), stop: &stop };
        tracing::info!(domain = %self.config.domain, n_steps, seed, "searching a script");
        let found = match search(&make, &settings, &mut |_| {}) {
            Err(ScriptError::Interrupted) => return Err(Error::Interrupted),
            found => found?,
        };
        let (steps, scripts) = (found.n_steps, found.n_candidates);
        let text = found.script.file(&format!(
            "[search]\ndomain = \"{}\"\nseed = {seed}\nsteps = {steps}\nscripts = {scripts}\n",
            task.domain
        ));
        let folder = self.path.parent().unwrap_or(Path::new("."));
        fs::create_dir_all(folder).map_err(Error::file("making", folder))?;
        write_atomically(&self.path, text.as_bytes()).map_err(Error::file("writing", &self.path))
    }

    /// Reads the script that was found.
    fn script(&self) -> Result<Script, Error> {
        let text =
            regular::read_to_string(&self.path).map_err(Error::file("reading", &self.path))?;
        Script::read(&text).at(self.path.display())
    }

    /// Returns the player under a title, and what decides what it does.
    pub(crate) fn player(&self, title: &str) -> Result<(Player, Vec<String>), Error> {
        let script = self.script()?;
        let rules = script.toml();
        Ok(match self.kind {
            ScriptKind::Searched => {
                let player = Player::scripted(title, Box::new(ScriptPlayer::new(script)));
                (player, vec![SEARCHED.to_owned(), rules])
            }
            ScriptKind::Oracle => {
                let oracle = Oracle::new(vec![OracleBase::Script(script)]);
                (Player::scripted(title, Box::new(oracle)), vec![ORACLE.to_owned(), rules])
            }
        })
    }

    /// Says how the row was made, a sentence each.
    pub(crate) fn facts(&self) -> Result<Vec<String>, Error> {
        let (n_steps, seed) = (self.config.learner.total_steps, self.seed);
        let rules = self.script()?.to_string().replace('\n', "; ");
        let rules = if rules.is_empty() { "keep silent".to_owned() } else { rules };
        let searched = format!("a script searched with {n_steps} steps, seed {seed}: {rules}");
        Ok(vec![match self.kind {
            ScriptKind::Searched => searched,
            ScriptKind::Oracle => format!("mends, on the episode itself, {searched}"),
        }])
    }
}
