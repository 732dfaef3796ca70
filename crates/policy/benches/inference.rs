//! Observations per second of fast inference: 60 inputs, actor 60-64-64 with heads 2+4+4+4, critic 60-64-64-1; and
//! the same behind ego attention to four frames of ten entities of seven numbers; and the steakhouse notifier: 242 inputs,
//! projection 32, an LSTM of 128 shared by actor and critic, heads 2+5+4+4.
//!
//! `cargo bench -p leadtime-policy --bench inference`

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use leadtime_numerics::Pcg64;
use leadtime_policy::{Parameters, Policy};
use leadtime_proto::{ActionSpec, EgoAttention, Encoder, Head, HeadCredit, PolicySpec};

fn heads(n_topics: usize) -> Vec<Head> {
    let head = |name: &str, n_choices| Head { name: name.to_owned(), n_choices };
    vec![head("initiate", 2), head("topic", n_topics), head("k", 4), head("l", 4)]
}

fn spec() -> PolicySpec {
    let heads = heads(4);
    PolicySpec {
        obs_dim: 60,
        encoder: Encoder::Identity,
        hidden: vec![64, 64],
        actions: ActionSpec { heads, gate: None, conditionals: Vec::new() },
        head_credit: HeadCredit::All,
        logit_bias: Vec::new(),
        normalize_observations: false,
    }
}

fn attentive() -> PolicySpec {
    let attention = EgoAttention {
        n_frames: 4,
        n_entities: 10,
        n_features: 7,
        action_dim: 13,
        width: 64,
        n_heads: 2,
    };
    let obs_dim = 4 * attention.frame_dim() + 5;
    PolicySpec { obs_dim, encoder: Encoder::EgoAttention(attention), ..spec() }
}

fn recurrent() -> PolicySpec {
    let actions = ActionSpec { heads: heads(5), gate: None, conditionals: Vec::new() };
    let encoder = Encoder::Lstm { projection: 32, state: 128 };
    PolicySpec { obs_dim: 242, encoder, hidden: Vec::new(), actions, ..spec() }
}

fn inference(criterion: &mut Criterion) {
    measure(criterion, "inference", &spec());
    measure(criterion, "inference with ego attention", &attentive());
    measure(criterion, "inference with lstm", &recurrent());
}

fn measure(criterion: &mut Criterion, name: &str, spec: &PolicySpec) {
    let parameters = Parameters::initialize(spec, 1).expect("the specification is sound");
    let mut policy = Policy::new(spec, &parameters).expect("the parameters fit");
    let mut generator = Pcg64::seed_from_u64(1);
    let mut group = criterion.benchmark_group(name);
    for batch in [1, 4, 16, 64, 256, 1024] {
        let observations: Vec<f32> =
            (0..batch * spec.obs_dim).map(|_| generator.uniform(-1.0, 1.0) as f32).collect();
        let mut logits = vec![0.0; batch * policy.n_choices()];
        let mut values = vec![0.0; batch];
        let mut recurrent = vec![0.0; batch * policy.recurrent_dim()];
        group.throughput(Throughput::Elements(batch as u64));
        group.bench_function(BenchmarkId::from_parameter(batch), |bencher| {
            bencher.iter(|| {
                let observations = black_box(&observations);
                policy.evaluate(observations, &mut recurrent, &mut logits, &mut values);
                black_box(&logits);
            });
        });
    }
    group.finish();
}

criterion_group!(benches, inference);
criterion_main!(benches);
