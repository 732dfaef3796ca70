//! What is to be saved of a run: how often, which checkpoints stay, and how large one may be.
//!
//! These are settings and bounds, which a configuration is checked with. The learner writes the files.

use std::time::Duration;

use leadtime_proto::limits::MAX_MESSAGE_BYTES;
use serde::{Deserialize, Serialize};

use crate::settings::{LearnerSettings, Mode};

/// The most of the newest checkpoints that can be kept.
pub const MAX_KEPT: usize = 1_000;
/// The largest state that a checkpoint holds, in bytes.
pub const MAX_PAYLOAD_BYTES: usize = MAX_MESSAGE_BYTES;
/// The most episodes of one evaluation while training: their scores are part of every checkpoint.
pub const MAX_HELD_OUT_EPISODES: u32 = 10_000;
/// The most evaluations of a run: their means are part of every checkpoint.
pub const MAX_EVALUATIONS: u32 = 1_000;
/// The most policies that wait for their evaluation: their weights are part of every checkpoint. Training pauses while there are so
/// many.
pub const MAX_WAITING: usize = 2;

/// What the last training episodes, the evaluations and the books take, in bytes.
pub const RECORDS_BYTES: usize = 256 << 10;
/// Room next to an environment's snapshot: ids, counts, lengths.
const ENV_BYTES: usize = 256;

/// How often the state of a run goes to the disk; whichever comes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CheckpointInterval {
    /// Updates between checkpoints, at least 1.
    pub updates: u64,
    /// Time after which one is written even if fewer updates are done.
    pub time: Duration,
}

/// `[run.keep]`: which checkpoints stay when a new one is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Retention {
    /// How many of the newest, 1..=[`MAX_KEPT`].
    pub newest: usize,
    /// Also those after a multiple of so many updates; 0: none.
    pub every_updates: u64,
}

impl Retention {
    /// Returns whether the checkpoint after so many updates stays for good.
    pub fn is_for_good(self, n_updates: u64) -> bool {
        self.every_updates > 0 && n_updates.is_multiple_of(self.every_updates)
    }
}

/// Returns an upper bound on the size of a state, in bytes, from the same for one version of the weights and for one
/// environment's snapshot with its recurrent state.
pub fn max_payload_bytes(settings: &LearnerSettings, weights: usize, snapshot: usize) -> usize {
    let n_older = if settings.mode == Mode::Lag { settings.lag as usize } else { 0 };
    // The parameters with Adam's two moments, the policies that were evaluated or wait for it, and the versions that acting
    // still needs.
    (3 + 2 + MAX_WAITING + n_older) * weights
        + settings.n_envs * (snapshot + ENV_BYTES)
        + RECORDS_BYTES
}
