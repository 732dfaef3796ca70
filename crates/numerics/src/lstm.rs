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

use crate::elementary::tanh_inplace;

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
    for gates in gates.chunks_exact_mut(N_GATES * width) {
        activate(gates, width);
    }
    let rows = gates.chunks_exact(N_GATES * width).zip(cell.chunks_exact_mut(width));
    for ((gates, cell), hidden) in rows.zip(hidden.chunks_exact_mut(width)) {
        let (input, forget) = (&gates[..width], &gates[width..2 * width]);
        let candidate = &gates[2 * width..3 * width];
        for i in 0..width {
            cell[i] = forget[i] * cell[i] + input[i] * candidate[i];
        }
        hidden.copy_from_slice(cell);
    }
    tanh_inplace(hidden);
    let rows = gates.chunks_exact(N_GATES * width).zip(hidden.chunks_exact_mut(width));
    for (gates, hidden) in rows {
        hidden.iter_mut().zip(&gates[3 * width..]).for_each(|(h, output)| *h *= output);
    }
}

/// Applies the gates' nonlinearities to one row; `sigmoid(x) = (1 + tanh(x / 2)) / 2`.
fn activate(gates: &mut [f32], width: usize) {
    let is_sigmoid = |i: usize| i / width != 2;
    for (i, gate) in gates.iter_mut().enumerate() {
        *gate *= if is_sigmoid(i) { 0.5 } else { 1.0 };
    }
    tanh_inplace(gates);
    for part in [0..2 * width, 3 * width..4 * width] {
        gates[part].iter_mut().for_each(|gate| *gate = 0.5 * *gate + 0.5);
    }
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
