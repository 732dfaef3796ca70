//! Evaluating policies of runs: who plays, on which episodes, and which episode shows what training did.

use leadtime_config::Config;
use leadtime_eval::Error;
use leadtime_eval::measure::{
    Choice, Comparison, Evaluation, PlaySettings, Player, evaluate, with_outcomes,
};
use leadtime_eval::playthrough::{Playthrough, Spoken, Voice};
use leadtime_numerics::stats::Bootstrap;

use crate::Tasks;
use crate::build::n_cores;

/// Default seed of evaluations, which no run trains with by default: nothing is evaluated on its training episodes.
pub const EVAL_SEED: u64 = 1_000_000;

/// The name of a trained policy in tables.
pub const TRAINED: &str = "trained";
/// The player that shows what the listener does alone.
pub const UNAIDED: &str = "unaided";
/// The player that shows what the network did before training.
pub(crate) const UNTRAINED: &str = "untrained";

/// Lists a policy and everybody whom it is compared with: the task's scripts, and the network before training.
///
/// # Errors
///
/// [`Error`] if the task or the network cannot be built.
pub fn players(
    tasks: &Tasks,
    trained: Player,
    config: &Config,
    action: Choice,
) -> Result<Vec<Player>, Error> {
    let environment = tasks.registry.build(&config.task)?;
    let scripts = environment.baselines().iter().map(|script| Player::baseline(script));
    let untrained = Player::untrained(&config.policy, config.seed, action)?;
    Ok([trained].into_iter().chain(scripts).chain([untrained]).collect())
}

/// Plays the same episodes with every player, and splits success by what the unaided listener does in them, who plays
/// them as well where the task has one.
///
/// # Errors
///
/// As [`evaluate`].
pub fn evaluate_all(
    tasks: &Tasks,
    config: &Config,
    players: &[Player],
    n_episodes: u32,
    seed: u64,
) -> Result<Vec<Evaluation>, Error> {
    let evaluations = play_all(tasks, config, players, n_episodes, seed)?;
    let alone = players.iter().position(|player| player.is_script(UNAIDED));
    let unaided = match alone {
        Some(place) => evaluations.get(place).cloned(),
        None if tasks.registry.build(&config.evaluation.task)?.baselines().contains(&UNAIDED) => {
            let player = [Player::baseline(UNAIDED)];
            play_all(tasks, config, &player, n_episodes, seed)?.pop()
        }
        None => None,
    };
    let Some(unaided) = unaided else { return Ok(evaluations) };
    let split = |(place, evaluation)| {
        if alone == Some(place) { evaluation } else { with_outcomes(evaluation, &unaided) }
    };
    Ok(evaluations.into_iter().enumerate().map(split).collect())
}

/// Plays the same episodes with every player.
pub(crate) fn play_all(
    tasks: &Tasks,
    config: &Config,
    players: &[Player],
    n_episodes: u32,
    seed: u64,
) -> Result<Vec<Evaluation>, Error> {
    let make = || tasks.registry.build(&config.evaluation.task);
    let settings = PlaySettings::new(u64::from(n_episodes), seed).threads(n_cores());
    players.iter().map(|player| evaluate(&make, player, &settings)).collect()
}

/// Returns the measure by which players of a task are compared: success where it is known.
pub fn main_measure(config: &Config) -> &'static str {
    if config.env.metrics.iter().any(|name| name == "success") { "success" } else { "return" }
}

/// Compares the first player with every other one, in the task's main measure and in the given ones.
pub fn compare(config: &Config, evaluations: &[Evaluation], measures: &[String]) -> Comparison {
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

/// Returns the sentences that come with the tasks, where they are about the domain's topics.
pub fn shipped_voice(tasks: &Tasks, config: &Config) -> Option<Voice> {
    Voice::shipped(config.domain.as_str(), &tasks.topics(&config.evaluation.task))
}

/// Plays the first episode that shows what training did, where the first player succeeds and the second fails, with both;
/// nothing if the task cannot be drawn.
///
/// # Errors
///
/// As [`Playthrough::record`].
pub fn telling(
    tasks: &Tasks,
    config: &Config,
    players: &[Player],
    evaluations: &[Evaluation],
) -> Result<Vec<Spoken>, Error> {
    if tasks.registry.build(&config.evaluation.task)?.scene().is_none() {
        return Ok(Vec::new());
    }
    let success = |at: usize| evaluations.get(at).and_then(|e| e.column("success"));
    let index = success(0).zip(success(1)).and_then(|(ours, theirs)| {
        ours.iter().zip(&theirs).position(|(ours, theirs)| *ours > 0.5 && *theirs < 0.5)
    });
    let (index, voice) = (index.unwrap_or(0) as u64, shipped_voice(tasks, config));
    let seed = evaluations.first().map_or(EVAL_SEED, |evaluation| evaluation.seed);
    let both = players.iter().take(2);
    both.map(|player| record(tasks, config, player, voice.as_ref(), seed, index)).collect()
}

/// Plays the episode of a seed and an index, to be drawn or printed; in words, if there is a voice.
///
/// # Errors
///
/// As [`Playthrough::record`]; [`Error::Words`] if the sentences are for other topics.
pub fn record(
    tasks: &Tasks,
    config: &Config,
    player: &Player,
    voice: Option<&Voice>,
    seed: u64,
    index: u64,
) -> Result<Spoken, Error> {
    let make = || tasks.registry.build(&config.evaluation.task);
    let played = Playthrough::record(&make, player, seed, index)?;
    match voice {
        Some(voice) => Ok(voice.speak(played)?),
        None => Ok(played.into()),
    }
}

#[cfg(test)]
#[path = "evaluation_tests.rs"]
mod tests;
