//! `leadtime compare ...`: the paper's tables, from training to the page.

use std::ops::Range;
use std::path::PathBuf;

use clap::Args;
use leadtime_config::Override;
use leadtime_studies::{EPISODES, EVAL_SEED};

use super::{n_episodes, number_range};

/// `leadtime compare`
#[derive(Debug, Args)]
pub struct CompareArgs {
    /// Name of a study, `all`, or a file of one's own; without one, the studies are listed with their rows.
    pub study: Option<String>,
    /// One training seed and few steps: shows that everything works, and is labelled so.
    #[arg(long)]
    pub quick: bool,
    /// Only these rows: `convey_react`, or `piloting/convey_react` where parts share names; may be given again.
    #[arg(long = "row", value_name = "ROW")]
    pub rows: Vec<String>,
    /// Only these parts; may be given again.
    #[arg(long = "part", value_name = "PART")]
    pub parts: Vec<String>,
    /// Change one key of what is trained: `--set human.reaction_delay.fixed=3`; may be given again.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Override::parse)]
    pub set: Vec<Override>,
    /// Start from this configuration, in the parts of its domain, instead of the study's own.
    #[arg(long, value_name = "FILE")]
    pub profile: Vec<PathBuf>,
    /// Training seeds, half open, instead of the five of each part (with --quick only the first).
    #[arg(long, value_name = "A..B", value_parser = number_range)]
    pub seeds: Option<Range<u64>>,
    /// Environment steps of every training, instead of the study's or the profile's.
    #[arg(long, value_name = "STEPS", value_parser = clap::value_parser!(u64).range(1..))]
    pub steps: Option<u64>,
    /// Evaluation episodes per training seed.
    #[arg(long, default_value_t = EPISODES, value_parser = n_episodes())]
    pub episodes: u32,
    /// Seed of the evaluations; the training seed is added, so that no two policies of a row meet the same worlds.
    #[arg(long, default_value_t = EVAL_SEED, value_parser = clap::value_parser!(u64).range(..1 << 62))]
    pub eval_seed: u64,
    /// Trainings at a time (default: one per core).
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=256))]
    pub jobs: Option<u32>,
    /// Actor processes per training.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=256))]
    pub actors: u32,
    /// Directory that holds the runs.
    #[arg(long, value_name = "DIR", default_value = "runs/compare")]
    pub runs: PathBuf,
    /// Directory for tables and figures (default: docs/results; a study of one's own, and one that is not carried out
    /// whole and as it is, is printed, and written only where --out says).
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// List the trainings and how far they are, and do nothing.
    #[arg(long)]
    pub plan: bool,
}
