//! A recurrent encoder over whole sequences, forward and back through time.
//!
//! ```text
//! observations ─► projection ─► gates from the input [n, 4 H] ─┐
//! W [4 H, H], b [4 H] ─────────────────────────────────────────┼─► for t in 0..T, some sequences at once:
//! stored states, resets ───────────────────────────────────────┘   h(t-1) Wᵀ + b + gates(t) ─► h(t), c(t)     h [M, H]
//! ```
//!
//! A sequence starts from the state that its actor stored, and from zero behind an episode's end; no gradient flows
//! through either. The arithmetic is that of an actor's inference, so that the log-probabilities agree bit for bit.
//!
//! Sequences do not depend on each other: threads share them out in groups. Gradients are sums over all of them, in an
//! order that no group changes: of the recurrent layer by time and then by sequence, of the others by sequence and then
//! by time.

use std::collections::BTreeMap;

use candle_core::{Result, Var};
use leadtime_numerics::Panels;
use leadtime_numerics::kernel::{Activation, RowPairs};
use leadtime_numerics::lstm::{self, BackwardRow, ForwardRow, N_GATES};
use leadtime_policy::architecture::LstmLayers;

use crate::dense::{Gradients, PackedLayer, resize};
use crate::encoder::EncoderInput;
use crate::outer::{LayerSum, add_up};
use crate::team::Team;

/// Sequences that go through time together, at most: what they leave behind in a step stays in the second-level cache.
const GROUP: usize = 16;

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

/// The encoder, and the memory of its pass.
#[derive(Debug)]
pub(crate) struct LstmPass {
    weights: LstmWeights,
    /// Those in use first.
    groups: Vec<SequenceGroup>,
    n_groups: usize,
    sequences: Sequences,
    /// Hidden states, by sequence and then by time. `[M, H]`
    out: Vec<f32>,
}

#[derive(Debug)]
struct LstmWeights {
    /// Number of units, H.
    width: usize,
    projection: Option<PackedLayer>,
    input: PackedLayer,
    state: PackedLayer,
}

/// Some sequences, n of them, and the memory of their pass.
#[derive(Debug, Default)]
struct SequenceGroup {
    n: usize,
    /// At least as many as steps.
    steps: Vec<LstmStepMemory>,
    /// Cell states before the first step. `[n, H]`
    start: Vec<f32>,
    /// What cell states are where an episode starts. `[H]`
    zeros: Vec<f32>,
    from_input: Vec<f32>,
    d_gates: Vec<f32>,
    d_hidden: Vec<f32>,
    d_cell: Vec<f32>,
}

/// What one step of a group leaves behind.
#[derive(Debug, Default)]
struct LstmStepMemory {
    /// What the step saw. `[n, D]`
    observations: Panels,
    /// `[n, P]`, or empty
    projected: Panels,
    /// Hidden states before the step, zero where an episode starts. `[n, H]`
    hidden_before: Panels,
    /// Activated gates. `[n, 4 H]`
    gates: Vec<f32>,
    /// Cell states after the step, and their tanh. `[n, H]`
    cell: Vec<f32>,
    squashed: Vec<f32>,
    /// Slopes before the gates' activations. `[n, 4 H]`
    d_gates: Panels,
    /// Slopes before the projection's activation. `[n, P]`, or empty
    d_projected: Panels,
}

/// A group's part of a minibatch.
struct GroupTask<'a> {
    group: &'a mut SequenceGroup,
    /// The sample of every step. `[n, T]`
    samples: &'a [usize],
    /// Hidden and cell states before the first step. `[n, 2 H]`
    states: &'a [f32],
    /// Whether an episode begins with a step. `[n, T]`
    resets: &'a [bool],
    /// Hidden states after every step. `[n, T, H]`
    out: &'a mut [f32],
}

impl LstmPass {
    pub(super) fn new(layers: LstmLayers) -> Self {
        let LstmLayers { projection, input, state } = layers;
        let weights = LstmWeights {
            width: state.n_in,
            projection: projection.map(PackedLayer::new),
            input: PackedLayer::new(input),
            state: PackedLayer::new(state),
        };
        let sequences = Sequences::default();
        Self { weights, groups: Vec::new(), n_groups: 0, sequences, out: Vec::new() }
    }

