//! Who is judged: a row's policy of one training seed, or its script, and where its judged cells are kept.

use std::path::PathBuf;

use leadtime_eval::measure::Player;
use leadtime_runs::LoadedPolicy;

use super::plan::{PlannedRow, Training};
use super::study::WhichPolicy;
use crate::cli::CompareArgs;
use crate::commands::evaluation;
use leadtime_config::EvaluationAction;
use leadtime_runs::Tasks;

/// The folder of judged cells: in a run's directory, and for scripts, which have no run, beside the runs.
const FOLDER: &str = "evaluations";

/// A player with what decides how it plays.
#[derive(Clone, Debug)]
pub(super) struct Contender {
    /// The player, under the row's title.
    pub(super) player: Player,
    /// Everything that decides what the player does: the bytes of its policy, its networks and its way of choosing, or
    /// its script.
    pub(super) identity: Vec<String>,
    /// Where its judged cells are kept.
    pub(super) directory: PathBuf,
}

impl Contender {
    /// Lets a script play.
    pub(super) fn script(args: &CompareArgs, script: &str, title: &str) -> Self {
        Self {
            player: Player::baseline(script).named(title),
            identity: vec!["script".to_owned(), script.to_owned()],
            directory: args.runs.join(FOLDER),
        }
    }

    fn policy(
        program: &Tasks,
        row: &PlannedRow,
        training: &Training,
        which: WhichPolicy,
        action: EvaluationAction,
    ) -> anyhow::Result<Self> {
        let file = training.policy(which);
        let runs = &training.config.run.directory;
        let loaded = LoadedPolicy::load(&program.registry, runs, &file, &[])?;
        let networks = serde_json::to_string(&row.config.policy)?;
        let choice = serde_json::to_string(&action)?;
        Ok(Self {
            player: evaluation::policy(&row.row.title, &row.config, &loaded.parameters, action)?,
            identity: vec!["policy".to_owned(), loaded.sha256, networks, choice],
            directory: training.directory().join(FOLDER),
        })
    }
}

/// Returns a row's contenders of the first `n_seeds` training seeds.
///
/// # Errors
///
/// A policy that cannot be read, or does not fit its task.
pub(super) fn of(
    program: &Tasks,
    args: &CompareArgs,
    which: WhichPolicy,
    row: &PlannedRow,
    action: EvaluationAction,
    n_seeds: usize,
) -> anyhow::Result<Vec<Contender>> {
    if let Some(script) = &row.row.script {
        let script = Contender::script(args, script, &row.row.title);
        return Ok(vec![script; n_seeds]);
    }
    let policy = |training| Contender::policy(program, row, training, which, action);
    row.trainings.iter().take(n_seeds).map(policy).collect()
}
