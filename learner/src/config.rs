//! What a run needs to know before it starts; checked where it is built.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use leadtime_link::{ListenSettings, StartKey};
use leadtime_ppo::LearnerSettings;
use leadtime_ppo::checkpoints::{CheckpointInterval, Retention};
use leadtime_proto::{RunName, RunSpec};

use crate::books::Books;
use crate::builds::{Build, Builds};

/// Everything about a run that its learner must know.
#[derive(Clone, Debug)]
pub struct LearnerConfig {
    /// Name of the run, which is part of every key.
    pub run: RunName,
    /// The keys of this start of the learner, drawn for every start.
    pub start: StartKey,
    /// What is computed, and how; its steps and schedule are those of `settings`.
    pub spec: RunSpec,
    /// How to train: loss, optimiser, batches and schedule.
    pub settings: LearnerSettings,
    /// The most rollouts that one actor may have unacknowledged, 1..=[`leadtime_proto::limits::MAX_WINDOW`].
    pub window: u32,
    /// Actors that must be there before the run starts, at least 1.
    pub actors_min: usize,
    /// Where the learner listens, and who may connect.
    pub listen: ListenSettings,
    /// What this learner computes with.
    pub build: Build,
    /// The directory of the run's checkpoints.
    pub checkpoints: PathBuf,
    /// How often to write one.
    pub checkpoint_interval: CheckpointInterval,
    /// Which checkpoints stay on the disk.
    pub retention: Retention,
    /// How long training goes on while no checkpoint can be written.
    pub checkpoint_patience: Duration,
    /// Weights (safetensors) that a new run starts from, as a fork of another run does; `None`: fresh ones.
    pub initial: Option<Arc<[u8]>>,
    /// Hash over what must not change when a run is resumed.
    pub identity: [u8; 32],
    /// Earlier identities of the run, from before its settings were changed on purpose: older checkpoints have one of these.
    pub earlier: Vec<[u8; 32]>,
}

impl LearnerConfig {
    pub(crate) fn steps_per_update(&self) -> u64 {
        self.settings.n_envs as u64 * self.settings.n_steps as u64
    }

    /// Returns whether the same seed would give the same bits, if these are all who computed the run, and this is what became of
    /// their rollouts.
    pub(crate) fn is_reproducible(&self, builds: &Builds, books: &Books) -> bool {
        builds.is_uniform()
            && self.settings.schedule().is_deterministic()
            && !books.has_fresh_episodes()
    }
}
