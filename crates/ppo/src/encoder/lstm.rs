//! A recurrent encoder over whole sequences, forward and back through time.
//!
//! ```text
//! observations ─► projection ─► gates from the input [M, 4 H] ─┐
//! W [4 H, H], b [4 H] ─────────────────────────────────────────┼─► for t in 0..T, all sequences at once:
//! stored states, resets ───────────────────────────────────────┘   h(t-1) Wᵀ + b + gates(t) ─► h(t), c(t)     h [M, H]
//! ```
//!
//! A sequence starts from the state that its actor stored, and from zero behind an episode's end; no gradient flows
//! through either. The arithmetic is that of an actor's inference, so that the log-probabilities agree bit for bit.

#![expect(
    clippy::inline_always,
    reason = "what a step computes must be compiled inside the dispatched target features"
)]

use std::collections::BTreeMap;

use candle_core::{Result, Var};
use leadtime_numerics::kernel::{Activation, add_outer_products};
use leadtime_numerics::lstm::{self, N_GATES};
use leadtime_numerics::tanh_inplace;
use leadtime_policy::architecture::LstmLayers;
use pulp::Arch;

use crate::dense::{Gradients, PackedLayer, resize, row_sums};

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

/// The encoder, and the memory of its pass. What is by time is by time first, then by sequence; what is by sample, by
/// sequence first.
#[derive(Debug)]
pub(crate) struct LstmPass {
    /// Number of units, H.
    width: usize,
    projection: Option<PackedLayer>,
    input: PackedLayer,
    state: PackedLayer,
    sequences: Sequences,
    observations: Vec<f32>,
    /// By sample. `[M, P]`, or empty
    projected: Vec<f32>,
    /// By sample; their slopes in the backward pass. `[M, 4 H]`
    from_input: Vec<f32>,
    /// Activated gates, by time. `[M, 4 H]`
    gates: Vec<f32>,
    /// States before each step, zero where an episode starts, by time. `[M, H]`
    hidden_before: Vec<f32>,
    cell_before: Vec<f32>,
    /// States after each step, by time. `[M, H]`
    cell: Vec<f32>,
    /// Hidden states, by sample. `[M, H]`
    out: Vec<f32>,
    /// Slopes before the gates' activations, by time. `[M, 4 H]`
    d_gates: Vec<f32>,
    /// By sample. `[M, P]`, or empty
    d_projected: Vec<f32>,
    /// The tanh of `cell`.
    squashed: Vec<f32>,
}

impl LstmPass {
    pub(super) fn new(layers: LstmLayers) -> Self {
        let LstmLayers { projection, input, state } = layers;
        Self {
            width: state.n_in,
            projection: projection.map(PackedLayer::new),
            input: PackedLayer::new(input),
            state: PackedLayer::new(state),
            sequences: Sequences::default(),
            observations: Vec::new(),
            projected: Vec::new(),
            from_input: Vec::new(),
            gates: Vec::new(),
            hidden_before: Vec::new(),
            cell_before: Vec::new(),
            cell: Vec::new(),
            out: Vec::new(),
            d_gates: Vec::new(),
            d_projected: Vec::new(),
            squashed: Vec::new(),
        }
    }

    pub(super) fn pack(&mut self, vars: &BTreeMap<String, Var>) -> Result<()> {
        let layers = self.projection.iter_mut().chain([&mut self.input, &mut self.state]);
        layers.into_iter().try_for_each(|layer| layer.pack(vars))
    }

    /// Encodes samples `[M, D]`, whole sequences one behind the other; returns h `[M, H]`.
    pub(super) fn forward(&mut self, observations: Vec<f32>, sequences: Sequences) -> &[f32] {
        self.observations = observations;
        self.sequences = sequences;
        let input = match &self.projection {
            None => &self.observations,
            Some(projection) => {
                projection.forward(&self.observations, &mut self.projected);
                &self.projected
            }
        };
        self.input.forward(input, &mut self.from_input);
        self.run();
        &self.out
    }

    fn n_sequences(&self) -> usize {
        self.sequences.resets.len() / self.sequences.n_steps
    }

    /// Runs all sequences through time.
    fn run(&mut self) {
        let (n, width, n_steps) = (self.n_sequences(), self.width, self.sequences.n_steps);
        let (n_gates, n_states) = (N_GATES * width, n * width);
        let n_samples = n * n_steps;
        resize(&mut self.gates, n_samples * n_gates);
        for states in
            [&mut self.hidden_before, &mut self.cell_before, &mut self.cell, &mut self.out]
        {
            resize(states, n_samples * width);
        }
        let (mut hidden, mut cell) = start(&self.sequences.states, width);
        for t in 0..n_steps {
            for s in (0..n).filter(|s| self.sequences.resets[s * n_steps + t]) {
                hidden[s * width..(s + 1) * width].fill(0.0);
                cell[s * width..(s + 1) * width].fill(0.0);
            }
            let now = t * n_states..(t + 1) * n_states;
            self.hidden_before[now.clone()].copy_from_slice(&hidden);
            self.cell_before[now.clone()].copy_from_slice(&cell);
            let gates = &mut self.gates[t * n * n_gates..][..n * n_gates];
            let PackedLayer { matrix, bias, .. } = &self.state;
            matrix.forward.multiply(&hidden, bias, Activation::Linear, gates);
            for (s, gates) in gates.chunks_exact_mut(n_gates).enumerate() {
                let from_input = &self.from_input[(s * n_steps + t) * n_gates..][..n_gates];
                gates.iter_mut().zip(from_input).for_each(|(gate, x)| *gate += x);
            }
            lstm::step(gates, &mut hidden, &mut cell, width);
            self.cell[now].copy_from_slice(&cell);
            for (s, hidden) in hidden.chunks_exact(width).enumerate() {
                self.out[(s * n_steps + t) * width..][..width].copy_from_slice(hidden);
            }
        }
    }

