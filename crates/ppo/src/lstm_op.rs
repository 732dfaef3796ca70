//! A recurrent layer over whole sequences as one node of the engine's graph, forward and back through time.
//!
//! ```text
//! gates from the input [M, 4 H] ─┐
//! W [4 H, H], b [4 H] ───────────┼─► for t in 0..T, all sequences at once: h(t-1) Wᵀ + b + gates(t) ─► h(t), c(t)
//! stored states, resets ─────────┘                                                          h [M, H]
//! ```
//!
//! A sequence starts from the state that its actor stored, and from zero behind an episode's end; no gradient flows
//! through either. The arithmetic is that of an actor's inference, so that the log-probabilities agree bit for bit.

#![expect(
    clippy::inline_always,
    reason = "what a step computes must be compiled inside the dispatched target features"
)]

use std::sync::{Arc, Mutex, PoisonError};

use candle_core::{CpuStorage, CustomOp3, Layout, Result, Shape, Tensor};
use leadtime_numerics::kernel::{Activation, add_outer_products};
use leadtime_numerics::lstm::{self, N_GATES};
use leadtime_numerics::{Panels, tanh_inplace};
use pulp::Arch;

use crate::storage::{floats, with_floats};

/// What a minibatch of sequences starts from.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sequences {
    /// Steps of a sequence, T.
    pub(crate) n_steps: usize,
    /// Hidden and cell state before the first step of each. `[S, 2 H]`
    pub(crate) states: Vec<f32>,
    /// Whether an episode starts at a step, so that the state before it is zero. `[S, T]`
    pub(crate) resets: Vec<bool>,
}

/// What the forward pass leaves for the backward pass; all by time, then by sequence.
#[derive(Debug, Default)]
struct ForwardStates {
    /// Activated gates. `[T, S, 4 H]`
    gates: Vec<f32>,
    /// States before each step, zero where an episode starts. `[T, S, H]`
    hidden_before: Vec<f32>,
    /// `[T, S, H]`
    cell_before: Vec<f32>,
    /// States after each step. `[T, S, H]`
    cell: Vec<f32>,
}

/// The recurrent layer for one minibatch.
#[derive(Clone, Debug)]
pub(crate) struct LstmOp {
    sequences: Arc<Sequences>,
    width: usize,
    states: Arc<Mutex<ForwardStates>>,
}

impl LstmOp {
    pub(crate) fn new(sequences: Arc<Sequences>, width: usize) -> Self {
        Self { sequences, width, states: Arc::default() }
    }

    fn n_sequences(&self) -> usize {
        self.sequences.resets.len() / self.sequences.n_steps
    }

    /// Returns where the numbers of sequence `s` at step `t` lie in a tensor `[M, width]`.
    fn sample(&self, t: usize, s: usize, width: usize) -> std::ops::Range<usize> {
        let row = s * self.sequences.n_steps + t;
        row * width..(row + 1) * width
    }

    fn resets(&self, t: usize, s: usize) -> bool {
        self.sequences.resets[s * self.sequences.n_steps + t]
    }

    /// Returns the hidden and cell states that the sequences start from.
    fn start(&self) -> (Vec<f32>, Vec<f32>) {
        let halves = self.sequences.states.chunks_exact(self.width);
        let (mut hidden, mut cell) = (Vec::new(), Vec::new());
        for (i, half) in halves.enumerate() {
            if i % 2 == 0 { &mut hidden } else { &mut cell }.extend_from_slice(half);
        }
        (hidden, cell)
    }

    /// Runs all sequences; returns h `[M, H]`.
    fn run(&self, from_input: &[f32], weight: &Panels, bias: &[f32]) -> (Vec<f32>, ForwardStates) {
        let (n, width) = (self.n_sequences(), self.width);
        let n_gates = N_GATES * width;
        let mut states = ForwardStates::default();
        let mut out = vec![0.0; n * self.sequences.n_steps * width];
        let (mut hidden, mut cell) = self.start();
        let mut gates = vec![0.0; n * n_gates];
        for t in 0..self.sequences.n_steps {
            for s in (0..n).filter(|&s| self.resets(t, s)) {
                hidden[s * width..(s + 1) * width].fill(0.0);
                cell[s * width..(s + 1) * width].fill(0.0);
            }
            states.hidden_before.extend_from_slice(&hidden);
            states.cell_before.extend_from_slice(&cell);
            weight.multiply(&hidden, bias, Activation::Linear, &mut gates);
            for (s, gates) in gates.chunks_exact_mut(n_gates).enumerate() {
                let from_input = &from_input[self.sample(t, s, n_gates)];
                gates.iter_mut().zip(from_input).for_each(|(gate, x)| *gate += x);
            }
            lstm::step(&mut gates, &mut hidden, &mut cell, width);
            states.gates.extend_from_slice(&gates);
            states.cell.extend_from_slice(&cell);
            for (s, hidden) in hidden.chunks_exact(width).enumerate() {
                out[self.sample(t, s, width)].copy_from_slice(hidden);
            }
        }
        (out, states)
    }

