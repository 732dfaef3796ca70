//! Samples per second of the PPO update (forward, loss, backward, clip, Adam) by minibatch size.
//!
//! 60 inputs, actor 60-64-64 with heads 2+4+4+4, separate critic 60-64-64-1: `cargo bench -p leadtime-ppo`.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use leadtime_numerics::Pcg64;
use leadtime_policy::{ActionDistribution, Policy};
use leadtime_ppo::{LearnerSettings, Trainer};
use leadtime_proto::{
    ActionSpec, CheckedRollout, Encoder, EnvId, EnvSpec, Head, HeadCredit, Mask, PolicySpec,
    Rollout,
};

const OBS_DIM: usize = 60;
const N_MINIBATCHES: usize = 4;

fn specs() -> (PolicySpec, EnvSpec) {
    let head = |name: &str, n_choices| Head { name: name.to_owned(), n_choices };
    let heads = vec![head("initiate", 2), head("topic", 4), head("k", 4), head("l", 4)];
    let actions = ActionSpec { heads, gate: None, conditionals: Vec::new() };
    let policy = PolicySpec {
        obs_dim: OBS_DIM,
        encoder: Encoder::Identity,
        hidden: vec![64, 64],
        actions: actions.clone(),
        head_credit: HeadCredit::All,
        logit_bias: Vec::new(),
        normalize_observations: false,
    };
    (policy, EnvSpec { obs_dim: OBS_DIM, actions, metrics: Vec::new() })
}

/// Makes one rollout of random observations, acted by the trainer's present policy.
fn rollout(trainer: &Trainer, n_steps: usize) -> CheckedRollout {
    let (spec, env) = specs();
    let mut policy = Policy::new(&spec, trainer.parameters()).expect("the parameters fit");
    let distribution = ActionDistribution::new(&spec.actions, spec.head_credit);
    let mut generator = Pcg64::seed_from_u64(3);
    let mut draws =
        |n: usize| -> Vec<f32> { (0..n).map(|_| generator.uniform(-1.0, 1.0) as f32).collect() };
    let (observations, rewards) = (draws(n_steps * OBS_DIM), draws(n_steps));
    let next_observation = draws(OBS_DIM);
    let (mut logits, mut values) = (vec![0.0; n_steps * 14], vec![0.0; n_steps]);
    policy.evaluate(&observations, &mut [], &mut logits, &mut values);
    let mut actions = vec![0; n_steps * 4];
    let rows = logits.chunks_exact(14).zip(actions.chunks_exact_mut(4));
    let log_probs = rows
        .map(|(logits, action)| distribution.sample(logits, Mask::ALL, &mut generator, action))
        .collect();
    let rollout = Rollout {
        env_id: EnvId(0),
        version: trainer.version(),
        n_steps: n_steps as u32,
        observations,
        next_observation,
        masks: vec![u64::MAX; n_steps],
        actions,
        log_probs,
        values,
        rewards,
        snapshot: vec![0],
        ..Rollout::default()
    };
    rollout.check(&env, n_steps, 0).expect("the rollout fits its own trainer")
}

fn update(criterion: &mut Criterion) {
    let (policy, _) = specs();
    let mut group = criterion.benchmark_group("update");
    for minibatch in [128, 512, 1200, 4096] {
        let settings = LearnerSettings {
            n_envs: 1,
            n_steps: minibatch * N_MINIBATCHES,
            n_minibatches: N_MINIBATCHES,
            n_epochs: 4,
            ..LearnerSettings::default()
        };
        let mut trainer = Trainer::new(&policy, &settings, 1).expect("sound settings");
        let rollouts = [rollout(&trainer, settings.n_steps)];
        group.throughput(Throughput::Elements((settings.n_steps * settings.n_epochs) as u64));
        group.bench_function(BenchmarkId::from_parameter(minibatch), |bencher| {
            bencher.iter(|| trainer.update(&rollouts).expect("the update succeeds"));
        });
    }
    group.finish();
}

criterion_group!(benches, update);
criterion_main!(benches);