    /// Computes the gradients of the last forward pass from the slopes in its result, `[M, H]`.
    pub(super) fn backward(&mut self, d_out: &[f32]) -> Gradients {
        self.back_through_time(d_out);
        let (n_gates, width) = (N_GATES * self.width, self.width);
        let (n, n_steps) = (self.n_sequences(), self.sequences.n_steps);
        let mut gradients = Gradients::new();
        let mut d_weight = vec![0.0; n_gates * width];
        add_outer_products(&self.d_gates, &self.hidden_before, n_gates, width, &mut d_weight);
        gradients.insert(self.state.layer.weight(), d_weight);
        gradients.insert(self.state.layer.bias(), row_sums(&self.d_gates, n_gates));
        let d_input = &mut self.from_input;
        for (i, row) in self.d_gates.chunks_exact(n_gates).enumerate() {
            let (t, s) = (i / n, i % n);
            d_input[(s * n_steps + t) * n_gates..][..n_gates].copy_from_slice(row);
        }
        // The gates' own layer is linear, so its outputs are not asked for.
        match &self.projection {
            None => self.input.backward(&self.observations, &[], d_input, &mut gradients),
            Some(projection) => {
                self.input.backward(&self.projected, &[], d_input, &mut gradients);
                self.input.d_input(d_input, &mut self.d_projected);
                let d_projected = &mut self.d_projected;
                projection.backward(
                    &self.observations,
                    &self.projected,
                    d_projected,
                    &mut gradients,
                );
            }
        }
        gradients
    }

    /// Goes back through time, to the slopes before the gates' activations.
    fn back_through_time(&mut self, d_out: &[f32]) {
        let (n, width, n_steps) = (self.n_sequences(), self.width, self.sequences.n_steps);
        let (n_gates, n_states) = (N_GATES * width, n * width);
        resize(&mut self.d_gates, n_steps * n * n_gates);
        let (mut d_hidden, mut d_cell) = (vec![0.0; n_states], vec![0.0; n_states]);
        self.squashed.clone_from(&self.cell);
        tanh_inplace(&mut self.squashed);
        for t in (0..n_steps).rev() {
            let d_now = &mut self.d_gates[t * n * n_gates..][..n * n_gates];
            Arch::new().dispatch(
                #[inline(always)]
                || {
                    for s in 0..n {
                        let own = s * width..(s + 1) * width;
                        let place = t * n_states + s * width;
                        let step = SequenceStep {
                            gates: &self.gates[(t * n + s) * n_gates..][..n_gates],
                            cell_before: &self.cell_before[place..place + width],
                            squashed: &self.squashed[place..place + width],
                        };
                        let d_out = &d_out[(s * n_steps + t) * width..][..width];
                        let d_hidden = &mut d_hidden[own.clone()];
                        d_hidden.iter_mut().zip(d_out).for_each(|(sum, d)| *sum += d);
                        let d_gates = &mut d_now[s * n_gates..][..n_gates];
                        step.back(d_hidden, &mut d_cell[own], d_gates);
                    }
                },
            );
            let weight = &self.state.matrix.backward;
            weight.multiply(d_now, &[], Activation::Linear, &mut d_hidden);
            for s in (0..n).filter(|s| self.sequences.resets[s * n_steps + t]) {
                d_hidden[s * width..(s + 1) * width].fill(0.0);
                d_cell[s * width..(s + 1) * width].fill(0.0);
            }
        }
    }
}

/// Returns the hidden and cell states that sequences start from, of `[S, 2 H]`.
fn start(states: &[f32], width: usize) -> (Vec<f32>, Vec<f32>) {
    let (mut hidden, mut cell) = (Vec::new(), Vec::new());
    for (i, half) in states.chunks_exact(width).enumerate() {
        if i % 2 == 0 { &mut hidden } else { &mut cell }.extend_from_slice(half);
    }
    (hidden, cell)
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

#[cfg(test)]
mod tests {
    use candle_core::{Device, Tensor};

    use super::*;
    use crate::test_support::{Plain, close, draw, flat};

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
        let layers = LstmLayers::new(3, 0, WIDTH);
        let (observations, input) = (draw((3 * STEPS, 3), 1), draw((4 * WIDTH, 3), 5));
        let input_bias = draw(4 * WIDTH, 6);
        let (weight, bias) = weight_and_bias();
        let product = observations.matmul(&input.t().unwrap()).unwrap();
        let from_input = product.broadcast_add(&input_bias).unwrap();
        let plain = plain(&from_input, &weight, &bias);
        let plain = Plain::of(&plain, &[&input, &input_bias, &weight, &bias]);
        let names = [
            layers.input.weight(),
            layers.input.bias(),
            layers.state.weight(),
            layers.state.bias(),
        ];
        let vars = names.iter().cloned().zip([input, input_bias, weight, bias]).collect();
        let mut pass = LstmPass::new(layers);
        pass.pack(&vars).unwrap();
        // Twice, so that what is left from the first pass would show.
        for _ in 0..2 {
            close(pass.forward(flat(&observations), sequences()), &plain.values, 1e-5);
            let gradients = pass.backward(&plain.target);
            for (name, expected) in names.iter().zip(&plain.gradients) {
                close(&gradients[name], expected, 1e-5);
            }
        }
    }
}