    /// Goes back through time; returns the slopes before the gates' activations, by time: `[T, S, 4 H]`.
    fn back(&self, states: &ForwardStates, d_out: &[f32], weight: &Panels) -> Vec<f32> {
        let (n, width, n_steps) = (self.n_sequences(), self.width, self.sequences.n_steps);
        let (n_gates, n_states) = (N_GATES * width, n * width);
        let mut d_gates = vec![0.0; n_steps * n * n_gates];
        let (mut d_hidden, mut d_cell) = (vec![0.0; n_states], vec![0.0; n_states]);
        let mut squashed = states.cell.clone();
        tanh_inplace(&mut squashed);
        for t in (0..n_steps).rev() {
            Arch::new().dispatch(
                #[inline(always)]
                || {
                    for s in 0..n {
                        let own = s * width..(s + 1) * width;
                        let place = t * n_states + s * width;
                        let step = SequenceStep {
                            gates: &states.gates[(t * n + s) * n_gates..][..n_gates],
                            cell_before: &states.cell_before[place..place + width],
                            squashed: &squashed[place..place + width],
                        };
                        let d_out = &d_out[self.sample(t, s, width)];
                        let d_hidden = &mut d_hidden[own.clone()];
                        d_hidden.iter_mut().zip(d_out).for_each(|(sum, d)| *sum += d);
                        let d_gates = &mut d_gates[(t * n + s) * n_gates..][..n_gates];
                        step.back(d_hidden, &mut d_cell[own], d_gates);
                    }
                },
            );
            let d_now = &d_gates[t * n * n_gates..][..n * n_gates];
            weight.multiply(d_now, &[], Activation::Linear, &mut d_hidden);
            for s in (0..n).filter(|&s| self.resets(t, s)) {
                d_hidden[s * width..(s + 1) * width].fill(0.0);
                d_cell[s * width..(s + 1) * width].fill(0.0);
            }
        }
        d_gates
    }
}

/// One sequence at one step, in the backward pass.
struct SequenceStep<'a> {
    gates: &'a [f32],
    cell_before: &'a [f32],
    /// tanh of the cell state after the step.
    squashed: &'a [f32],
}

impl SequenceStep<'_> {
    /// From slopes in h and c after the step: those before the gates' activations, and the one in c before the step.
    #[inline(always)]
    fn back(&self, d_hidden: &[f32], d_cell: &mut [f32], d_gates: &mut [f32]) {
        let n = d_hidden.len();
        // Slices of one length, so that the loop has no bounds to check.
        let [input, forget, candidate, output] =
            [0, 1, 2, 3].map(|gate| &self.gates[gate * n..][..n]);
        let (cell_before, squashed) = (&self.cell_before[..n], &self.squashed[..n]);
        let (d_input, d_rest) = d_gates.split_at_mut(n);
        let (d_forget, d_rest) = d_rest.split_at_mut(n);
        let (d_candidate, d_output) = d_rest.split_at_mut(n);
        let (d_output, d_cell) = (&mut d_output[..n], &mut d_cell[..n]);
        for i in 0..n {
            let d = d_cell[i] + d_hidden[i] * output[i] * (1.0 - squashed[i] * squashed[i]);
            d_input[i] = d * candidate[i] * input[i] * (1.0 - input[i]);
            d_forget[i] = d * cell_before[i] * forget[i] * (1.0 - forget[i]);
            d_candidate[i] = d * input[i] * (1.0 - candidate[i] * candidate[i]);
            d_output[i] = d_hidden[i] * squashed[i] * output[i] * (1.0 - output[i]);
            d_cell[i] = d * forget[i];
        }
    }
}

