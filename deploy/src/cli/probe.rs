//! The arguments of `leadtime probe`.

use std::path::PathBuf;

use clap::Args;

use super::{action, n_episodes};
use leadtime_config::Override;
use leadtime_eval::measure::Choice;

/// `leadtime probe`
#[derive(Debug, Args)]
pub struct ProbeArgs {
    /// A policy file, a run directory or the name of a run.
    pub policy: PathBuf,
    /// Episodes; the probe is fitted on the first half and scored on the other.
    #[arg(long, default_value_t = 400, value_parser = n_episodes())]
    pub episodes: u32,
    /// Seed of the evaluation's random streams; another than in training.
    #[arg(long, default_value_t = 1_000_000)]
    pub eval_seed: u64,
    /// How the policy chooses (default: the configuration's).
    #[arg(long, value_parser = action())]
    pub action: Option<Choice>,
    /// Change one key of the task: `--set 'human.reaction_delay={uniform={low=0,high=5,drawn="per_episode"}}'`; may be
    /// given again.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Override::parse)]
    pub set: Vec<Override>,
    /// Directory that holds the runs.
    #[arg(long, value_name = "DIR", default_value = "runs")]
    pub runs: PathBuf,
    /// Print the results as JSON.
    #[arg(long)]
    pub json: bool,
    /// Also write the results to this file, as a section of a page that says where they are from.
    #[arg(long, value_name = "FILE")]
    pub markdown: Option<PathBuf>,
}
