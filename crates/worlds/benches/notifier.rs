//! Steps per second of the lander's notifier task on one core: `cargo bench -p leadtime-worlds --bench notifier`.
//!
//! Each iteration takes 512 steps in each of 16 environments: five physics frames per step, flown by the embedded
//! pilot. `silent` never speaks; `random` starts a message in one step of four.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use leadtime_numerics::Pcg64;
use leadtime_proto::{EnvId, TaskSpec};
use leadtime_sims::{Environment, EpisodeSeed};

const N_ENVS: usize = 16;
const N_STEPS: usize = 512;

struct NotifierLoop {
    envs: Vec<(Box<dyn Environment>, EpisodeSeed)>,
    observation: Vec<f32>,
    generator: Pcg64,
}

impl NotifierLoop {
    fn new() -> Self {
        let task = TaskSpec { domain: "lander".to_owned(), settings: "{}".to_owned() };
        let registry = leadtime_worlds::builtin();
        let build = |env| {
            let seed = EpisodeSeed { run_seed: 1, env_id: EnvId(env), episode: 0 };
            (registry.build(&task).expect("the default task can be built"), seed)
        };
        let mut envs: Vec<_> = (0..N_ENVS as u32).map(build).collect();
        let mut observation = vec![0.0; envs[0].0.spec().obs_dim];
        for (env, seed) in &mut envs {
            env.reset(*seed, &mut observation);
        }
        Self { envs, observation, generator: Pcg64::seed_from_u64(1) }
    }

    fn run(&mut self, speaks: bool) {
        for _ in 0..N_STEPS {
            for (env, seed) in &mut self.envs {
                let generator = &mut self.generator;
                let mut action = [0; 4];
                if speaks {
                    let k = generator.below(4) as u8;
                    let l = k.max(generator.below(4) as u8);
                    let starts = u8::from(generator.below(4) == 0);
                    action = [starts, generator.below(4) as u8, k, l];
                }
                if env.step(&action, &mut self.observation).end.is_some() {
                    seed.episode += 1;
                    env.reset(*seed, &mut self.observation);
                }
            }
        }
    }
}

fn steps_per_second(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("notifier");
    group.throughput(Throughput::Elements((N_ENVS * N_STEPS) as u64)).sample_size(10);
    for (name, speaks) in [("silent", false), ("random", true)] {
        let mut work = NotifierLoop::new();
        group.bench_function(name, |bencher| bencher.iter(|| work.run(speaks)));
    }
    group.finish();
}

criterion_group!(benches, steps_per_second);
criterion_main!(benches);
