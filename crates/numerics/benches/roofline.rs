//! What this processor can do at most, and how near to it the kernels are, both in floating-point operations per
//! second of one core; memory in bytes per second.
//!
//! The shapes are those of blocks of 512 rows of an update: layers of 60-64-64 and their heads, 64-14; the attention's
//! first embedding, 7-64; the gates of the LSTM, 32-512 from its input and 128-512 from its state. At the end there is
//! a line for each that says how near it is to the peak. `cargo bench -p leadtime-numerics --bench roofline`.

#![expect(
    clippy::inline_always,
    reason = "kernels must be compiled inside the dispatched target features"
)]
#![expect(clippy::print_stdout, reason = "criterion knows no shares")]

use std::hint::black_box;
use std::time::Instant;

use criterion::measurement::WallTime;
use criterion::{
    BenchmarkGroup, BenchmarkId, Criterion, Throughput, criterion_group, criterion_main,
};
use leadtime_numerics::Pcg64;
use leadtime_numerics::kernel::{Activation, Panels, add_outer_products};
use pulp::{Arch, Simd, WithSimd};

/// Independent chains of fused multiply-adds: more than latency times multipliers.
const CHAINS: usize = 12;
const ROUNDS: usize = 1_000;
const ROWS: usize = 512;
/// Inputs and outputs of the layers.
const SHAPES: [(usize, usize); 6] = [(60, 64), (64, 64), (64, 14), (7, 64), (32, 512), (128, 512)];

/// Multiply-adds on registers alone; returns how many lanes each vector has.
struct Peak;

impl WithSimd for Peak {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> usize {
        let factor = simd.splat_f32s(black_box(0.999));
        let mut chains = [simd.splat_f32s(black_box(1.0)); CHAINS];
        for _ in 0..ROUNDS {
            for chain in &mut chains {
                *chain = simd.mul_add_f32s(*chain, factor, factor);
            }
        }
        let sum = chains.into_iter().reduce(|a, b| simd.add_f32s(a, b));
        black_box(sum.map(|sum| simd.reduce_sum_f32s(sum)));
        S::F32_LANES
    }
}

/// `a = b + s c` over arrays that no cache holds.
struct Triad<'a>(&'a mut [f32], &'a [f32], &'a [f32]);

impl WithSimd for Triad<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (a, _) = S::as_mut_simd_f32s(self.0);
        let (b, _) = S::as_simd_f32s(self.1);
        let (c, _) = S::as_simd_f32s(self.2);
        let factor = simd.splat_f32s(3.0);
        for ((a, b), c) in a.iter_mut().zip(b).zip(c) {
            *a = simd.mul_add_f32s(factor, *c, *b);
        }
    }
}

fn draws(n: usize, seed: u64) -> Vec<f32> {
    let mut generator = Pcg64::seed_from_u64(seed);
    (0..n).map(|_| generator.uniform(-1.0, 1.0) as f32).collect()
}

/// Measures work of so many floating-point operations; returns the most that were done in a second, unless the bench was
/// left out.
fn measure(
    group: &mut BenchmarkGroup<'_, WallTime>,
    name: &str,
    n_operations: usize,
    mut work: impl FnMut(),
) -> Option<f64> {
    let mut shortest = f64::INFINITY;
    group.throughput(Throughput::Elements(n_operations as u64));
    group.bench_function(BenchmarkId::from_parameter(name), |bencher| {
        bencher.iter_custom(|n| {
            let started = Instant::now();
            (0..n).for_each(|_| work());
            let taken = started.elapsed();
            shortest = shortest.min(taken.as_secs_f64() / n as f64);
            taken
        });
    });
    shortest.is_finite().then(|| n_operations as f64 / shortest)
}

fn roofline(criterion: &mut Criterion) {
    let peak = machine(criterion);
    let most = kernels(criterion);
    for (name, most) in most {
        if let (Some(most), Some(peak)) = (most, peak) {
            println!("share of the peak: {:.2} {name}", most / peak);
        }
    }
}

/// Returns the peak, in operations per second.
fn machine(criterion: &mut Criterion) -> Option<f64> {
    let mut group = criterion.benchmark_group("machine");
    let lanes = Arch::new().dispatch(Peak);
    let peak = measure(&mut group, "multiply-add", 2 * CHAINS * ROUNDS * lanes, || {
        black_box(Arch::new().dispatch(Peak));
    });
    let n = 16 << 20;
    let (mut a, b, c) = (vec![0.0; n], draws(n, 1), draws(n, 2));
    group.throughput(Throughput::Bytes((3 * size_of::<f32>() * n) as u64));
    group.bench_function("memory", |bencher| {
        bencher.iter(|| Arch::new().dispatch(Triad(&mut a, &b, &c)));
    });
    group.finish();
    peak
}

/// Returns the most operations per second of every kernel at every shape.
fn kernels(criterion: &mut Criterion) -> Vec<(String, Option<f64>)> {
    let mut group = criterion.benchmark_group("kernel");
    let mut found = Vec::new();
    for (k, n) in SHAPES {
        let n_operations = 2 * ROWS * k * n;
        let panels = Panels::from_rows(&draws(k * n, 1), k, n);
        let (a, b) = (draws(ROWS * k, 2), draws(ROWS * n, 3));
        let mut out = vec![0.0; ROWS * n];
        for activation in [Activation::Linear, Activation::Tanh] {
            let name = format!("multiply {activation:?} {ROWS} x {k} x {n}");
            let most = measure(&mut group, &name, n_operations, || {
                panels.multiply(&a, &[], activation, &mut out);
            });
            found.push((name, most));
        }
        let mut products = vec![0.0; n * k];
        let name = format!("outer products {ROWS} x {k} x {n}");
        let most = measure(&mut group, &name, n_operations, || {
            add_outer_products(&b, &a, n, k, &mut products);
        });
        found.push((name, most));
    }
    group.finish();
    found
}

criterion_group!(benches, roofline);
criterion_main!(benches);
