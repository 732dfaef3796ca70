//! The sentences that an episode is spoken in.

use std::path::Path;

use anyhow::Context as _;
use leadtime_config::Config;
use leadtime_eval::playthrough::Voice;
use leadtime_runs::{Tasks, evaluation};

use super::taxonomy;
use crate::exit::{Blame as _, ExitCode, Failure};

/// Finds the sentences for a domain's messages: those of the named database, else the shipped ones; `None` where there
/// are none.
pub(super) fn voice(
    tasks: &Tasks,
    config: &Config,
    database: Option<&Path>,
) -> Result<Option<Voice>, Failure> {
    let Some(name) = database else { return Ok(evaluation::shipped_voice(tasks, config)) };
    let taxonomy = taxonomy::database(name)?;
    let task = &config.evaluation.task;
    let topics = tasks.topics(task);
    let told: Vec<&str> = tasks.facts(task).iter().map(|fact| fact.name).collect();
    let about = taxonomy.expect_topics(&topics).and_then(|()| taxonomy.expect_facts(&told));
    about.with_context(|| name.display().to_string()).blame(ExitCode::WrongInput)?;
    let voice = Voice::new(taxonomy, &topics).with_context(|| name.display().to_string());
    Ok(Some(voice.blame(ExitCode::WrongInput)?))
}
