//! Steps per second of the steakhouse on one core: `cargo bench -p leadtime-steakhouse --bench steakhouse`.
//!
//! Each iteration takes 10,000 steps, resets included. `world and cook`: the cook decides and the kitchen moves on.
//! `domain`: the same as a task, with rewards, observations and a reference run per episode. `notifier`: the whole
//! environment, with a message in one step of four. `bench/peers/steakhouse.py` does the first two in Python.

use std::sync::Arc;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use leadtime_numerics::Pcg64;
use leadtime_proto::EnvId;
use leadtime_sims::{Domain as _, Environment as _, EpisodeSeed};
use leadtime_steakhouse::task::{SteakhouseDomain, SteakhouseTaskSettings};
use leadtime_steakhouse::world::{
    FieldOfView, Floorplan, Kitchen, KitchenStart, StartFamily, Ties, WorkTimes, kitchen,
    random_pose,
};

const STEPS: u32 = 10_000;
const MAX_STEPS: u32 = 100;

fn seed(episode: u64) -> EpisodeSeed {
    EpisodeSeed { run_seed: 1, env_id: EnvId(0), episode }
}

/// Opens a kitchen; with it comes how an episode of it starts.
fn open() -> (Kitchen, KitchenStart) {
    let grid = kitchen("ring").expect("it is built in");
    let start = KitchenStart::new(&grid).expect("it has a start");
    let plan = Arc::new(Floorplan::new(grid, FieldOfView::Block));
    (Kitchen::new(plan, WorkTimes::default(), 1), start)
}

fn steps_per_second(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("steakhouse");
    group.throughput(Throughput::Elements(u64::from(STEPS))).sample_size(20);
    let (mut kitchen, mut start) = open();
    let mut generator = Pcg64::seed_from_u64(1);
    group.bench_function("world and cook", |bencher| {
        bencher.iter(|| {
            for _ in 0..STEPS {
                if kitchen.n_steps % MAX_STEPS == 0 || kitchen.world.is_done() {
                    let grid = &kitchen.plan.grid;
                    let times = WorkTimes::default();
                    StartFamily::Random.fill(grid, times, &mut generator, &mut start.contents);
                    start.pose = random_pose(grid, &mut generator);
                    kitchen.begin(&start, false);
                }
                let action = kitchen.decide(Ties::Random(&mut generator));
                kitchen.step(action, true);
            }
        });
    });

    let settings = SteakhouseTaskSettings::default();
    let mut task = SteakhouseDomain::new(&settings.world).expect("the defaults are possible");
    let mut observation = vec![0.0; task.obs_dim()];
    let mut episode = 0;
    task.reset(seed(episode));
    group.bench_function("domain", |bencher| {
        bencher.iter(|| {
            for _ in 0..STEPS {
                if task.advance(None).end.is_some() {
                    episode += 1;
                    task.reset(seed(episode));
                }
                task.observe(&mut observation);
            }
        });
    });

    let mut env = settings.build().expect("the defaults are possible");
    let mut observation = vec![0.0; env.spec().obs_dim];
    let mut generator = Pcg64::seed_from_u64(7);
    env.reset(seed(episode), &mut observation);
    group.bench_function("notifier", |bencher| {
        bencher.iter(|| {
            for _ in 0..STEPS {
                let speaks = u8::from(generator.below(4) == 0);
                let k = generator.below(4);
                let l = k + generator.below(4 - k);
                let topic = generator.below(5) as u8;
                let action = [speaks, topic, k as u8, l as u8];
                if env.step(&action, &mut observation).end.is_some() {
                    episode += 1;
                    env.reset(seed(episode), &mut observation);
                }
            }
        });
    });
    group.finish();
}

criterion_group!(benches, steps_per_second);
criterion_main!(benches);
