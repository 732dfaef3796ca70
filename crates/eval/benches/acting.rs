//! Steps per second of a notifier at work on one core: `cargo bench -p leadtime-eval --bench acting`.
//!
//! Sixty-four steakhouse episodes side by side, as an actor has them: the network (projection 32, an LSTM of 128 shared by
//! actor and critic) thinks about all of them at once, an action is drawn for each, and each takes its step, with resets.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use leadtime_episodes::{Choice, EnvSlot, Lockstep, Player};
use leadtime_proto::{Encoder, EnvId, HeadCredit, PolicySpec};
use leadtime_sims::{Environment, EpisodeSeed};
use leadtime_steakhouse::task::SteakhouseTaskSettings;

const BATCH: u32 = 64;

fn environment() -> Box<dyn Environment> {
    Box::new(SteakhouseTaskSettings::default().build().expect("the defaults are possible"))
}

fn steps_per_second(criterion: &mut Criterion) {
    let task = environment().spec().clone();
    let spec = PolicySpec {
        encoder: Encoder::Lstm { projection: 32, state: 128 },
        head_credit: HeadCredit::Active,
        ..PolicySpec::dense(&task, &[])
    };
    let mut player =
        Player::untrained(&spec, 1, Choice::Sample).expect("the architecture is sound");
    let slot = |env_id| {
        let seed = EpisodeSeed { run_seed: 1, env_id: EnvId(env_id), episode: 0 };
        EnvSlot::new(environment(), player.recurrent_dim(), seed)
    };
    let mut slots: Vec<EnvSlot> = (0..BATCH).map(slot).collect();
    let (mut lockstep, mut observers) = (Lockstep::default(), [(); BATCH as usize]);
    let mut group = criterion.benchmark_group("acting");
    group.throughput(Throughput::Elements(u64::from(BATCH)));
    group.bench_function("steakhouse with lstm at batch 64", |bencher| {
        bencher.iter(|| {
            lockstep.act(&mut player.decider(), &mut slots, &mut observers);
            lockstep.advance(&mut slots, &mut observers);
            lockstep.ended().iter().for_each(|&(row, _)| slots[row].begin_next());
        });
    });
    group.finish();
}

criterion_group!(benches, steps_per_second);
criterion_main!(benches);
