//! Held-out episodes: which they are, how a policy is evaluated on them, and `held_out.jsonl`, which keeps what came out.
//!
//! ```text
//! {"update": 98, "steps": 200704, "held_out/success": 0.61, "held_out/return": 104.2, ...}
//! ```
//!
//! A line per evaluation while the run trains, the oldest first. The file is replaced whole at every evaluation, and at a checkpoint
//! if it lacks one. It holds nothing that depends on time.

use std::error::Error;
use std::io;
use std::path::Path;

use leadtime_config::Config;
use leadtime_episodes::Error as PlayError;
use leadtime_eval::measure::{Choice, Evaluation, PlaySettings, Player, evaluate};
use leadtime_learner::{
    HeldOutEpisode, HeldOutEvaluation, HeldOutMeans, PolicyEvaluator, write_atomically,
};
use leadtime_numerics::{Purpose, stream};
use leadtime_policy::Parameters;
use leadtime_proto::{PolicySpec, TaskSpec};
use leadtime_sims::Registry;
use serde_json::{Map, Value};
use sha2::{Digest as _, Sha256};

use crate::policy_file::{self, BEST_POLICY};
use crate::regular;

/// The file of a run's evaluations on held-out episodes.
pub const HELD_OUT: &str = "held_out.jsonl";
/// The bit that no seed of a run, of a study or of an evaluation has by default.
const OWN: u64 = 1 << 63;

/// What held-out episodes are for; each has episodes of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum HeldOutUse {
    /// To follow a training, and to find its best policy.
    Training = 0,
    /// To stop the hopeless racers.
    Quarter = 1,
    /// To find the winner of a race.
    Final = 2,
}

/// Returns the seed of the held-out episodes of a run, or of the race that begins with it.
///
/// No run can have it as its own seed, and no study evaluates with it: those are below 2^63.
pub fn held_out_seed(run_seed: u64, purpose: HeldOutUse) -> u64 {
    stream(run_seed, Purpose::HeldOut, 0, purpose as u64).next_u64() | OWN
}

/// Plays held-out episodes with the weights that a learner gives it.
#[derive(Debug)]
struct HeldOutPlayer {
    registry: Registry,
    /// As it is in evaluation.
    task: TaskSpec,
    policy: PolicySpec,
    choice: Choice,
    seed: u64,
}

impl PolicyEvaluator for HeldOutPlayer {
    fn evaluate(
        &mut self,
        weights: &[u8],
        n_episodes: u64,
        is_stopped: &(dyn Fn() -> bool + Sync),
    ) -> Result<Option<Vec<HeldOutEpisode>>, Box<dyn Error + Send + Sync>> {
        let parameters = Parameters::from_safetensors(weights, &self.policy)?;
        let player = Player::policy("held out", &self.policy, &parameters, self.choice)?;
        let make = || self.registry.build(&self.task);
        // On one thread: the others belong to the actors.
        let settings = PlaySettings::new(n_episodes, self.seed).stopped_by(is_stopped);
        match evaluate(&make, &player, &settings) {
            Ok(evaluation) => Ok(Some(episodes(&evaluation))),
            Err(leadtime_eval::Error::Play(PlayError::Interrupted)) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }
}

/// Returns how a run's policies are evaluated while it trains; `None` where they are not.
pub fn held_out_evaluation(config: &Config, registry: &Registry) -> Option<HeldOutEvaluation> {
    let settings = &config.evaluation;
    let player = HeldOutPlayer {
        registry: registry.clone(),
        task: settings.task.clone(),
        policy: config.policy.clone(),
        choice: settings.action,
        seed: held_out_seed(config.seed, HeldOutUse::Training),
    };
    (settings.during_training > 0).then(|| HeldOutEvaluation {
        n_evaluations: u64::from(settings.during_training),
        max_episodes: u64::from(settings.held_out_episodes),
        stop_at: settings.stop_at,
        episodes: comparable(config),
        evaluator: Box::new(player),
    })
}

/// Returns the digest of what decides held-out episodes besides their seed, and the choices in them.
pub(crate) fn comparable(config: &Config) -> [u8; 32] {
    let TaskSpec { domain, settings } = &config.evaluation.task;
    let action = config.evaluation.action;
    Sha256::digest(format!("{domain}\n{settings}\n{action:?}")).into()
}

/// Returns the episodes of an evaluation as a learner compares policies by them.
pub(crate) fn episodes(evaluation: &Evaluation) -> Vec<HeldOutEpisode> {
    let success = evaluation.column("success");
    let successes = (0..).map(|i| success.as_ref().and_then(|column| column.get(i).copied()));
    let both = evaluation.episodes.iter().zip(successes);
    both.map(|(episode, success)| HeldOutEpisode {
        total_reward: episode.total_reward,
        length: episode.n_steps,
        success,
    })
    .collect()
}

/// Lists the numbers of an evaluation by name; one that does not exist is left out.
///
/// Units and meaning: `docs/metrics.md`.
pub(crate) fn scalars(means: &HeldOutMeans) -> Vec<(String, f64)> {
    let all = [
        ("held_out/episodes", Some(means.n_episodes as f64)),
        ("held_out/success", means.success),
        ("held_out/return", Some(means.episode_return)),
        ("held_out/length", Some(means.length)),
        ("held_out/error", Some(means.error)),
    ];
    all.into_iter().filter_map(|(name, value)| Some((name.to_owned(), value?))).collect()
}

/// Writes all evaluations of a run, in place of those before; without any, or where they are there, nothing is done.
pub(crate) fn write(
    directory: &Path,
    history: &[HeldOutMeans],
    steps_per_update: u64,
) -> io::Result<()> {
    let line = |means: &HeldOutMeans| {
        let n_updates = means.version.0;
        let ends = [("update", n_updates), ("steps", n_updates * steps_per_update)];
        let mut line: Map<String, Value> =
            ends.into_iter().map(|(key, value)| (key.to_owned(), value.into())).collect();
        line.extend(scalars(means).into_iter().map(|(key, value)| (key, value.into())));
        format!("{}\n", Value::from(line))
    };
    let (text, path) = (history.iter().map(line).collect::<String>(), directory.join(HELD_OUT));
    if history.is_empty() || regular::read(&path).is_ok_and(|there| there == text.as_bytes()) {
        return Ok(());
    }
    write_atomically(&path, text.as_bytes())
}

/// Reads a run's evaluations on held-out episodes; none where there are none.
pub(crate) fn read(directory: &Path) -> Vec<Map<String, Value>> {
    let bytes = regular::read(&directory.join(HELD_OUT)).unwrap_or_default();
    let lines = bytes.split(|&byte| byte == b'\n');
    lines.filter_map(|line| serde_json::from_slice(line).ok()).collect()
}

/// Returns the evaluation of a run's best policy; `None` where it was not evaluated while the run trained.
pub(crate) fn of_best(directory: &Path) -> Option<Map<String, Value>> {
    let lines = read(directory);
    if lines.is_empty() {
        return None;
    }
    let n_updates = policy_file::n_updates(&directory.join(BEST_POLICY)).ok()?;
    lines.into_iter().find(|line| line.get("update").and_then(Value::as_u64) == Some(n_updates))
}

#[cfg(test)]
mod tests {
    use leadtime_proto::PolicyVersion;