impl CustomOp3 for LstmOp {
    fn name(&self) -> &'static str {
        "lstm"
    }

    fn cpu_fwd(
        &self,
        from_input: &CpuStorage,
        from_input_layout: &Layout,
        weight: &CpuStorage,
        weight_layout: &Layout,
        bias: &CpuStorage,
        bias_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let (n_samples, n_gates) = from_input_layout.shape().dims2()?;
        let width = self.width;
        let states_fit = self.sequences.states.len() == 2 * width * self.n_sequences();
        if n_gates != N_GATES * width || self.sequences.resets.len() != n_samples || !states_fit {
            candle_core::bail!(
                "lstm: {n_samples} samples of {n_gates} gates do not fit {width} units"
            )
        }
        let weight = Panels::from_columns(floats(weight, weight_layout)?, n_gates, width);
        let bias = floats(bias, bias_layout)?;
        let (out, states) = self.run(floats(from_input, from_input_layout)?, &weight, bias);
        *self.states.lock().unwrap_or_else(PoisonError::into_inner) = states;
        Ok((CpuStorage::F32(out), Shape::from((n_samples, width))))
    }

    fn bwd(
        &self,
        from_input: &Tensor,
        weight: &Tensor,
        _bias: &Tensor,
        _out: &Tensor,
        d_out: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let (n_gates, width, device) = (N_GATES * self.width, self.width, weight.device());
        let states = self.states.lock().unwrap_or_else(PoisonError::into_inner);
        let panels = with_floats(weight, |weight| Panels::from_rows(weight, n_gates, width))?;
        let d_gates = with_floats(d_out, |d_out| self.back(&states, d_out, &panels))?;
        let mut d_weight = vec![0.0; n_gates * width];
        add_outer_products(&d_gates, &states.hidden_before, n_gates, width, &mut d_weight);
        let mut d_bias = vec![0.0; n_gates];
        let mut d_input = vec![0.0; d_gates.len()];
        for (i, row) in d_gates.chunks_exact(n_gates).enumerate() {
            d_bias.iter_mut().zip(row).for_each(|(sum, d)| *sum += d);
            let (t, s) = (i / self.n_sequences(), i % self.n_sequences());
            d_input[self.sample(t, s, n_gates)].copy_from_slice(row);
        }
        Ok((
            Some(Tensor::from_vec(d_input, from_input.shape(), device)?),
            Some(Tensor::from_vec(d_weight, (n_gates, width), device)?),
            Some(Tensor::from_vec(d_bias, n_gates, device)?),
        ))
    }
}

#[cfg(test)]
mod tests {
    use candle_core::{Device, Var};

    use super::*;
    use crate::test_support::{draw, same_function};

    const WIDTH: usize = 5;
    const STEPS: usize = 4;

    fn weight_and_bias() -> (Var, Var) {
        (draw((4 * WIDTH, WIDTH), 2), draw(4 * WIDTH, 3))
    }

    /// Three sequences; the second starts with an episode, the third has one starting at its third step.
    fn sequences() -> Sequences {
        let mut resets = vec![false; 3 * STEPS];
        resets[STEPS] = true;
        resets[2 * STEPS + 2] = true;
        let states = draw(3 * 2 * WIDTH, 7).to_vec1().unwrap();
        Sequences { n_steps: STEPS, states, resets }
    }

    /// The layer spelled out in the engine's own operations. Returns h `[M, H]`.
    fn plain(from_input: &Tensor, weight: &Tensor, bias: &Tensor) -> Tensor {
        let all = sequences();
        let sigmoid =
            |x: Tensor| ((x.neg().unwrap().exp().unwrap() + 1.0).unwrap()).recip().unwrap();
        let mut rows = Vec::new();
        for s in 0..3 {
            let state = |half: usize| {
                let values = &all.states[(2 * s + half) * WIDTH..][..WIDTH];
                Tensor::from_slice(values, (1, WIDTH), &Device::Cpu).unwrap()
            };
            let (mut hidden, mut cell) = (state(0), state(1));
            for t in 0..STEPS {
                if all.resets[s * STEPS + t] {
                    hidden = hidden.zeros_like().unwrap();
                    cell = cell.zeros_like().unwrap();
                }
                let product = hidden.matmul(&weight.t().unwrap()).unwrap();
                let row = from_input.narrow(0, s * STEPS + t, 1).unwrap();
                let gates = (product.broadcast_add(bias).unwrap() + row).unwrap();
                let gate = |i: usize| gates.narrow(1, i * WIDTH, WIDTH).unwrap();
                let kept = (sigmoid(gate(1)) * cell).unwrap();
                cell = (kept + (sigmoid(gate(0)) * gate(2).tanh().unwrap()).unwrap()).unwrap();
                hidden = (sigmoid(gate(3)) * cell.tanh().unwrap()).unwrap();
                rows.push(hidden.clone());
            }
        }
        Tensor::cat(&rows, 0).unwrap()
    }

    #[test]
    fn sequences_and_their_gradients_are_the_engines_own() {
        let from_input = draw((3 * STEPS, 4 * WIDTH), 1);
        let (weight, bias) = weight_and_bias();
        let op = LstmOp::new(Arc::new(sequences()), WIDTH);
        let fused = from_input.apply_op3(&weight, &bias, op).unwrap();
        let plain = plain(&from_input, &weight, &bias);
        same_function(&fused, &plain, [&from_input, &weight, &bias], 1e-5);
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let from_input = draw((3, 4 * WIDTH), 1);
        let (weight, bias) = weight_and_bias();
        let op = LstmOp::new(Arc::new(sequences()), WIDTH);
        let error = from_input.apply_op3(&weight, &bias, op).unwrap_err().to_string();
        assert!(error.contains("3 samples of 20 gates do not fit 5 units"), "{error}");
    }
}
