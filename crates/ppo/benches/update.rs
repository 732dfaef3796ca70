//! Samples per second of the PPO update (forward, loss, backward, clip, Adam) by minibatch size.
//!
//! 60 inputs, actor 60-64-64 with heads 2+4+4+4, separate critic 60-64-64-1; the same behind ego attention to four frames
//! of ten entities of seven numbers; and the steakhouse notifier, 242 inputs, projection 32, an LSTM of 128 shared by
//! actor and critic, heads 2+5+4+4, over sequences of 64 steps. `cargo bench -p leadtime-ppo`.

mod random_rollouts;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use leadtime_ppo::{LearnerSettings, Trainer};
use leadtime_proto::{CheckedRollout, PolicySpec};
use random_rollouts::{attentive, plain, recurrent, rollout};

const N_MINIBATCHES: usize = 4;
/// Steps of a sequence of the recurrent policy.
const SEQUENCE: usize = 64;

fn update(criterion: &mut Criterion) {
    for n_threads in [1, 2] {
        let name = |what: &str| match n_threads {
            1 => what.to_owned(),
            n => format!("{what}, {n} threads"),
        };
        measure(criterion, &name("update"), n_threads, &plain(), None);
        measure(criterion, &name("update with ego attention"), n_threads, &attentive(), None);
        measure(criterion, &name("update with lstm"), n_threads, &recurrent(), Some(SEQUENCE));
    }
}

/// Measures updates of rollouts of one long sequence, or of sequences of so many steps.
fn measure(
    criterion: &mut Criterion,
    name: &str,
    n_threads: usize,
    spec: &PolicySpec,
    sequence: Option<usize>,
) {
    let mut group = criterion.benchmark_group(name);
    for minibatch in [128, 512, 1200, 4096] {
        let n_samples = minibatch * N_MINIBATCHES;
        let n_steps = sequence.unwrap_or(n_samples);
        let settings = LearnerSettings {
            n_envs: n_samples / n_steps,
            n_steps,
            n_minibatches: N_MINIBATCHES,
            n_epochs: 4,
            threads: n_threads,
            ..LearnerSettings::default()
        };
        let mut trainer = Trainer::new(spec, &settings, 1).expect("sound settings");
        let rollouts: Vec<CheckedRollout> = (0..settings.n_envs as u32)
            .map(|env_id| rollout(spec, trainer.parameters(), env_id, n_steps))
            .collect();
        let n_trained = settings.n_envs * n_steps * settings.n_epochs;
        group.throughput(Throughput::Elements(n_trained as u64));
        group.bench_function(BenchmarkId::from_parameter(minibatch), |bencher| {
            bencher.iter(|| trainer.update(&rollouts).expect("the update succeeds"));
        });
    }
    group.finish();
}

criterion_group!(benches, update);
criterion_main!(benches);
