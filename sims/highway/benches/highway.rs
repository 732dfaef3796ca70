//! Frames per second of the highway on one core: `cargo bench -p leadtime-highway --bench highway`.
//!
//! Each iteration drives 2,000 decisions of five frames with five to eight cars, observation, reward and resets
//! included; `frames only` leaves observation and reward out. `bench/peers/highway.py` does the same with
//! highway-env.

use std::sync::Arc;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use leadtime_highway::task::{HighwayDomain, HighwayWorldSettings};
use leadtime_highway::world::{Blindness, Lookup, RoadSettings, Traffic, Vehicle};
use leadtime_proto::EnvId;
use leadtime_sims::{Domain as _, EpisodeSeed, ReactionStep};

const DECISIONS: u64 = 2_000;
const FRAMES: u64 = 5 * DECISIONS;

/// Drives on, and starts the next episode where one ends.
fn drive(
    task: &mut HighwayDomain,
    observation: &mut [f32],
    seed: &mut EpisodeSeed,
    reaction: Option<ReactionStep>,
) {
    for _ in 0..DECISIONS {
        let advance = task.advance(reaction);
        task.observe(observation);
        if advance.end.is_some() {
            seed.episode += 1;
            task.reset(*seed);
        }
    }
}

/// Eight cars on the road with three merges, none of which ends the drive.
fn traffic() -> Traffic {
    let road = RoadSettings::three_merges().build(Lookup::Geometry).expect("the road is a road");
    let mut traffic = Traffic::new(Arc::new(road), Blindness::UntilSettled);
    for i in 0..8 {
        let place = [40.0 * f64::from(i), 4.0 * f64::from(i % 2)];
        let vehicle = Vehicle::new(traffic.network(), place, 0.0, 28.0).with_idm(28.0);
        traffic.vehicles.push(vehicle);
    }
    traffic
}

fn frames_per_second(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("highway");
    group.throughput(Throughput::Elements(FRAMES)).sample_size(20);
    let slow_down = Some(ReactionStep { topic: 0, first: false });
    for (name, reaction) in [("unaided", None), ("slowing down", slow_down)] {
        let settings = HighwayWorldSettings { absorb_until: 0, ..HighwayWorldSettings::default() };
        let mut task = HighwayDomain::new(&settings).expect("the default world can be built");
        let mut observation = vec![0.0; task.obs_dim()];
        let mut seed = EpisodeSeed { run_seed: 1, env_id: EnvId(0), episode: 0 };
        task.reset(seed);
        group.bench_function(name, |bencher| {
            bencher.iter(|| drive(&mut task, &mut observation, &mut seed, reaction));
        });
    }
    let start = traffic();
    group.bench_function("frames only, eight cars", |bencher| {
        bencher.iter(|| {
            for _ in 0..FRAMES / 400 {
                let mut traffic = start.clone();
                (0..400).for_each(|_| traffic.step(1.0 / 15.0));
            }
        });
    });
    group.finish();
}

criterion_group!(benches, frames_per_second);
criterion_main!(benches);
