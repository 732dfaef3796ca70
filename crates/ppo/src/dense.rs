//! Matrices and fully connected layers, packed for both directions: from inputs to outputs, and from slopes in the outputs
//! back to slopes in inputs and weights.
//!
//! The arithmetic is that of [`leadtime_numerics::kernel`]: in a fixed order, and forward the same bits as an actor's
//! inference.

use std::collections::BTreeMap;

use candle_core::{Result, Var};
use leadtime_numerics::Panels;
use leadtime_numerics::kernel::{Activation, add_outer_products};
use leadtime_policy::architecture::Layer;

use crate::storage::with_floats;

/// Gradients by tensor name.
pub(crate) type Gradients = BTreeMap<String, Vec<f32>>;

#[derive(Clone, Debug, Default)]
pub(crate) struct LayerGradient {
    /// Gradient of the weights. `[n_out, n_in]`
    pub(crate) weights: Vec<f32>,
    /// Gradient of the biases. `[n_out]`
    pub(crate) biases: Vec<f32>,
}

impl LayerGradient {
    pub(crate) fn clear(&mut self, layer: &Layer) {
        let n_biases = if layer.biased { layer.n_out } else { 0 };
        for (sums, n) in
            [(&mut self.weights, layer.n_out * layer.n_in), (&mut self.biases, n_biases)]
        {
            sums.clear();
            sums.resize(n, 0.0);
        }
    }

    pub(crate) fn add(&mut self, other: &Self) {
        let add = |sums: &mut [f32], values: &[f32]| {
            sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
        };
        add(&mut self.weights, &other.weights);
        add(&mut self.biases, &other.biases);
    }
}

/// Gives a buffer a length and keeps its memory; what is in it does not count.
pub(crate) fn resize(buffer: &mut Vec<f32>, len: usize) -> &mut [f32] {
    buffer.resize(len, 0.0);
    buffer
}

/// A matrix W `[n_out, n_in]`.
#[derive(Clone, Debug, Default)]
pub(crate) struct PackedMatrix {
    /// Wᵀ: from inputs to outputs.
    pub(crate) forward: Panels,
    /// W: from the outputs' slopes to the inputs'.
    pub(crate) backward: Panels,
}

impl PackedMatrix {
    pub(crate) fn pack(&mut self, weight: &[f32], n_out: usize, n_in: usize) {
        self.forward.pack_columns(weight, n_out, n_in);
        self.backward.pack_rows(weight, n_out, n_in);
    }

    fn n_in(&self) -> usize {
        self.forward.depth()
    }

    fn n_out(&self) -> usize {
        self.forward.n_columns()
    }

    /// Computes `activation(x Wᵀ + bias)` of x `[N, n_in]`.
    pub(crate) fn multiply(
        &self,
        x: &[f32],
        bias: &[f32],
        activation: Activation,
        out: &mut Vec<f32>,
    ) {
        let n = x.len() / self.n_in();
        self.forward.multiply(x, bias, activation, resize(out, n * self.n_out()));
    }

    /// Computes the slopes in x from those in `x Wᵀ`, `[N, n_out]`.
    pub(crate) fn d_input(&self, slopes: &[f32], d_x: &mut Vec<f32>) {
        let n = slopes.len() / self.n_out();
        self.backward.multiply(slopes, &[], Activation::Linear, resize(d_x, n * self.n_in()));
    }

    /// Computes the slopes in W from x and those in `x Wᵀ`.
    pub(crate) fn d_weight(&self, x: &[f32], slopes: &[f32]) -> Vec<f32> {
        let (n_out, n_in) = (self.n_out(), self.n_in());
        let mut d_weight = vec![0.0; n_out * n_in];
        add_outer_products(slopes, x, n_out, n_in, &mut d_weight);
        d_weight
    }
}

/// A layer with its weights.
#[derive(Clone, Debug)]
pub(crate) struct PackedLayer {
    pub(crate) layer: Layer,
    pub(crate) matrix: PackedMatrix,
    pub(crate) bias: Vec<f32>,
}

impl PackedLayer {
    pub(crate) fn new(layer: Layer) -> Self {
        Self { layer, matrix: PackedMatrix::default(), bias: Vec::new() }
    }

    /// Takes over the variables' present numbers; an error if the engine holds them otherwise than as plain floats.
    pub(crate) fn pack(&mut self, vars: &BTreeMap<String, Var>) -> Result<()> {
        let Self { layer, matrix, bias } = self;
        with_floats(&vars[&layer.weight()], |weight| matrix.pack(weight, layer.n_out, layer.n_in))?;
        with_floats(&vars[&layer.bias()], |values| {
            bias.clear();
            bias.extend_from_slice(values);
        })
    }

    /// Computes the outputs `[N, n_out]` of x `[N, n_in]`.
    pub(crate) fn forward(&self, x: &[f32], y: &mut Vec<f32>) {
        self.matrix.multiply(x, &self.bias, self.layer.activation, y);
    }
}