    pub(super) fn pack(&mut self, vars: &BTreeMap<String, Var>) -> Result<()> {
        let LstmWeights { projection, input, state, .. } = &mut self.weights;
        projection.iter_mut().chain([input, state]).try_for_each(|layer| layer.pack(vars))
    }

    /// Encodes samples, whole sequences one behind the other; returns h `[M, H]`.
    pub(super) fn forward(
        &mut self,
        input: EncoderInput<'_>,
        sequences: Sequences,
        team: &Team,
    ) -> &[f32] {
        self.sequences = sequences;
        let (weights, Sequences { n_steps, states, resets }) = (&self.weights, &self.sequences);
        let (width, n_steps) = (weights.width, *n_steps);
        let n_sequences = resets.len() / n_steps;
        // As many groups as threads if there are enough sequences, all as long as they can be.
        let n_groups = n_sequences.div_ceil(GROUP).max(team.n_threads().min(n_sequences));
        let group_len = n_sequences.div_ceil(n_groups.max(1)).max(1);
        self.n_groups = n_sequences.div_ceil(group_len);
        let n_memories = self.groups.len().max(self.n_groups);
        self.groups.resize_with(n_memories, SequenceGroup::default);
        let out = resize(&mut self.out, resets.len() * width);
        let tasks =
            input.samples.chunks(group_len * n_steps).zip(resets.chunks(group_len * n_steps));
        let tasks = tasks.zip(states.chunks(group_len * 2 * width));
        let tasks = tasks.zip(out.chunks_mut(group_len * n_steps * width)).zip(&mut self.groups);
        let tasks: Vec<_> = tasks
            .map(|((((samples, resets), states), out), group)| GroupTask {
                group,
                samples,
                states,
                resets,
                out,
            })
            .collect();
        team.for_each(tasks.into_iter(), |task| task.forward(weights, input));
        &self.out
    }

    /// Computes the gradients of the last forward pass from the slopes in its result, `[M, H]`.
    pub(super) fn backward(&mut self, d_out: &[f32], gradients: &mut Gradients, team: &Team) {
        let (weights, n_steps) = (&self.weights, self.sequences.n_steps);
        let groups = &mut self.groups[..self.n_groups];
        let group_len = groups.first().map_or(1, |group| group.n);
        let slopes = d_out.chunks(group_len * n_steps * weights.width);
        let resets = self.sequences.resets.chunks(group_len * n_steps);
        let tasks: Vec<_> = groups.iter_mut().zip(slopes.zip(resets)).collect();
        team.for_each(tasks.into_iter(), |(group, (d_out, resets))| {
            group.backward(weights, d_out, resets);
        });
        let (groups, LstmWeights { projection, input, state, .. }) = (&*groups, weights);
        let rows = by_time(groups, n_steps);
        let mut sums = vec![LayerSum::new(&state.layer, rows, gradients)];
        let has_projection = projection.is_some();
        let rows = by_sequence(groups, n_steps, |step| (&step.d_gates, step.input(has_projection)));
        sums.push(LayerSum::new(&input.layer, rows, gradients));
        if let Some(projection) = projection {
            let rows = by_sequence(groups, n_steps, |step| (&step.d_projected, &step.observations));
            sums.push(LayerSum::new(&projection.layer, rows, gradients));
        }
        add_up(&mut sums, team);
        for sum in sums {
            sum.put_into(gradients);
        }
    }
}

impl LstmStepMemory {
    /// Returns what the gates' own layer sees.
    fn input(&self, has_projection: bool) -> &Panels {
        if has_projection { &self.projected } else { &self.observations }
    }

    /// Makes room for n sequences, and takes their observations in.
    fn begin(
        &mut self,
        width: usize,
        input: EncoderInput<'_>,
        samples: impl ExactSizeIterator<Item = usize>,
    ) {
        let n = samples.len();
        self.observations.resize(n, input.obs_dim);
        for (s, sample) in samples.enumerate() {
            self.observations.set_row(s, input.row(sample));
        }
        self.hidden_before.resize(n, width);
        self.d_gates.resize(n, N_GATES * width);
        resize(&mut self.gates, n * N_GATES * width);
        resize(&mut self.cell, n * width);
        resize(&mut self.squashed, n * width);
    }
}

