//! `eval.json`: how a run's policy did when it was last evaluated; TensorBoard shows the same as `eval/...`.

use std::io;
use std::path::Path;

use leadtime_config::Config;
use leadtime_eval::measure::{Choice, Comparison};
use leadtime_learner::write_atomically;
use serde::{Deserialize, Serialize};

use crate::contents::TENSORBOARD;
use crate::{LoadedPolicy, clock, regular, tensorboard};

/// The file of the last evaluation in a run directory.
pub const LAST_EVALUATION: &str = "eval.json";

/// What was evaluated, on which episodes, and what came out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvaluationRecord {
    /// Where the policy's file was found.
    pub policy: String,
    /// SHA-256 over that file, in hexadecimal.
    pub policy_sha256: String,
    /// Updates that made the policy.
    #[serde(default)]
    pub updates: u64,
    /// The task's domain.
    pub domain: String,
    /// How the policy chose.
    pub action: Choice,
    /// Seed of the evaluation.
    pub seed: u64,
    /// The policy, and everybody who played the same episodes.
    pub comparison: Comparison,
}

impl EvaluationRecord {
    /// Describes an evaluation of a policy, which comes first in the comparison.
    pub fn new(policy: &LoadedPolicy, action: Choice, seed: u64, comparison: Comparison) -> Self {
        Self {
            policy: policy.path.display().to_string(),
            policy_sha256: policy.sha256.clone(),
            updates: policy.n_updates,
            domain: policy.config.domain.to_string(),
            action,
            seed,
            comparison,
        }
    }

    /// Reads the last evaluation of a run; `None` if there is none that can be read.
    pub(crate) fn read(directory: &Path) -> Option<Self> {
        let text = regular::read_to_string(&directory.join(LAST_EVALUATION)).ok()?;
        serde_json::from_str(&text).ok()
    }

    /// Writes the record and its event file into a run's directory, in place of those before.
    ///
    /// # Errors
    ///
    /// If a file cannot be written.
    pub fn write(&self, directory: &Path, config: &Config) -> io::Result<()> {
        let mut text = serde_json::to_string_pretty(self).map_err(io::Error::other)?;
        text.push('\n');
        write_atomically(&directory.join(LAST_EVALUATION), text.as_bytes())?;
        let steps = self.updates * config.steps_per_update();
        let measures = self.comparison.summaries.iter().take(1).flat_map(|own| &own.measures);
        let scalars = measures.filter_map(|measure| {
            Some((format!("eval/{}", measure.name), measure.interval?.estimate))
        });
        let scalars: Vec<_> = scalars.collect();
        let directory = directory.join(TENSORBOARD);
        tensorboard::write_evaluation(&directory, clock::unix_seconds(), steps, &scalars)
    }
}
