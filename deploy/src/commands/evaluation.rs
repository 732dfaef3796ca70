//! Evaluates several players on the same episodes and compares them.

use std::path::Path;
use std::thread::available_parallelism;

use anyhow::{Context as _, ensure};
use leadtime_config::Config;
use leadtime_eval::measure::{
    Choice, Comparison, Evaluation, PlaySettings, Player, evaluate, measure_names,
};
use leadtime_numerics::stats::Bootstrap;
use leadtime_policy::Parameters;
use leadtime_proto::phrase::did_you_mean;
use leadtime_runs::{EvaluationRecord, Tasks};

use crate::output;

/// Default seed of evaluations, which no run trains with by default: nothing is evaluated on its training episodes.
pub(super) const EVAL_SEED: u64 = 1_000_000;

/// The name of a trained policy in tables.
pub(super) const TRAINED: &str = "trained";
/// The player that shows what the listener does alone.
pub(super) const UNAIDED: &str = "unaided";

/// Makes a policy a player under a name.
pub(super) fn policy(
    name: &str,
    config: &Config,
    parameters: &Parameters,
    action: Choice,
) -> anyhow::Result<Player> {
    Ok(Player::policy(name, &config.policy, parameters, action)?)
}

/// Lists a policy and everybody whom it is compared with: the task's scripts, and the network before training.
pub(super) fn players(
    tasks: &Tasks,
    trained: Player,
    config: &Config,
    action: Choice,
) -> anyhow::Result<Vec<Player>> {
    let environment = tasks.registry.build(&config.task)?;
    let scripts = environment.baselines().iter().map(|script| Player::baseline(script));
    let untrained = Player::untrained(&config.policy, config.seed, action)?;
    Ok([trained].into_iter().chain(scripts).chain([untrained]).collect())
}

/// Returns how many threads play episodes: as many as there are cores, for the results do not depend on it.
pub(super) fn n_threads() -> usize {
    available_parallelism().map_or(1, usize::from)
}

/// Plays the same episodes with every player.
pub(super) fn evaluate_all(
    tasks: &Tasks,
    config: &Config,
    players: &[Player],
    n_episodes: u32,
    seed: u64,
) -> anyhow::Result<Vec<Evaluation>> {
    let make = || tasks.registry.build(&config.evaluation.task);
    let settings = PlaySettings::new(u64::from(n_episodes), seed).threads(n_threads());
    let evaluate = |player| Ok(evaluate(&make, player, &settings)?);
    players.iter().map(evaluate).collect()
}

/// Writes an evaluation into the directory of its run.
pub(super) fn save(record: &EvaluationRecord, run: &Path, config: &Config) -> anyhow::Result<()> {
    record
        .write(run, config)
        .with_context(|| format!("writing the evaluation into {}", run.display()))
}

/// Returns the measure by which players of a task are compared: success where it is known.
pub(super) fn main_measure(config: &Config) -> &'static str {
    if config.env.metrics.iter().any(|name| name == "success") { "success" } else { "return" }
}

/// Checks, before anything is played, that a task knows some measures.
pub(super) fn check_measures(config: &Config, measures: &[String]) -> anyhow::Result<()> {
    let known = measure_names(&config.env.metrics);
    for name in measures {
        let (told, meant) =
            (known.join(", "), did_you_mean(name, known.iter().map(String::as_str)));
        ensure!(known.contains(name), "there is no measure `{name}`{meant}; known: {told}");
    }
    Ok(())
}

/// Prints a comparison: every measure, or the main ones and how many there are beside them.
pub(super) fn print(comparison: &Comparison, all: bool) {
    output::line(comparison.text(all).trim_end());
    let n = comparison.n_further();
    if !all && n > 0 {
        let measures = if n == 1 { "measure" } else { "measures" };
        output::note(&format!("({n} more {measures} with --all)"));
    }
}

/// Compares the first player with every other one, in the task's main measure and in the given ones.
pub(super) fn compare(
    config: &Config,
    evaluations: &[Evaluation],
    measures: &[String],
) -> Comparison {
    let mut comparison = Comparison::new(evaluations, Bootstrap::new(config.seed));
    let Some((first, others)) = evaluations.split_first() else { return comparison };
    let main = main_measure(config);
    let further = measures.iter().map(String::as_str).filter(|&measure| measure != main);
    for measure in [main].into_iter().chain(further) {
        for other in others {
            comparison = comparison.with_difference(first, other, measure);
        }
    }
    comparison
}
