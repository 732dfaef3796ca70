//! The pointwise half of an LSTM step: gates and states, given the products of weights and inputs.
//!
//! ```text
//! i, f, o = sigmoid of their pre-activations      c' = f c + i g
//! g       = tanh of its pre-activation            h' = o tanh(c')
//! ```
//!
//! The matrix products are [`crate::dense`]'s. Rows are independent: a row's bits do not depend on its batch.
//!
//! # Source
//!
//! Hochreiter and Schmidhuber, *Long short-term memory*, 1997, with the forget gate of Gers et al., 2000; gates in
//! `PyTorch`'s order.

#![expect(
    clippy::inline_always,
    reason = "kernels must be compiled inside the dispatched target features"
)]

use pulp::{Arch, Simd, WithSimd};

use crate::elementary::tanh_vector;

/// Gates per unit: input, forget, cell, output.
pub const N_GATES: usize = 4;

/// Moves hidden and cell states on by a step.
///
/// # Shapes
///
/// `gates`: `[N, 4 H]`, pre-activations of input, forget, cell and output gate, replaced by the activated gates;
/// `hidden`: `[N, H]`, written; `cell`: `[N, H]`, replaced by the new cell states.
///
/// # Panics
///
/// If the shapes do not hold.
///
/// # Example
///
/// ```
/// let (mut gates, mut hidden, mut cell) = ([0.0; 4], [0.0], [2.0]);
/// leadtime_numerics::lstm::step(&mut gates, &mut hidden, &mut cell, 1);
/// assert_eq!((gates, cell), ([0.5, 0.5, 0.0, 0.5], [1.0]));
/// assert!((hidden[0] - 0.5 * 1.0_f32.tanh()).abs() < 1e-6);
/// ```
pub fn step(gates: &mut [f32], hidden: &mut [f32], cell: &mut [f32], width: usize) {
    assert_eq!(gates.len(), N_GATES * cell.len(), "`gates` must be [N, 4 H]");
    assert_eq!(hidden.len(), cell.len(), "`hidden` and `cell` must be [N, H]");
    let gates = gates.chunks_exact_mut(N_GATES * width);
    let rows = gates.zip(hidden.chunks_exact_mut(width)).zip(cell.chunks_exact_mut(width));
    Arch::new().dispatch(LstmSteps { rows, width });
}

/// The rows of a step: gates, hidden and cell states of each.
struct LstmSteps<R> {
    rows: R,
    width: usize,
}

impl<'a, R> WithSimd for LstmSteps<R>
where
    R: Iterator<Item = ((&'a mut [f32], &'a mut [f32]), &'a mut [f32])>,
{
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let width = self.width;
        for ((gates, hidden), cell) in self.rows {
            let (input, rest) = gates.split_at_mut(width);
            let (forget, rest) = rest.split_at_mut(width);
            let (candidate, output) = rest.split_at_mut(width);
            for first in (0..width).step_by(S::F32_LANES) {
                let own = first..width.min(first + S::F32_LANES);
                let gates = [
                    &mut input[own.clone()],
                    &mut forget[own.clone()],
                    &mut candidate[own.clone()],
                ];
                let states = [&mut output[own.clone()], &mut hidden[own.clone()], &mut cell[own]];
                units_step(simd, gates, states);
            }
        }
    }
}

/// Steps at most one vector of units: input, forget and candidate gates; output gates, hidden and cell states.
#[inline(always)]
fn units_step<S: Simd>(simd: S, gates: [&mut [f32]; 3], states: [&mut [f32]; 3]) {
    let [input, forget, candidate] = gates;
    let [output, hidden, cell] = states;
    let i = sigmoid(simd, simd.partial_load_f32s(input));
    let f = sigmoid(simd, simd.partial_load_f32s(forget));
    let g = tanh_vector(simd, simd.partial_load_f32s(candidate));
    let o = sigmoid(simd, simd.partial_load_f32s(output));
    let kept = simd.mul_f32s(f, simd.partial_load_f32s(cell));
    let c = simd.add_f32s(kept, simd.mul_f32s(i, g));
    simd.partial_store_f32s(input, i);
    simd.partial_store_f32s(forget, f);
    simd.partial_store_f32s(candidate, g);
    simd.partial_store_f32s(output, o);
    simd.partial_store_f32s(cell, c);
    simd.partial_store_f32s(hidden, simd.mul_f32s(tanh_vector(simd, c), o));
}

/// `sigmoid(x) = (1 + tanh(x / 2)) / 2`
#[inline(always)]
fn sigmoid<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    let half = simd.splat_f32s(0.5);
    let tanh = tanh_vector(simd, simd.mul_f32s(x, half));
    simd.add_f32s(simd.mul_f32s(half, tanh), half)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sigmoid(x: f32) -> f32 {
        1.0 / (1.0 + (-x).exp())
    }

    #[test]
    fn a_step_is_the_textbooks() {
        let width = 3;
        let before: Vec<f32> = (0..24).map(|i| (i as f32 * 0.7).sin() * 3.0).collect();
        let old_cell: Vec<f32> = (0..6).map(|i| (i as f32).cos()).collect();
        let (mut gates, mut cell, mut hidden) = (before.clone(), old_cell.clone(), vec![0.0; 6]);
        step(&mut gates, &mut hidden, &mut cell, width);
        for row in 0..2 {
            for i in 0..width {
                let x = |gate: usize| before[row * 12 + gate * width + i];
                let c = sigmoid(x(1)) * old_cell[row * width + i] + sigmoid(x(0)) * x(2).tanh();
                let h = sigmoid(x(3)) * c.tanh();
                assert!((cell[row * width + i] - c).abs() < 1e-6, "{row} {i}");
                assert!((hidden[row * width + i] - h).abs() < 1e-6, "{row} {i}");
            }
        }
        let (mut alone, mut alone_hidden) = (before[12..].to_vec(), vec![0.0; 3]);
        step(&mut alone, &mut alone_hidden, &mut old_cell[3..].to_vec(), width);
        assert_eq!(alone_hidden, hidden[3..], "a row's bits depend on its batch");
    }
}