impl GroupTask<'_> {
    /// Runs the sequences through time.
    fn forward(self, weights: &LstmWeights, input: EncoderInput<'_>) {
        let Self { group, samples, states, resets, out } = self;
        let (width, n) = (weights.width, states.len() / (2 * weights.width));
        let (n_steps, n_gates) = (resets.len() / n, N_GATES * width);
        group.begin(n, n_steps, weights);
        group.load(weights, input, samples, n_steps);
        let SequenceGroup { steps, start, zeros, from_input, .. } = group;
        start.clear();
        start.extend(states.chunks_exact(2 * width).flat_map(|state| &state[width..]));
        for (s, state) in states.chunks_exact(2 * width).enumerate() {
            let hidden = if resets[s * n_steps] { zeros.as_slice() } else { &state[..width] };
            steps[0].hidden_before.set_row(s, hidden);
        }
        for t in 0..n_steps {
            let (before, rest) = steps.split_at_mut(t);
            let Some((now, later)) = rest.split_first_mut() else { break };
            let cell_before = before.last().map_or(&*start, |step| &step.cell);
            weights.gates(now, from_input);
            let rows = now.gates.chunks_exact_mut(n_gates).zip(from_input.chunks_exact(n_gates));
            let after = now.cell.chunks_exact_mut(width).zip(now.squashed.chunks_exact_mut(width));
            let hidden = out.chunks_exact_mut(n_steps * width);
            let rows = rows.zip(after).zip(hidden).zip(cell_before.chunks_exact(width));
            lstm::forward(rows.enumerate().map(
                |(s, ((((gates, from_input), (cell, squashed)), hidden), cell_before))| {
                    let is_reset = resets[s * n_steps + t];
                    let cell_before = if is_reset { zeros.as_slice() } else { cell_before };
                    let hidden = &mut hidden[t * width..][..width];
                    ForwardRow { gates, from_input, cell_before, cell, squashed, hidden }
                },
            ));
            let Some(next) = later.first_mut().filter(|_| t + 1 < n_steps) else { break };
            for (s, hidden) in out.chunks_exact(n_steps * width).enumerate() {
                let is_reset = resets[s * n_steps + t + 1];
                let hidden =
                    if is_reset { zeros.as_slice() } else { &hidden[t * width..][..width] };
                next.hidden_before.set_row(s, hidden);
            }
        }
    }
}

impl LstmWeights {
    /// Computes the two parts of the gates' pre-activations of a step: from the states, and from the inputs.
    fn gates(&self, now: &mut LstmStepMemory, from_input: &mut Vec<f32>) {
        if let Some(projection) = &self.projection {
            let (matrix, activation) = (&projection.matrix.forward, projection.layer.activation);
            let (observations, projected) = (&now.observations, &mut now.projected);
            matrix.multiply_panels(observations, &projection.bias, activation, projected);
        }
        let from_input = resize(from_input, now.gates.len());
        let (input, state) = (&self.input, &self.state);
        let seen = now.input(self.projection.is_some());
        input.matrix.forward.multiply_to_rows(seen, &input.bias, from_input);
        let (hidden, gates) = (&now.hidden_before, &mut now.gates);
        state.matrix.forward.multiply_to_rows(hidden, &state.bias, gates);
    }

    /// Goes back through the step's products: to the states before it, and to the projection.
    fn back(&self, now: &mut LstmStepMemory, d_hidden: &mut [f32]) {
        let state = &self.state.matrix.backward;
        state.multiply_to_rows(&now.d_gates, &[], d_hidden);
        if let Some(projection) = &self.projection {
            let (d_gates, d_projected) = (&now.d_gates, &mut now.d_projected);
            let input = &self.input.matrix.backward;
            input.multiply_panels(d_gates, &[], Activation::Linear, d_projected);
            let outputs = now.projected.data().as_flattened();
            let slopes = d_projected.data_mut().as_flattened_mut();
            projection.layer.activation.backward(outputs, slopes);
        }
    }
}

impl SequenceGroup {
    /// Makes room for a pass.
    fn begin(&mut self, n: usize, n_steps: usize, weights: &LstmWeights) {
        self.n = n;
        let n_memories = self.steps.len().max(n_steps);
        self.steps.resize_with(n_memories, LstmStepMemory::default);
        self.zeros.clear();
        self.zeros.resize(weights.width, 0.0);
    }

