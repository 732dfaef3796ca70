//! Steps per second of a notifier at work on one core: `cargo bench -p leadtime-eval --bench acting`.
//!
//! Sixty-four steakhouse episodes side by side, as an actor has them: the network (projection 32, an LSTM of 128 shared by
//! actor and critic) thinks about all of them at once, an action is drawn for each, and each takes its step, with resets.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use leadtime_numerics::Pcg64;
use leadtime_policy::{ActionDistribution, Parameters, Policy};
use leadtime_proto::{Encoder, EnvId, HeadCredit, PolicySpec};
use leadtime_sims::cooking::{Cooking, CookingSettings};
use leadtime_sims::{Environment as _, EpisodeSeed, NotifierEnv};

const BATCH: usize = 64;

fn seed(lane: usize, episode: u64) -> EpisodeSeed {
    EpisodeSeed { run_seed: 1, env_id: EnvId(lane as u32), episode }
}

fn environment() -> NotifierEnv<Cooking> {
    let settings = CookingSettings::default();
    let task = Cooking::new(&settings.world).expect("the defaults are possible");
    NotifierEnv::new(task, &settings.human, &settings.notifier).expect("the defaults are possible")
}

fn steps_per_second(criterion: &mut Criterion) {
    let mut lanes: Vec<NotifierEnv<Cooking>> = (0..BATCH).map(|_| environment()).collect();
    let spec = PolicySpec {
        obs_dim: lanes[0].spec().obs_dim,
        encoder: Encoder::Lstm { projection: 32, state: 128 },
        hidden: Vec::new(),
        actions: lanes[0].spec().actions.clone(),
        head_credit: HeadCredit::Active,
        logit_bias: Vec::new(),
        normalize_observations: false,
    };
    let parameters = Parameters::initialize(&spec, 1).expect("the specification is sound");
    let mut policy = Policy::new(&spec, &parameters).expect("the parameters fit");
    let distribution = ActionDistribution::new(&spec.actions, spec.head_credit);
    let (width, state_dim) = (policy.n_choices(), policy.recurrent_dim());
    let mut observations = vec![0.0; BATCH * spec.obs_dim];
    for (i, (lane, row)) in lanes.iter_mut().zip(observations.chunks_mut(spec.obs_dim)).enumerate()
    {
        lane.reset(seed(i, 0), row);
    }
    let mut recurrent = vec![0.0; BATCH * state_dim];
    let (mut logits, mut values) = (vec![0.0; BATCH * width], vec![0.0; BATCH]);
    let mut action = vec![0; spec.actions.heads.len()];
    let mut generator = Pcg64::seed_from_u64(7);
    let mut episode = 0;
    let mut group = criterion.benchmark_group("acting");
    group.throughput(Throughput::Elements(BATCH as u64));
    group.bench_function("steakhouse with lstm at batch 64", |bencher| {
        bencher.iter(|| {
            policy.evaluate(&observations, &mut recurrent, &mut logits, &mut values);
            let rows = observations.chunks_mut(spec.obs_dim).zip(logits.chunks(width));
            for (i, (lane, (row, logits))) in lanes.iter_mut().zip(rows).enumerate() {
                distribution.sample(logits, lane.mask(), &mut generator, &mut action);
                if lane.step(&action, row).end.is_some() {
                    episode += 1;
                    lane.reset(seed(i, episode), row);
                    recurrent[i * state_dim..][..state_dim].fill(0.0);
                }
            }
        });
    });
    group.finish();
}

criterion_group!(benches, steps_per_second);
criterion_main!(benches);
