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
use pulp::Arch;

use crate::storage::with_floats;

/// Gradients by tensor name.
pub(crate) type Gradients = BTreeMap<String, Vec<f32>>;

/// The gradient of one layer.
#[derive(Clone, Debug, Default)]
pub(crate) struct LayerGradient {
    /// Gradient of the weights. `[n_out, n_in]`
    pub(crate) weights: Vec<f32>,
    /// Gradient of the biases. `[n_out]`
    pub(crate) biases: Vec<f32>,
}

impl LayerGradient {
    pub(crate) fn clear(&mut self, layer: &Layer) {
        for (sums, n) in
            [(&mut self.weights, layer.n_out * layer.n_in), (&mut self.biases, layer.n_out)]
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

    /// Computes gradients from inputs, outputs and the slopes in the outputs, which become those before the activation.
    pub(crate) fn backward(
        &self,
        x: &[f32],
        y: &[f32],
        slopes: &mut [f32],
        gradients: &mut Gradients,
    ) {
        self.layer.activation.backward(y, slopes);
        gradients.insert(self.layer.weight(), self.matrix.d_weight(x, slopes));
        gradients.insert(self.layer.bias(), row_sums(slopes, self.layer.n_out));
    }

    /// Computes the slopes in x from those before the activation.
    pub(crate) fn d_input(&self, slopes: &[f32], d_x: &mut Vec<f32>) {
        self.matrix.d_input(slopes, d_x);
    }
}

/// Sums the rows of `[N, n]`, in their order.
pub(crate) fn row_sums(rows: &[f32], n: usize) -> Vec<f32> {
    let mut sums = vec![0.0; n];
    Arch::new().dispatch(
        #[inline(always)]
        || {
            for row in rows.chunks_exact(n) {
                sums.iter_mut().zip(row).for_each(|(sum, x)| *sum += x);
            }
        },
    );
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::{Plain, close, draw};

    #[test]
    fn a_layer_has_the_engines_own_values_and_gradients() {
        let shapes = [(1, 60, 64), (130, 64, 14), (77, 5, 1)];
        let activations = [Activation::Linear, Activation::Tanh, Activation::Relu];
        for ((n, n_in, n_out), activation) in
            shapes.into_iter().flat_map(|shape| activations.map(|activation| (shape, activation)))
        {
            let (x, weight) = (draw((n, n_in), 1), draw((n_out, n_in), 2));
            let bias = draw(n_out, 3);
            let sum = x.matmul(&weight.t().unwrap()).unwrap().broadcast_add(&bias).unwrap();
            let y = match activation {
                Activation::Linear => sum,
                Activation::Tanh => sum.tanh().unwrap(),
                Activation::Relu => sum.relu().unwrap(),
            };
            let plain = Plain::of(&y, &[&x, &weight, &bias]);
            let (name, gain, biased) = ("layer".to_owned(), 1.0, true);
            let mut layer = PackedLayer::new(Layer { name, n_in, n_out, gain, activation, biased });
            let vars = [("layer.weight", weight), ("layer.bias", bias)];
            layer
                .pack(&vars.into_iter().map(|(name, var)| (name.to_owned(), var)).collect())
                .unwrap();
            let x: Vec<f32> = x.flatten_all().unwrap().to_vec1().unwrap();
            let (mut y, mut d_x) = (Vec::new(), Vec::new());
            let mut gradients = Gradients::new();
            layer.forward(&x, &mut y);
            let mut slopes = plain.target.clone();
            layer.backward(&x, &y, &mut slopes, &mut gradients);
            layer.d_input(&slopes, &mut d_x);
            close(&y, &plain.values, 1e-5);
            close(&d_x, &plain.gradients[0], 5e-5);
            close(&gradients["layer.weight"], &plain.gradients[1], 5e-5);
            close(&gradients["layer.bias"], &plain.gradients[2], 5e-5);
        }
    }
}
