//! Learning, from environment to weights, without processes between: the update is right if a pole is balanced.

use leadtime_actor::{Worker, WorkerSettings};
use leadtime_learner::{LearnerSettings, Trainer};
use leadtime_policy::Policy;
use leadtime_proto::message::EnvAssignment;
use leadtime_proto::{Encoder, EnvId, HeadCredit, Iteration, PolicySpec, TaskSpec};
use leadtime_sims::Registry;

/// Trains `CartPole` and returns the mean return of the last twenty episodes.
fn cartpole(run_seed: u64, total_steps: u64) -> f64 {
    let task = TaskSpec { domain: "cartpole".to_owned(), settings: r#"{"world": {}}"#.to_owned() };
    let registry = Registry::builtin();
    let env = registry.build(&task).expect("the task is built in").spec().clone();
    let policy = PolicySpec {
        obs_dim: env.obs_dim,
        encoder: Encoder::Identity,
        hidden: vec![64, 64],
        actions: env.actions.clone(),
        head_credit: HeadCredit::All,
        logit_bias: Vec::new(),
        normalize_observations: false,
    };
    let settings =
        LearnerSettings { total_steps, learning_rate: 1e-3, ..LearnerSettings::default() };
    let mut trainer = Trainer::new(&policy, &env, &settings, run_seed).expect("sound settings");
    let mut worker = Worker::new(WorkerSettings {
        run_seed,
        n_steps: settings.n_steps as u32,
        env,
        policy: policy.clone(),
    });
    for env_id in (0..settings.n_envs as u32).map(EnvId) {
        let start = EnvAssignment { env_id, iteration: Iteration(0), snapshot: Vec::new() };
        let env = registry.build(&task).expect("the task is built in");
        worker.insert(env, &start).expect("an empty snapshot is a fresh start");
    }
    let mut returns = Vec::new();
    for _ in 0..trainer.n_updates() {
        let mut acting = Policy::new(&policy, trainer.parameters()).expect("the weights fit");
        let rollouts = worker.collect(&mut acting, trainer.version(), &mut ());
        for end in rollouts.iter().flat_map(|rollout| &rollout.ends) {
            returns.push(end.summary.episode_return);
        }
        trainer.update(rollouts).expect("the update succeeds");
    }
    let last = &returns[returns.len().saturating_sub(20)..];
    last.iter().sum::<f64>() / last.len() as f64
}

#[test]
fn a_pole_is_balanced_with_every_seed() {
    // A random policy holds it for about 22 steps, a perfect one for 500.
    for run_seed in [1, 2, 3] {
        let mean = cartpole(run_seed, 60_000);
        assert!(mean > 200.0, "seed {run_seed}: {mean}");
    }
}
