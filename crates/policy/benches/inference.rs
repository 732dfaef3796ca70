//! Observations per second of fast inference: 60 inputs, actor 60-64-64 with heads 2+4+4+4, critic 60-64-64-1; and
//! the same behind ego attention to four frames of ten entities of seven numbers; and the steakhouse notifier: 242 inputs,
//! projection 32, an LSTM of 128 shared by actor and critic, heads 2+5+4+4.
//!
//! `cargo bench -p leadtime-policy --bench inference`

mod shapes;

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use leadtime_numerics::Pcg64;
use leadtime_policy::{Parameters, Policy};
use leadtime_proto::PolicySpec;
use shapes::{attentive, plain, recurrent};

fn inference(criterion: &mut Criterion) {
    measure(criterion, "inference", &plain());
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
