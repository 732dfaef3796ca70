//! A fully connected layer for acting: weights packed once, any number of rows at a time.

use thiserror::Error;

use crate::kernel::{Activation, Panels};

/// Why numbers do not make a layer.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{n_weights} weights cannot be shared out among {n_out} outputs")]
pub struct DenseError {
    /// How many weights there are; they should be one row per output.
    pub n_weights: usize,
    /// How many biases, so outputs, there are.
    pub n_out: usize,
}

/// One fully connected layer, `y = activation(W x + b)`.
///
/// A row's result does not depend on how many rows there are or on its place among them.
///
/// # Example
///
/// ```
/// use leadtime_numerics::{Activation, Dense};
///
/// let layer = Dense::new(&[1.0, 2.0, 3.0, 4.0], &[0.5, -0.5])?;
/// let mut y = [0.0; 2];
/// layer.forward(&[1.0, 10.0], &mut y, Activation::Linear);
/// assert_eq!(y, [21.5, 42.5]);
/// # Ok::<(), leadtime_numerics::DenseError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Dense {
    weights: Panels,
    bias: Vec<f32>,
}

impl Dense {
    /// Packs a layer's weights.
    ///
    /// # Shapes
    ///
    /// `weight`: `[n_out, n_in]` by rows; `bias`: `[n_out]`.
    ///
    /// # Errors
    ///
    /// [`DenseError`] if the weights do not form rows.
    pub fn new(weight: &[f32], bias: &[f32]) -> Result<Self, DenseError> {
        let n_out = bias.len();
        if n_out == 0 || !weight.len().is_multiple_of(n_out) {
            return Err(DenseError { n_weights: weight.len(), n_out });
        }
        let weights = Panels::from_columns(weight, n_out, weight.len() / n_out);
        Ok(Self { weights, bias: bias.to_vec() })
    }

    /// Returns the number of inputs.
    pub fn n_in(&self) -> usize {
        self.weights.depth()
    }

    /// Returns the number of outputs.
    pub fn n_out(&self) -> usize {
        self.bias.len()
    }

    /// Computes the layer for each row.
    ///
    /// # Shapes
    ///
    /// `x`: `[N, n_in]`; `y`: `[N, n_out]`.
    ///
    /// # Panics
    ///
    /// If the shapes do not hold.
    pub fn forward(&self, x: &[f32], y: &mut [f32], activation: Activation) {
        self.weights.multiply(x, &self.bias, activation, y);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Pcg64;

    #[test]
    fn a_row_does_not_know_its_batch() {
        let mut generator = Pcg64::seed_from_u64(1);
        let mut draws =
            |n: usize| (0..n).map(|_| generator.uniform(-1.0, 1.0) as f32).collect::<Vec<_>>();
        for (n_in, n_out) in [(60, 64), (64, 14), (8, 1)] {
            let layer = Dense::new(&draws(n_in * n_out), &draws(n_out)).unwrap();
            let rows = draws(65 * n_in);
            let mut alone = vec![0.0; 65 * n_out];
            for (x, y) in rows.chunks_exact(n_in).zip(alone.chunks_exact_mut(n_out)) {
                layer.forward(x, y, Activation::Tanh);
            }
            for batch in 1..=65 {
                let mut together = vec![0.0; batch * n_out];
                let first = 65 - batch;
                layer.forward(&rows[first * n_in..], &mut together, Activation::Tanh);
                assert_eq!(together, alone[first * n_out..], "{n_in} to {n_out}, batch {batch}");
            }
        }
    }

    #[test]
    fn a_rectifier_cuts_what_is_negative() {
        let layer = Dense::new(&[1.0, -1.0, 0.0], &[0.5, 0.5, -0.25]).unwrap();
        let mut y = [0.0; 6];
        layer.forward(&[2.0, -2.0], &mut y, Activation::Relu);
        assert_eq!(y, [2.5, 0.0, 0.0, 0.0, 2.5, 0.0]);
    }

    #[test]
    fn ragged_weights_are_refused() {
        let error = Dense::new(&[0.0; 5], &[0.0; 2]).unwrap_err();
        assert_eq!(error, DenseError { n_weights: 5, n_out: 2 });
    }
}
