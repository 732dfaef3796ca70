//! What a worker is started with: workers that are started alike step the same environments.

use std::time::Duration;

use leadtime_proto::EnvSpec;
use leadtime_proto::limits::MAX_SNAPSHOT_BYTES;
use serde_json::json;

use crate::error::Error;
use crate::protocol::{FrameShape, WorkerHello};
use crate::settings::{PythonSettings, SnapshotKind, SpecSetting, WorldSpec};

/// The most bytes of actions, or of a pickle, that a snapshot holds: it has to fit one of the run's.
pub(crate) const MAX_STATE_BYTES: usize = MAX_SNAPSHOT_BYTES - (64 << 10);
/// A worker that has only just started may take this long to import its packages.
const START_TIMEOUT: Duration = Duration::from_mins(1);

/// How a kind of worker is started.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct WorkerLaunch {
    /// The command of the shell.
    pub(crate) command: String,
    /// What environments are made with, as JSON.
    pub(crate) config: String,
    /// Names of the metrics.
    pub(crate) metrics: Vec<String>,
    pub(crate) snapshot: SnapshotKind,
    /// Environments that one worker steps.
    pub(crate) batch: usize,
    pub(crate) step_timeout: Duration,
    /// The most bytes of actions that an environment is put back by.
    pub(crate) max_action_bytes: usize,
    /// What the environments must look like, where that is known.
    pub(crate) expected: Option<WorldSpec>,
}

impl WorkerLaunch {
    /// Describes the workers of a configuration; `command` replaces the configuration's.
    pub(crate) fn new(settings: &PythonSettings, command: String) -> Self {
        let config = json!({
            "env": settings.env,
            "metrics": settings.metrics,
            "snapshot": settings.snapshot,
            "batch": settings.batch,
        });
        Self {
            command,
            config: config.to_string(),
            metrics: settings.metrics.clone(),
            snapshot: settings.snapshot,
            batch: settings.batch as usize,
            step_timeout: settings.step_timeout,
            max_action_bytes: MAX_STATE_BYTES,
            expected: match &settings.spec {
                SpecSetting::Ask => None,
                SpecSetting::Known(spec) => Some(spec.clone()),
            },
        }
    }

    /// Returns whether workers that are started like this are started like the other.
    pub(crate) fn is_like(&self, other: &Self) -> bool {
        Self { expected: None, ..self.clone() } == Self { expected: None, ..other.clone() }
    }

    /// Returns how long a worker may take to say hello.
    pub(crate) fn start_timeout(&self) -> Duration {
        self.step_timeout.max(START_TIMEOUT)
    }

    /// Checks that a worker steps what is to be stepped.
    pub(crate) fn check(&self, hello: &WorkerHello) -> Result<FrameShape, Error> {
        let command = self.command.clone();
        let refuse = |reason: String| Error::Start { command: self.command.clone(), reason };
        if hello.metrics != self.metrics {
            let (found, asked) = (hello.metrics.join(", "), self.metrics.join(", "));
            return Err(refuse(format!("it sends the metrics `{found}`, not `{asked}`")));
        }
        if hello.max_envs < self.batch {
            let (found, asked) = (hello.max_envs, self.batch);
            return Err(refuse(format!("it steps {found} environments, `world.batch` is {asked}")));
        }
        let env: EnvSpec = hello.world.env_spec(&self.metrics);
        env.check().map_err(|error| refuse(error.to_string()))?;
        let difference = self.expected.as_ref().and_then(|it| it.difference(&hello.world));
        if let Some(what) = difference {
            return Err(Error::OtherWorld { command, what });
        }
        let (obs_dim, n_heads) = (env.obs_dim, env.actions.heads.len());
        Ok(FrameShape { obs_dim, n_heads, n_metrics: self.metrics.len() })
    }
}
