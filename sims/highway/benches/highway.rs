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

struct HighwayLoop {
    task: HighwayDomain,
    episode: u64,
    observation: Vec<f32>,
}

impl HighwayLoop {
    fn new() -> Self {
        let settings = HighwayWorldSettings { absorb_until: 0, ..HighwayWorldSettings::default() };
        let task = HighwayDomain::new(&settings).expect("the default world can be built");
        let observation = vec![0.0; task.obs_dim()];
        let mut this = Self { task, episode: 0, observation };
        this.reset();
        this
    }

    fn reset(&mut self) {
        let episode = self.episode;
        self.task.reset(EpisodeSeed { run_seed: 1, env_id: EnvId(0), episode });
        self.episode += 1;
    }

    fn run(&mut self, reaction: Option<ReactionStep>) {
        for _ in 0..DECISIONS {
            let advance = self.task.advance(reaction);
            self.task.observe(&mut self.observation);
            if advance.end.is_some() {
                self.reset();
            }
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
        traffic.push(vehicle);
    }
    traffic
}

fn frames_per_second(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("highway");
    group.throughput(Throughput::Elements(FRAMES)).sample_size(20);
    let slow_down = Some(ReactionStep { topic: 0, first: false });
    for (name, reaction) in [("unaided", None), ("slowing down", slow_down)] {
        let mut work = HighwayLoop::new();
        group.bench_function(name, |bencher| bencher.iter(|| work.run(reaction)));
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
