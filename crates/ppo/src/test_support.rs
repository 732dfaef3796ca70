//! What several tests of this crate need.

use candle_core::{Device, Shape, Tensor, Var};
use leadtime_numerics::Pcg64;

/// Draws a variable from -1 to 1.
pub(crate) fn draw(shape: impl Into<Shape>, seed: u64) -> Var {
    let (shape, mut generator) = (shape.into(), Pcg64::seed_from_u64(seed));
    let draws = (0..shape.elem_count()).map(|_| generator.uniform(-1.0, 1.0) as f32);
    Var::from_tensor(&Tensor::from_vec(draws.collect(), shape, &Device::Cpu).unwrap()).unwrap()
}

/// Asserts that two results are the same function of the variables: by value, and by the gradients of their product
/// with a target.
pub(crate) fn same_function(fused: &Tensor, plain: &Tensor, vars: [&Var; 3], tolerance: f32) {
    close(fused, plain, 1e-5);
    let target = draw(fused.dims(), 4);
    let gradients =
        |y: &Tensor| (y * target.as_tensor()).unwrap().sum_all().unwrap().backward().unwrap();
    let (of_fused, of_plain) = (gradients(fused), gradients(plain));
    for var in vars {
        close(of_fused.get(var).unwrap(), of_plain.get(var).unwrap(), tolerance);
    }
}

/// Asserts that two tensors have the same shape and numbers that differ by less than `tolerance`.
pub(crate) fn close(a: &Tensor, b: &Tensor, tolerance: f32) {
    let flat = |tensor: &Tensor| tensor.flatten_all().unwrap().to_vec1::<f32>().unwrap();
    assert_eq!(a.dims(), b.dims());
    for (i, (a, b)) in flat(a).iter().zip(flat(b)).enumerate() {
        assert!((a - b).abs() < tolerance, "{i}: {a} {b}");
    }
}
