//! Frames per second of the lander on one core: `cargo bench -p leadtime-lander --bench lander`.
//!
//! Each iteration flies 10,000 frames, resets included, with the original's time limit (without it some landers
//! stay on the ground for ever, and the rate means nothing). `bench/peers/lander_*.py` does the same with
//! Gymnasium and EnvPool. Where there are two gears it also prints how many of the frames are in contact.

#![expect(clippy::print_stdout, reason = "criterion knows no shares")]

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use leadtime_lander::pilot::{Flyer, MAX_FRAMES, Pilot, heuristic};
use leadtime_lander::world::{Engine, Lander, Physics, PhysicsSettings};
use leadtime_numerics::Pcg64;

const FRAMES: u32 = 10_000;
/// Frames in which contact is counted, untimed.
const COUNTED: u32 = 100_000;

/// A lander that is reset whenever its episode ends.
struct LanderLoop {
    lander: Lander,
    next_seed: u64,
    frames: u32,
    /// Frames that the contact world moved.
    n_in_contact: u64,
}

impl LanderLoop {
    fn new(physics: Physics) -> Self {
        let lander = Lander::new(&PhysicsSettings { physics, ..PhysicsSettings::default() });
        Self { lander, next_seed: 1, frames: 0, n_in_contact: 0 }
    }

    fn step(&mut self, engine: Engine) {
        self.frames += 1;
        let is_over = self.lander.step(engine).outcome.is_some() || self.frames == MAX_FRAMES;
        self.n_in_contact += u64::from(self.lander.is_in_contact());
        if is_over {
            self.lander.reset(Pcg64::seed_from_u64(self.next_seed));
            self.next_seed += 1;
            self.frames = 0;
        }
    }
}

/// Returns the share of frames that the contact world moves.
fn contact_share(physics: Physics, engine: &mut dyn FnMut(&Lander) -> Engine) -> f64 {
    let mut world = LanderLoop::new(physics);
    (0..COUNTED).for_each(|_| world.step(engine(&world.lander)));
    world.n_in_contact as f64 / f64::from(COUNTED)
}

fn frames_per_second(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("lander");
    group.throughput(Throughput::Elements(u64::from(FRAMES))).sample_size(30);
    for (name, physics) in [("two gears", Physics::Hybrid), ("contact world", Physics::Rapier)] {
        let mut bench = |pilot: &str, engine: &mut dyn FnMut(&Lander) -> Engine| {
            if physics == Physics::Hybrid {
                let share = contact_share(physics, engine);
                println!("share of frames in the contact gear: {share:.3} {pilot}");
            }
            let mut world = LanderLoop::new(physics);
            group.bench_function(format!("{name}, {pilot}"), |bencher| {
                bencher.iter(|| (0..FRAMES).for_each(|_| world.step(engine(&world.lander))));
            });
        };
        let mut rng = Pcg64::seed_from_u64(7);
        bench("random actions", &mut |_| Engine::ALL[(rng.next_u64() >> 62) as usize]);
        bench("heuristic pilot", &mut |lander| heuristic(lander.observation()));
        let embedded = Flyer::Network { pilot: Pilot::embedded(), rests: true };
        bench("embedded pilot", &mut |lander| embedded.engine(lander.observation()));
    }
    group.finish();
}

criterion_group!(benches, frames_per_second);
criterion_main!(benches);
