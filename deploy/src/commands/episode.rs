//! One episode to be drawn or printed, and the sentences that it is spoken in.

use anyhow::Context as _;
use leadtime_config::Config;
use leadtime_eval::measure::{Evaluation, Player};
use leadtime_eval::playthrough::{Playthrough, Spoken, Voice};
use leadtime_runs::Tasks;

use super::evaluation::EVAL_SEED;
use super::taxonomy;
use crate::exit::{Blame as _, ExitCode, Failure};

/// Finds the sentences for a domain's messages: those of the named database, else the shipped ones; `None` where there
/// are none.
pub(super) fn voice(
    tasks: &Tasks,
    config: &Config,
    database: Option<&str>,
) -> Result<Option<Voice>, Failure> {
    let Some(name) = database else { return Ok(shipped_voice(tasks, config)) };
    let taxonomy = taxonomy::database(name)?;
    let topics = tasks.topics(&config.evaluation.task);
    let voice = Voice::new(taxonomy, &topics).with_context(|| name.to_owned());
    Ok(Some(voice.blame(ExitCode::WrongInput)?))
}

/// Returns the sentences that come with the tasks, where they are about the domain's topics.
pub(super) fn shipped_voice(tasks: &Tasks, config: &Config) -> Option<Voice> {
    Voice::shipped(config.domain.as_str(), &tasks.topics(&config.evaluation.task))
}

/// Plays the first episode that shows what training did, where the first player succeeds and the second fails, with both;
/// nothing if the task cannot be drawn.
pub(super) fn telling(
    tasks: &Tasks,
    config: &Config,
    players: &[Player],
    evaluations: &[Evaluation],
) -> anyhow::Result<Vec<Spoken>> {
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
pub(super) fn record(
    tasks: &Tasks,
    config: &Config,
    player: &Player,
    voice: Option<&Voice>,
    seed: u64,
    index: u64,
) -> anyhow::Result<Spoken> {
    let make = || tasks.registry.build(&config.evaluation.task);
    let played = Playthrough::record(&make, player, seed, index)?;
    match voice {
        Some(voice) => Ok(voice.speak(played)?),
        None => Ok(played.into()),
    }
}
