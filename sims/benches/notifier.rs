//! Steps per second of the piloting notifier on one core: `cargo bench -p leadtime-sims --bench notifier`.
//!
//! Each iteration takes 512 steps in each of 16 environments: five physics frames per step, flown by the embedded
//! pilot. `silent` never speaks; `random` starts a message in one step of four.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use leadtime_numerics::Pcg64;
use leadtime_proto::{EnvId, TaskSpec};
use leadtime_sims::{EpisodeSeed, Registry, Vectorized};

const N_ENVS: usize = 16;
const N_STEPS: usize = 512;
const N_HEADS: usize = 4;

struct Loop {
    rows: Vectorized,
    episodes: [u64; N_ENVS],
    generator: Pcg64,
    actions: [u8; N_ENVS * N_HEADS],
}

impl Loop {
    fn new() -> Self {
        let task = TaskSpec { domain: "lander".to_owned(), settings: "{}".to_owned() };
        let registry = Registry::builtin();
        let build = |_| registry.build(&task).expect("the default task can be built");
        let mut this = Self {
            rows: Vectorized::new((0..N_ENVS).map(build).collect()),
            episodes: [0; N_ENVS],
            generator: Pcg64::seed_from_u64(1),
            actions: [0; N_ENVS * N_HEADS],
        };
        (0..N_ENVS).for_each(|row| this.reset(row));
        this
    }

    fn reset(&mut self, row: usize) {
        let episode = self.episodes[row];
        self.rows.reset(row, EpisodeSeed { run_seed: 1, env_id: EnvId(row as u32), episode });
        self.episodes[row] += 1;
    }

    fn run(&mut self, speaks: bool) {
        for _ in 0..N_STEPS {
            if speaks {
                self.speak();
            }
            self.rows.step(&self.actions);
            for row in 0..N_ENVS {
                if self.rows.outcomes()[row].end.is_some() {
                    self.reset(row);
                }
            }
        }
    }

    fn speak(&mut self) {
        for action in self.actions.chunks_exact_mut(N_HEADS) {
            let k = self.generator.below(4) as u8;
            let l = k.max(self.generator.below(4) as u8);
            let starts = u8::from(self.generator.below(4) == 0);
            action.copy_from_slice(&[starts, self.generator.below(4) as u8, k, l]);
        }
    }
}

fn steps_per_second(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("notifier");
    group.throughput(Throughput::Elements((N_ENVS * N_STEPS) as u64)).sample_size(10);
    for (name, speaks) in [("silent", false), ("random", true)] {
        let mut work = Loop::new();
        group.bench_function(name, |bencher| bencher.iter(|| work.run(speaks)));
    }
    group.finish();
}

criterion_group!(benches, steps_per_second);
criterion_main!(benches);
