//! What is evaluated: a row's policy of one training seed, or its script; and where its evaluations are kept.

use std::path::{Path, PathBuf};

use leadtime_eval::measure::{Choice, Player};
use leadtime_runs::{LoadedPolicy, Tasks};

use crate::error::Error;
use crate::plan::{PlannedRow, PlannedTraining};
use crate::study::WhichPolicy;

/// The folder of evaluations: in a run's directory, and for scripts, which have no run, next to the runs.
const FOLDER: &str = "evaluations";

/// A player with what decides how it plays.
#[derive(Clone, Debug)]
pub(crate) struct EvalCandidate {
    /// The player, under the row's title.
    pub(crate) player: Player,
    /// Everything that decides what the player does: the bytes of its policy, its networks and its way of choosing, or
    /// its script.
    pub(crate) identity: Vec<String>,
    /// Where its evaluations are kept.
    pub(crate) directory: PathBuf,
}

impl EvalCandidate {
    /// Lets a script play.
    pub(crate) fn script(runs: &Path, script: &str, title: &str) -> Self {
        Self {
            player: Player::baseline(script).named(title),
            identity: vec!["script".to_owned(), script.to_owned()],
            directory: runs.join(FOLDER),
        }
    }

    pub(crate) fn is_script(&self, name: &str) -> bool {
        self.player.is_script(name)
    }

    /// Returns a row's candidates of the first `n_seeds` training seeds.
    pub(crate) fn of(
        tasks: &Tasks,
        row: &PlannedRow,
        which: WhichPolicy,
        choice: Choice,
        n_seeds: usize,
    ) -> Result<Vec<Self>, Error> {
        if let Some(search) = &row.search {
            let (player, identity) = search.player(&row.row.title)?;
            let directory = row.config.run.directory.join(FOLDER);
            return Ok(vec![Self { player, identity, directory }; n_seeds]);
        }
        if let Some(script) = &row.row.script {
            let script = Self::script(&row.config.run.directory, script, &row.row.title);
            return Ok(vec![script; n_seeds]);
        }
        let spec = &row.config.policy;
        let networks = serde_json::to_string(spec).unwrap_or_default();
        let policy = |training: &PlannedTraining| {
            let (runs, file) = (&training.config.run.directory, training.policy(which));
            let loaded = LoadedPolicy::load(&tasks.registry, runs, &file, &[])?;
            let identity = ["policy", &loaded.sha256, &networks, &format!("{choice:?}")];
            Ok(Self {
                player: Player::policy(&row.row.title, spec, &loaded.parameters, choice)?,
                identity: identity.map(str::to_owned).to_vec(),
                directory: training.directory().join(FOLDER),
            })
        };
        row.trainings.iter().take(n_seeds).map(policy).collect()
    }
}
