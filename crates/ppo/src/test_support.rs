//! What several tests of this crate need.

use candle_core::{Device, Shape, Tensor, Var};
use leadtime_numerics::Pcg64;

/// Draws a variable from -1 to 1.
pub(crate) fn draw(shape: impl Into<Shape>, seed: u64) -> Var {
    let (shape, mut generator) = (shape.into(), Pcg64::seed_from_u64(seed));
    let draws = (0..shape.elem_count()).map(|_| generator.uniform(-1.0, 1.0) as f32);
    Var::from_tensor(&Tensor::from_vec(draws.collect(), shape, &Device::Cpu).unwrap()).unwrap()
}

/// Copies a tensor's numbers out.
pub(crate) fn flat(tensor: &Tensor) -> Vec<f32> {
    tensor.flatten_all().unwrap().to_vec1().unwrap()
}

/// What the engine's own operations give: values, and the gradients of their product with a target.
pub(crate) struct Plain {
    pub(crate) values: Vec<f32>,
    /// The slopes of the product in the values.
    pub(crate) target: Vec<f32>,
    /// The slopes in the parameters, by variable.
    pub(crate) gradients: Vec<Vec<f32>>,
}

impl Plain {
    pub(crate) fn of(y: &Tensor, vars: &[&Var]) -> Self {
        let target = draw(y.dims(), 4);
        let loss = (y * target.as_tensor()).unwrap().sum_all().unwrap();
        let gradients = loss.backward().unwrap();
        let gradient = |var: &&Var| flat(gradients.get(var).unwrap());
        let gradients = vars.iter().map(gradient).collect();
        Self { values: flat(y), target: flat(&target), gradients }
    }
}

/// Asserts that two lists have numbers that differ by less than `tolerance`.
pub(crate) fn close(a: &[f32], b: &[f32], tolerance: f32) {
    assert_eq!(a.len(), b.len());
    for (i, (a, b)) in a.iter().zip(b).enumerate() {
        assert!((a - b).abs() < tolerance, "{i}: {a} {b}");
    }
}
