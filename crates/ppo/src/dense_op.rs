//! A fully connected layer as one node of the engine's graph: product, bias and activation fused, forward and backward.
//!
//! The arithmetic is that of [`leadtime_numerics::kernel`]: single-threaded, in a fixed order, and forward the same
//! bits as an actor's inference.

use candle_core::{CpuStorage, CustomOp3, Layout, Result, Shape, Tensor};
use leadtime_numerics::Panels;
use leadtime_numerics::kernel::{Activation, add_outer_products};

use crate::storage::{floats, with_floats};

/// `activation(x Wᵀ + b)` of x `[N, n_in]`, W `[n_out, n_in]` and b `[n_out]`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DenseOp {
    pub(crate) activation: Activation,
    /// Whether anything upstream learns; the first layer's input does not.
    pub(crate) input_gradient: bool,
}

impl CustomOp3 for DenseOp {
    fn name(&self) -> &'static str {
        "dense"
    }

    fn cpu_fwd(
        &self,
        x: &CpuStorage,
        x_layout: &Layout,
        weight: &CpuStorage,
        weight_layout: &Layout,
        bias: &CpuStorage,
        bias_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let (n, n_in) = x_layout.shape().dims2()?;
        let (n_out, expected) = weight_layout.shape().dims2()?;
        if expected != n_in {
            candle_core::bail!("dense: {n_in} inputs, the weights expect {expected}")
        }
        let panels = Panels::from_columns(floats(weight, weight_layout)?, n_out, n_in);
        let mut out = vec![0.0; n * n_out];
        let bias = floats(bias, bias_layout)?;
        panels.multiply(floats(x, x_layout)?, bias, self.activation, &mut out);
        Ok((CpuStorage::F32(out), Shape::from((n, n_out))))
    }

    fn bwd(
        &self,
        x: &Tensor,
        weight: &Tensor,
        bias: &Tensor,
        y: &Tensor,
        y_gradient: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let (n, n_in) = x.dims2()?;
        let n_out = bias.dims1()?;
        let device = x.device();
        let mut delta = with_floats(y_gradient, <[f32]>::to_vec)?;
        with_floats(y, |y| self.activation.backward(y, &mut delta))?;
        let mut d_bias = vec![0.0; n_out];
        for row in delta.chunks_exact(n_out) {
            d_bias.iter_mut().zip(row).for_each(|(sum, d)| *sum += d);
        }
        let mut d_weight = vec![0.0; n_out * n_in];
        with_floats(x, |x| add_outer_products(&delta, x, n_out, n_in, &mut d_weight))?;
        let d_x = if self.input_gradient {
            let mut d_x = vec![0.0; n * n_in];
            let panels = with_floats(weight, |weight| Panels::from_rows(weight, n_out, n_in))?;
            panels.multiply(&delta, &[], Activation::Linear, &mut d_x);
            Some(Tensor::from_vec(d_x, (n, n_in), device)?)
        } else {
            None
        };
        let d_weight = Tensor::from_vec(d_weight, (n_out, n_in), device)?;
        Ok((d_x, Some(d_weight), Some(Tensor::from_vec(d_bias, n_out, device)?)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::{draw, same_function};

    #[test]
    fn the_fused_layer_is_the_engines_own_layer_with_the_engines_own_gradients() {
        let shapes = [(1, 60, 64), (130, 64, 14), (77, 5, 1)];
        let activations = [Activation::Linear, Activation::Tanh, Activation::Relu];
        for ((n, n_in, n_out), activation) in
            shapes.into_iter().flat_map(|shape| activations.map(|activation| (shape, activation)))
        {
            let (x, weight) = (draw((n, n_in), 1), draw((n_out, n_in), 2));
            let bias = draw(n_out, 3);
            let op = DenseOp { activation, input_gradient: true };
            let fused = x.apply_op3(&weight, &bias, op).unwrap();
            let sum = x.matmul(&weight.t().unwrap()).unwrap().broadcast_add(&bias).unwrap();
            let plain = match activation {
                Activation::Linear => sum,
                Activation::Tanh => sum.tanh().unwrap(),
                Activation::Relu => sum.relu().unwrap(),
            };
            same_function(&fused, &plain, [&x, &weight, &bias], 5e-5);
        }
    }
}
