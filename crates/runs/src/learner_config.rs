//! From a checked configuration and a run directory to what a learner is told.

use leadtime_config::{Config, identity};
use leadtime_learner::{Build, LearnerConfig};
use leadtime_link::ListenSettings;
use leadtime_ppo::LearnerSettings;
use leadtime_proto::{RunSpec, hex};

use crate::{ProgramBuild, RunDir, RunDirError, clock};

/// Tells a learner what to train, where to listen and what to go on from, on how many threads if the configuration leaves
/// that open.
///
/// # Errors
///
/// [`RunDirError`] if the weights that the run started from cannot be read.
pub fn learner_config(
    config: &Config,
    run_dir: &RunDir,
    listen: ListenSettings,
    build: ProgramBuild,
    n_threads: usize,
) -> Result<LearnerConfig, RunDirError> {
    Ok(LearnerConfig {
        run: run_dir.name.clone(),
        incarnation: clock::incarnation(),
        spec: RunSpec {
            seed: config.seed,
            task: config.task.clone(),
            env: config.env.clone(),
            policy: config.policy.clone(),
            n_steps: config.learner.n_steps as u32,
            schedule: config.learner.schedule(),
        },
        settings: LearnerSettings {
            threads: if config.learner.threads == 0 { n_threads } else { config.learner.threads },
            ..config.learner.clone()
        },
        window: config.window,
        actors_min: config.run.actors_min as usize,
        listen,
        build: Build { program: build.program, cpu: build.cpu },
        checkpoints: run_dir.checkpoints(),
        checkpoint_interval: config.run.checkpoints,
        retention: config.run.keep,
        checkpoint_patience: config.run.checkpoint_patience,
        initial: run_dir.initial(config)?,
        identity: identity::of_run(&config.table),
        earlier: run_dir.record.changes.iter().filter_map(|it| hex::decode(&it.identity)).collect(),
    })
}