    /// Copies the observations of every step to where the products read them.
    fn load(
        &mut self,
        weights: &LstmWeights,
        input: EncoderInput<'_>,
        samples: &[usize],
        n_steps: usize,
    ) {
        for (t, step) in self.steps[..n_steps].iter_mut().enumerate() {
            step.begin(weights.width, input, samples[t..].iter().step_by(n_steps).copied());
        }
    }

    /// Goes back through time, to the slopes before the activations.
    fn backward(&mut self, weights: &LstmWeights, d_out: &[f32], resets: &[bool]) {
        let Self { n, steps, start, zeros, d_gates, d_hidden, d_cell, .. } = self;
        let (width, n_steps, n_gates) = (weights.width, resets.len() / *n, N_GATES * weights.width);
        let d_gates = resize(d_gates, *n * n_gates);
        let (d_hidden, d_cell) = (resize(d_hidden, *n * width), resize(d_cell, *n * width));
        d_hidden.fill(0.0);
        d_cell.fill(0.0);
        for t in (0..n_steps).rev() {
            let (before, rest) = steps.split_at_mut(t);
            let Some(now) = rest.first_mut() else { break };
            let cell_before = before.last().map_or(&*start, |step| &step.cell);
            let kept = now.gates.chunks_exact(n_gates).zip(now.squashed.chunks_exact(width));
            let kept =
                kept.zip(cell_before.chunks_exact(width)).zip(d_out.chunks_exact(n_steps * width));
            let found = d_gates.chunks_exact_mut(n_gates).zip(d_cell.chunks_exact_mut(width));
            let rows = kept.zip(found).zip(d_hidden.chunks_exact(width));
            lstm::backward(rows.enumerate().map(|(s, ((kept, (d_gates, d_cell)), d_hidden))| {
                let (((gates, squashed), cell_before), d_out) = kept;
                let is_reset = resets[s * n_steps + t];
                let cell_before = if is_reset { zeros.as_slice() } else { cell_before };
                let d_out = &d_out[t * width..][..width];
                BackwardRow { gates, cell_before, squashed, d_hidden, d_out, d_cell, d_gates }
            }));
            for (s, d_gates) in d_gates.chunks_exact(n_gates).enumerate() {
                now.d_gates.set_row(s, d_gates);
            }
            weights.back(now, d_hidden);
            for s in (0..*n).filter(|s| resets[s * n_steps + t]) {
                d_hidden[s * width..(s + 1) * width].fill(0.0);
                d_cell[s * width..(s + 1) * width].fill(0.0);
            }
        }
    }
}

/// The recurrent layer's rows: step by step, of each the sequences in their order.
fn by_time(groups: &[SequenceGroup], n_steps: usize) -> Vec<RowPairs<'_>> {
    let of_step = |t: usize| {
        groups.iter().map(move |group| {
            let LstmStepMemory { d_gates, hidden_before, .. } = &group.steps[t];
            RowPairs { left: d_gates, right: hidden_before, first: 0, len: group.n }
        })
    };
    (0..n_steps).flat_map(of_step).collect()
}

/// The rows of a layer before it: sequence by sequence, of each the steps in their order.
fn by_sequence<'a>(
    groups: &'a [SequenceGroup],
    n_steps: usize,
    of_step: impl Fn(&'a LstmStepMemory) -> (&'a Panels, &'a Panels),
) -> Vec<RowPairs<'a>> {
    let mut rows = Vec::new();
    for group in groups {
        for s in 0..group.n {
            rows.extend(group.steps[..n_steps].iter().map(|step| {
                let (left, right) = of_step(step);
                RowPairs { left, right, first: s, len: 1 }
            }));
        }
    }
    rows
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
            let (observations, team) = (flat(&observations), Team::default());
            let samples: Vec<usize> = (0..3 * STEPS).collect();
            let input = EncoderInput { observations: &observations, samples: &samples, obs_dim: 3 };
            close(pass.forward(input, sequences(), &team), &plain.values, 1e-5);
            let mut gradients = Gradients::new();
            pass.backward(&plain.target, &mut gradients, &team);
            for (name, expected) in names.iter().zip(&plain.gradients) {
                close(&gradients[name], expected, 1e-5);
            }
        }
    }
}
