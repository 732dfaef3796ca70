//! One episode to be drawn or printed, and the sentences that it is spoken in.

use anyhow::Context as _;
use leadtime_config::Config;
use leadtime_eval::measure::Player;
use leadtime_eval::playthrough::{Playthrough, Spoken, Voice};
use leadtime_runs::Tasks;

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
