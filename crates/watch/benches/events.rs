//! What ten thousand events of a run take in the view of its page. A watcher that attaches late takes them in before it shows anything.
//!
//! `cargo bench -p leadtime-watch --bench events`

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use leadtime_watch::RunView;
use serde_json::{Value, json};

const N_EVENTS: u64 = 10_000;

fn line(update: u64) -> Value {
    json!({
        "kind": "update", "update": update, "steps": update * 64, "made": 1000.0 + update as f64,
        "time": "2026-01-31T12:00:00Z", "staleness": {"0": 3, "1": 29}, "refusals": {},
        "episodes/success": update as f64 / 1e5, "episodes/return": 1.0, "train/entropy": 2.0,
        "system/steps_per_second": 64.0, "system/wait_seconds": 0.62, "system/train_seconds": 0.3,
        "books/published": update * 8 + 4, "books/trained": update * 8,
    })
}

fn events(criterion: &mut Criterion) {
    let lines: Vec<Value> = (1..=N_EVENTS).map(line).collect();
    let take_in = |lines: Vec<Value>| {
        let mut view = RunView::new("r");
        view.learner_joined("01", 1000.0);
        for (update, line) in (1_u64..).zip(lines) {
            view.learner_says("01", line, 1000.0 + update as f64);
        }
        view
    };
    criterion.bench_function("ten_thousand_events", |bencher| {
        bencher.iter_batched(|| lines.clone(), take_in, BatchSize::LargeInput);
    });
}

criterion_group!(benches, events);
criterion_main!(benches);
