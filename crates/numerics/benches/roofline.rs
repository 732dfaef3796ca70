//! What this processor can do at most, and how near to it the kernels are, both in floating-point operations per
//! second of one core; memory in bytes per second.
//!
//! The shapes are those of one block of the update: 512 rows through layers of 60-64-64. `cargo bench -p
//! leadtime-numerics --bench roofline`.

#![expect(
    clippy::inline_always,
    reason = "kernels must be compiled inside the dispatched target features"
)]

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use leadtime_numerics::Pcg64;
use leadtime_numerics::kernel::{Activation, Panels, add_outer_products};
use pulp::{Arch, Simd, WithSimd};

/// Independent chains of fused multiply-adds: more than latency times multipliers.
const CHAINS: usize = 12;
const ROUNDS: usize = 1_000;
const ROWS: usize = 512;

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

fn machine(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("machine");
    let lanes = Arch::new().dispatch(Peak);
    group.throughput(Throughput::Elements((2 * CHAINS * ROUNDS * lanes) as u64));
    group.bench_function("multiply-add", |bencher| bencher.iter(|| Arch::new().dispatch(Peak)));
    let n = 16 << 20;
    let (mut a, b, c) = (vec![0.0; n], draws(n, 1), draws(n, 2));
    group.throughput(Throughput::Bytes((3 * size_of::<f32>() * n) as u64));
    group.bench_function("memory", |bencher| {
        bencher.iter(|| Arch::new().dispatch(Triad(&mut a, &b, &c)));
    });
    group.finish();
}

fn kernels(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("kernel");
    for (k, n) in [(60, 64), (64, 64), (64, 14)] {
        let shape = format!("{ROWS} x {k} x {n}");
        group.throughput(Throughput::Elements((2 * ROWS * k * n) as u64));
        let panels = Panels::from_rows(&draws(k * n, 1), k, n);
        let (a, b) = (draws(ROWS * k, 2), draws(ROWS * n, 3));
        let mut out = vec![0.0; ROWS * n];
        for activation in [Activation::Linear, Activation::Tanh] {
            let name = BenchmarkId::new(format!("multiply {activation:?}"), &shape);
            group.bench_function(name, |bencher| {
                bencher.iter(|| panels.multiply(&a, &[], activation, &mut out));
            });
        }
        let mut products = vec![0.0; n * k];
        group.bench_function(BenchmarkId::new("outer products", &shape), |bencher| {
            bencher.iter(|| add_outer_products(&b, &a, n, k, &mut products));
        });
    }
    group.finish();
}

criterion_group!(benches, machine, kernels);
criterion_main!(benches);
