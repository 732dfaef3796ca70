//! Playing episodes with several players under the same seeds, and comparing them.

use std::path::Path;
use std::thread::available_parallelism;

use anyhow::{Context as _, bail};
use leadtime_eval::measure::{Choice, Comparison, Evaluation, PlaySettings, Player, evaluate};
use leadtime_eval::playthrough::{Playthrough, Spoken, Voice};
use leadtime_numerics::stats::Bootstrap;
use leadtime_policy::Parameters;

use super::taxonomy;
use crate::Program;
use crate::exit::{Blame as _, ExitCode, Failure};
use leadtime_config::{Config, EvaluationAction};

/// Seed of evaluations: another than any run's by default, so that nothing is judged on what it was trained on.
pub(super) const EVAL_SEED: u64 = 1_000_000;

/// How a judged policy chooses.
pub(super) fn choice(action: EvaluationAction) -> Choice {
    match action {
        EvaluationAction::Sample => Choice::Sample,
        EvaluationAction::Greedy => Choice::Greedy,
    }
}

/// Lets a policy be judged under a name.
pub(super) fn policy(
    name: &str,
    config: &Config,
    parameters: &Parameters,
    action: EvaluationAction,
) -> anyhow::Result<Player> {
    Ok(Player::policy(name, &config.policy, parameters, choice(action))?)
}

/// Returns how many threads play episodes: as many as there are cores, for the results do not depend on it.
pub(super) fn n_threads() -> usize {
    available_parallelism().map_or(1, usize::from)
}

/// Plays the same episodes with every player.
pub(super) fn evaluate_all(
    program: &Program,
    config: &Config,
    players: &[Player],
    n_episodes: u32,
    seed: u64,
) -> anyhow::Result<Vec<Evaluation>> {
    let make = || program.registry.build(&config.evaluation.task);
    let settings = PlaySettings::new(u64::from(n_episodes), seed).threads(n_threads());
    let evaluate = |player| Ok(evaluate(&make, player, &settings)?);
    players.iter().map(evaluate).collect()
}

/// Returns the measure by which players of a task are compared: success where it is known.
pub(super) fn main_measure(config: &Config) -> &'static str {
    if config.env.metrics.iter().any(|name| name == "success") { "success" } else { "return" }
}

/// Compares the first player with every other one, in the task's main measure and in those that are asked for.
///
/// # Errors
///
/// If there is no such measure.
pub(super) fn compare(
    config: &Config,
    evaluations: &[Evaluation],
    measures: &[String],
) -> anyhow::Result<Comparison> {
    let mut comparison = Comparison::new(evaluations, Bootstrap::new(config.seed));
    let known = comparison.measure_names();
    if let Some(unknown) = measures.iter().find(|name| !known.contains(&name.as_str())) {
        bail!("there is no measure `{unknown}`; known: {}", known.join(", "));
    }
    let Some((first, others)) = evaluations.split_first() else { return Ok(comparison) };
    let main = main_measure(config);
    let further = measures.iter().map(String::as_str).filter(|&measure| measure != main);
    for measure in [main].into_iter().chain(further) {
        for other in others {
            comparison = comparison.with_difference(first, other, measure);
        }
    }
    Ok(comparison)
}

/// Finds the sentences for a domain's messages: those of a database that the person names, else the shipped ones;
/// `None` where there are none.
///
/// # Errors
///
/// Wrong input: a database that cannot be read, or is about other topics.
pub(super) fn voice(
    program: &Program,
    config: &Config,
    database: Option<&str>,
) -> Result<Option<Voice>, Failure> {
    let Some(name) = database else { return Ok(shipped_voice(program, config)) };
    let taxonomy = taxonomy::database(name)?;
    let topics = program.topics(&config.evaluation.task);
    let voice = Voice::new(taxonomy, &topics).with_context(|| name.to_owned());
    Ok(Some(voice.blame(ExitCode::WrongInput)?))
}

/// Returns the sentences that come with the program, where they are about the domain's topics.
pub(super) fn shipped_voice(program: &Program, config: &Config) -> Option<Voice> {
    Voice::shipped(config.domain.as_str(), &program.topics(&config.evaluation.task))
}

/// Plays the episode of a seed and a number, to be drawn or told; in words, if there is a voice.
pub(super) fn record(
    program: &Program,
    config: &Config,
    player: &Player,
    voice: Option<&Voice>,
    seed: u64,
    index: u64,
) -> anyhow::Result<Spoken> {
    let make = || program.registry.build(&config.evaluation.task);
    let played = Playthrough::record(&make, player, seed, index)?;
    match voice {
        Some(voice) => Ok(voice.speak(played)?),
        None => Ok(played.into()),
    }
}

/// Returns the extension of a path in lower case.
pub(super) fn extension(path: &Path) -> String {
    path.extension().and_then(|extension| extension.to_str()).unwrap_or_default().to_lowercase()
}