    use super::*;
    use crate::Tasks;
    use crate::test_support::config;

    fn weights(config: &Config, seed: u64) -> Vec<u8> {
        let parameters = Parameters::initialize(&config.policy, seed).unwrap();
        parameters.to_safetensors(&std::collections::BTreeMap::new()).unwrap()
    }

    #[test]
    fn held_out_episodes_are_nobody_elses() {
        let uses = [HeldOutUse::Training, HeldOutUse::Quarter, HeldOutUse::Final];
        let seeds = [1, 2, 2_000_000].map(|seed| uses.map(|it| held_out_seed(seed, it)));
        let all: std::collections::BTreeSet<u64> = seeds.into_iter().flatten().collect();
        assert_eq!(all.len(), 9);
        assert!(all.iter().all(|seed| *seed > i64::MAX.cast_unsigned()), "no run has it");
    }

    #[test]
    fn an_evaluation_depends_on_the_weights_and_plays_the_evaluations_world() {
        let (tasks, runs) = (Tasks::new(), tempfile::tempdir().unwrap());
        let evaluate = |set: &[&str], seed: u64| {
            let config = config(runs.path(), "cartpole", "r", set);
            let mut evaluation = held_out_evaluation(&config, &tasks.registry).unwrap();
            evaluation.evaluator.evaluate(&weights(&config, seed), 6, &|| false).unwrap().unwrap()
        };
        // Untrained policies draw nearly alike; their most likely choices differ.
        let greedy = ["evaluation.action=\"greedy\""];
        let first = evaluate(&greedy, 1);
        assert_eq!((first.len(), &first), (6, &evaluate(&greedy, 1)));
        assert_ne!(first, evaluate(&greedy, 2));
        let short = evaluate(&["evaluation.world.max_steps=3"], 1);
        assert!(short.iter().all(|episode| episode.length == 3), "{short:?}");
    }

    #[test]
    fn an_evaluation_ends_when_asked_to_and_says_why_it_is_impossible() {
        let (tasks, runs) = (Tasks::new(), tempfile::tempdir().unwrap());
        let off = config(runs.path(), "cartpole", "r", &["evaluation.during_training=0"]);
        assert!(held_out_evaluation(&off, &tasks.registry).is_none());
        let config = config(runs.path(), "cartpole", "r", &[]);
        let mut evaluator = held_out_evaluation(&config, &tasks.registry).unwrap().evaluator;
        let stopped = evaluator.evaluate(&weights(&config, 1), 6, &|| true).unwrap();
        assert_eq!(stopped, None);
        assert!(evaluator.evaluate(b"no weights", 6, &|| false).is_err());
    }

    #[test]
    fn evaluations_survive_the_disk_and_the_best_policy_is_found() {
        let run = tempfile::tempdir().unwrap();
        let means = |version: u64| HeldOutMeans {
            version: PolicyVersion(version),
            n_episodes: 20,
            success: None,
            episode_return: 2.5,
            length: 3.0,
            error: 0.5,
        };
        assert_eq!(of_best(run.path()), None);
        write(run.path(), &[means(5), means(10)], 64).unwrap();
        let lines = read(run.path());
        assert_eq!(lines.len(), 2);
        assert_eq!(lines[1]["steps"], 640);
        assert_eq!(lines[1]["held_out/return"], 2.5);
        assert!(!lines[1].contains_key("held_out/success"));
        assert_eq!(of_best(run.path()), None, "there is no best policy yet");
    }
}
