//! Makes a learner's configuration from a checked configuration and a run directory.

use leadtime_config::{Config, identity};
use leadtime_learner::{Build, LearnerConfig};
use leadtime_link::{ListenSettings, StartKey};
use leadtime_ppo::LearnerSettings;
use leadtime_ppo::settings::MAX_THREADS;
use leadtime_proto::limits::MAX_WINDOW;
use leadtime_proto::{RunSpec, Schedule, hex};

use crate::build::n_cores;
use crate::{ProgramBuild, RunDir, RunDirError};

/// Tells a learner what to train, where to listen and what to go on from. If the configuration leaves its threads open, it
/// takes the cores that this many actors on the same machine do not use.
///
/// # Errors
///
/// [`RunDirError`] if the weights that the run started from cannot be read, or no keys can be drawn for this start.
pub fn learner_config(
    config: &Config,
    run_dir: &RunDir,
    listen: ListenSettings,
    build: ProgramBuild,
    n_local_actors: usize,
) -> Result<LearnerConfig, RunDirError> {
    Ok(LearnerConfig {
        run: run_dir.name.clone(),
        start: StartKey::draw().map_err(|error| RunDirError::Refused(error.to_string()))?,
        spec: RunSpec {
            seed: config.seed,
            task: config.task.clone(),
            env: config.env.clone(),
            policy: config.policy.clone(),
            n_steps: config.learner.n_steps as u32,
            schedule: config.learner.schedule(),
        },
        settings: LearnerSettings {
            threads: learner_threads(config, n_local_actors),
            ..config.learner.clone()
        },
        window: window(config),
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

/// Returns how many rollouts an actor may have unacknowledged: as configured, or what a lag lets it make if that is more.
///
/// With fewer an actor that has all environments would wait for acknowledgements, and a larger lag would bridge no longer line.
fn window(config: &Config) -> u32 {
    let Schedule::Lag(lag) = config.learner.schedule() else { return config.window };
    // Those of the update that is trained, of those ahead of it, and of one more, as what arrives is acknowledged with the next update.
    let ahead = (lag + 2).saturating_mul(config.learner.n_envs as u64);
    u32::try_from(ahead).unwrap_or(u32::MAX).min(MAX_WINDOW).max(config.window)
}

/// Returns how many threads share an update of a learner beside so many actors on the same machine.
pub(crate) fn learner_threads(config: &Config, n_local_actors: usize) -> usize {
    match config.learner.threads {
        0 => free_cores(n_local_actors),
        n_threads => n_threads,
    }
}

/// Returns whether a learner and so many actors beside it have more work than this machine has cores.
pub(crate) fn is_crowded(config: &Config, n_local_actors: usize) -> bool {
    n_local_actors > 0 && learner_threads(config, n_local_actors) + n_local_actors > n_cores()
}

/// Returns how many cores actors leave to their learner, at least one.
fn free_cores(n_local_actors: usize) -> usize {
    n_cores().saturating_sub(n_local_actors).clamp(1, MAX_THREADS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::config;

    #[test]
    fn a_machine_is_crowded_by_more_actors_than_leave_a_core_to_the_learner() {
        let place = tempfile::tempdir().unwrap();
        let config = config(place.path(), "lander", "", &["learner.threads=0"]);
        assert!(!is_crowded(&config, 0) && !is_crowded(&config, n_cores() - 1));
        assert!(is_crowded(&config, n_cores()));
    }

    #[test]
    fn an_actor_may_have_on_its_way_what_the_lag_lets_it_make() {
        let place = tempfile::tempdir().unwrap();
        for (set, expected) in [
            (&["learner.mode=sync", "learner.n_envs=16"][..], 64),
            (&["learner.mode=lag", "learner.lag=1", "learner.n_envs=16"], 64),
            (&["learner.mode=lag", "learner.lag=16", "learner.n_envs=16"], 288),
            (&["learner.mode=lag", "learner.lag=64", "learner.n_envs=256"], MAX_WINDOW),
            (&["learner.mode=async", "learner.lag=64", "learner.n_envs=256"], 64),
            (&["learner.mode=lag", "learner.lag=1", "learner.n_envs=16", "actor.window=500"], 500),
        ] {
            let n_steps = "learner.n_steps=16";
            let set = [set, &["learner.n_minibatches=4", n_steps]].concat();
            assert_eq!(window(&config(place.path(), "cartpole", "", &set)), expected, "{set:?}");
        }
    }
}
