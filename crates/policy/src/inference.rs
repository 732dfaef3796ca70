//! Acting fast: logits and values of a batch of raw observations, without a graph and without allocation.
//!
//! A row's result does not depend on the batch it comes in (the kernel's rows are independent), and the learner's
//! forward pass uses the same kernel in the same order: the log-probability that an actor stores is the one that the
//! learner computes, bit for bit, while the weights are the same.
//!
//! Rows are taken in blocks small enough that all intermediate activations stay in the first-level cache.

use leadtime_numerics::{Activation, Dense};
use leadtime_proto::PolicySpec;

use crate::architecture::{Branch, Layer, layers};
use crate::encoder::FastEncoder;
use crate::normalizer::FrozenNormalizer;
use crate::{Error, Parameters};

/// Rows per block: two 64-wide activations of 48 rows take 24 KiB.
const BLOCK: usize = 48;

#[derive(Clone, Debug)]
struct LayerStack {
    layers: Vec<(Dense, Activation)>,
}

impl LayerStack {
    fn new(spec: &PolicySpec, parameters: &Parameters, branch: Branch) -> Result<Self, Error> {
        let build = |layer: &Layer| Ok((parameters.dense(layer)?, layer.activation));
        let layers = layers(spec, branch).iter().map(build).collect::<Result<_, Error>>()?;
        Ok(Self { layers })
    }

    fn widest(&self) -> usize {
        self.layers.iter().map(|(dense, _)| dense.n_out()).max().unwrap_or(0)
    }

    /// Returns the width of what the last layer sees.
    fn hidden_dim(&self) -> usize {
        self.layers.last().map_or(0, |(head, _)| head.n_in())
    }

    /// Runs one block of `n` rows through all layers.
    fn forward(&self, features: &[f32], n: usize, scratch: &mut [f32], out: &mut [f32]) {
        run(&self.layers, features, n, scratch, out);
    }

    /// Runs one block up to what the last layer sees.
    fn hidden(&self, features: &[f32], n: usize, scratch: &mut [f32], out: &mut [f32]) {
        match self.layers.split_last() {
            Some((_, below)) if !below.is_empty() => run(below, features, n, scratch, out),
            _ => out.copy_from_slice(features),
        }
    }
}

/// Runs one block through some layers; `scratch` holds two activations of it.
fn run(
    layers: &[(Dense, Activation)],
    features: &[f32],
    n: usize,
    scratch: &mut [f32],
    out: &mut [f32],
) {
    let (mut from, mut to) = scratch.split_at_mut(scratch.len() / 2);
    for (i, (dense, activation)) in layers.iter().enumerate() {
        let x = if i == 0 { features } else { &from[..n * dense.n_in()] };
        if i + 1 == layers.len() {
            dense.forward(x, out, *activation);
            return;
        }
        dense.forward(x, &mut to[..n * dense.n_out()], *activation);
        std::mem::swap(&mut from, &mut to);
    }
}

/// An actor-critic with fixed weights, ready to act.
#[derive(Clone, Debug)]
pub struct Policy {
    obs_dim: usize,
    n_choices: usize,
    recurrent_dim: usize,
    normalizer: Option<FrozenNormalizer>,
    encoder: FastEncoder,
    actor: LayerStack,
    critic: LayerStack,
    features: Vec<f32>,
    scratch: Vec<f32>,
}

impl Policy {
    /// Packs parameters for acting.
    ///
    /// # Errors
    ///
    /// [`Error`] if the parameters are not those of this architecture.
    pub fn new(spec: &PolicySpec, parameters: &Parameters) -> Result<Self, Error> {
        parameters.check(spec)?;
        let actor = LayerStack::new(spec, parameters, Branch::Actor)?;
        let critic = LayerStack::new(spec, parameters, Branch::Critic)?;
        let widest = actor.widest().max(critic.widest());
        Ok(Self {
            obs_dim: spec.obs_dim,
            n_choices: spec.actions.n_choices(),
            recurrent_dim: spec.recurrent_dim(),
            normalizer: parameters.normalizer().map(crate::ObservationNormalizer::freeze),
            encoder: FastEncoder::new(spec, parameters, BLOCK)?,
            actor,
            critic,
            features: vec![0.0; BLOCK * spec.obs_dim],
            scratch: vec![0.0; 2 * BLOCK * widest],
        })
    }

    /// Returns the length of an observation.
    pub fn obs_dim(&self) -> usize {
        self.obs_dim
    }

    /// Returns the width of the logits.
    pub fn n_choices(&self) -> usize {
        self.n_choices
    }

    /// Returns the width of the state that a row carries from step to step; 0 if there is none.
    pub fn recurrent_dim(&self) -> usize {
        self.recurrent_dim
    }

    /// Computes logits and values, and moves the recurrent state on by a step.
    ///
    /// # Shapes
    ///
    /// `observations`: raw, `[N, D]`; `recurrent`: `[N, S]`; `logits`: `[N, C]`; `values`: `[N]`.
    ///
    /// # Panics
    ///
    /// If the shapes do not hold.
    pub fn evaluate(
        &mut self,
        observations: &[f32],
        recurrent: &mut [f32],
        logits: &mut [f32],
        values: &mut [f32],
    ) {
        let n = values.len();
        self.check_inputs(observations, recurrent, n);
        assert_eq!(logits.len(), n * self.n_choices, "`logits` must be [N, C]");
        let blocks = observations.chunks(BLOCK * self.obs_dim);
        let outputs = logits.chunks_mut(BLOCK * self.n_choices).zip(values.chunks_mut(BLOCK));
        let mut first = 0;
        for (raw, (logits, values)) in blocks.zip(outputs) {
            let n = values.len();
            let states = &mut recurrent[first * self.recurrent_dim..][..n * self.recurrent_dim];
            let input = prepare(self.normalizer.as_ref(), raw, &mut self.features);
            let features = self.encoder.forward(input, states, n);
            self.actor.forward(features, n, &mut self.scratch, logits);
            self.critic.forward(features, n, &mut self.scratch, values);
            self.encoder.write_states(states);
            first += n;
        }
    }

    fn check_inputs(&self, observations: &[f32], recurrent: &[f32], n: usize) {
        assert_eq!(observations.len(), n * self.obs_dim, "`observations` must be [N, D]");
        assert_eq!(recurrent.len(), n * self.recurrent_dim, "`recurrent` must be [N, S]");
    }

    /// Returns the width of what the actor's heads see.
    pub fn hidden_dim(&self) -> usize {
        self.actor.hidden_dim()
    }

    /// Computes what the actor's heads see: its last hidden layer, or the encoder's features where it has none. The
    /// recurrent state is read and not moved on.
    ///
    /// # Shapes
    ///
    /// `observations`: raw, `[N, D]`; `recurrent`: `[N, S]`; `out`: `[N, hidden_dim]`.
    ///
    /// # Panics
    ///
    /// If the shapes do not hold.
    pub fn hidden(&mut self, observations: &[f32], recurrent: &[f32], out: &mut [f32]) {
        let (n, width) = (observations.len() / self.obs_dim, self.hidden_dim());
        self.check_inputs(observations, recurrent, n);
        assert_eq!(out.len(), n * width, "`out` must be [N, hidden_dim]");
        let mut first = 0;
        let blocks = observations.chunks(BLOCK * self.obs_dim);
        for (raw, out) in blocks.zip(out.chunks_mut(BLOCK * width)) {
            let n = out.len() / width;
            let states = &recurrent[first * self.recurrent_dim..][..n * self.recurrent_dim];
            let input = prepare(self.normalizer.as_ref(), raw, &mut self.features);
            let features = self.encoder.forward(input, states, n);
            self.actor.hidden(features, n, &mut self.scratch, out);
            first += n;
        }
    }

    /// Computes values only, for bootstrapping; the recurrent state is read and not moved on.
    ///
    /// # Shapes
    ///
    /// `observations`: raw, `[N, D]`; `recurrent`: `[N, S]`; `values`: `[N]`.
    ///
    /// # Panics
    ///
    /// If the shapes do not hold.
    pub fn values_only(&mut self, observations: &[f32], recurrent: &[f32], values: &mut [f32]) {
        let n = values.len();
        self.check_inputs(observations, recurrent, n);
        let mut first = 0;
        let blocks = observations.chunks(BLOCK * self.obs_dim);
        for (raw, values) in blocks.zip(values.chunks_mut(BLOCK)) {
            let n = values.len();
            let states = &recurrent[first * self.recurrent_dim..][..n * self.recurrent_dim];
            let input = prepare(self.normalizer.as_ref(), raw, &mut self.features);
            let features = self.encoder.forward(input, states, n);
            self.critic.forward(features, n, &mut self.scratch, values);
            first += n;
        }
    }
}

/// Normalises a block, or passes it through where the policy does not normalise.
fn prepare<'a>(
    normalizer: Option<&FrozenNormalizer>,
    raw: &'a [f32],
    features: &'a mut [f32],
) -> &'a [f32] {
    let Some(normalizer) = normalizer else { return raw };
    let features = &mut features[..raw.len()];
    normalizer.apply(raw, features);
    features
}

#[cfg(test)]
mod tests {
    use candle_core::{DType, Device, Tensor};
    use leadtime_numerics::Pcg64;
    use leadtime_proto::{EgoAttention, Encoder};

    use super::*;
    use crate::architecture::LstmLayers;
    use crate::tests::notifier;

    fn observations(n: usize, dim: usize) -> Vec<f32> {
        let mut generator = Pcg64::seed_from_u64(9);
        (0..n * dim).map(|_| generator.uniform(-2.0, 2.0) as f32).collect()
    }

    fn recurrent(projection: usize, hidden: Vec<usize>) -> PolicySpec {
        let encoder = Encoder::Lstm { projection, state: 40 };
        PolicySpec { encoder, hidden, ..notifier(60) }
    }

    /// Initial parameters with heads scaled up, so that logits differ visibly.
    fn parameters(spec: &PolicySpec) -> Parameters {
        let initial = Parameters::initialize(spec, 4).unwrap();
        let values = initial.tensors().keys().map(|name| {
            let scale = if name.contains("actor.head") { 100.0 } else { 1.0 };
            let values = initial.values(name).unwrap();
            (name.clone(), values.into_iter().map(|x| x * scale + 0.01).collect())
        });
        let mut normalizer = initial.normalizer().cloned();
        if let Some(normalizer) = &mut normalizer {
            normalizer.update(spec, &observations(20, spec.obs_dim));
        }
        Parameters::from_values(spec, values.collect(), normalizer).unwrap()
    }

    /// A notifier on a highway: frames of 5 entities and an action, and a status of 3.
    fn attentive() -> PolicySpec {
        let attention = EgoAttention {
            n_frames: 3,
            n_entities: 5,
            n_features: 4,
            action_dim: 2,
            width: 32,
            n_heads: 2,
        };
        PolicySpec { encoder: Encoder::EgoAttention(attention), ..notifier(3 * 22 + 3) }
    }

    /// A layer in the engine's own operations.
    fn apply(parameters: &Parameters, x: &Tensor, layer: &Layer) -> Tensor {
        let tensor = |name: String| &parameters.tensors()[&name];
        let product = x.matmul(&tensor(layer.weight()).t().unwrap()).unwrap();
        let sum = product.broadcast_add(tensor(layer.bias())).unwrap();
        if layer.activation == Activation::Tanh { sum.tanh().unwrap() } else { sum }
    }

    /// The hidden states of an LSTM over the steps of an episode.
    fn encode(
        parameters: &Parameters,
        layers: &LstmLayers,
        x: &Tensor,
    ) -> candle_core::Result<Tensor> {
        let before = layers.projection.iter().chain([&layers.input]);
        let from_input = before.fold(x.clone(), |x, layer| apply(parameters, &x, layer));
        let (width, sigmoid) = (layers.state.n_in, |x: Tensor| ((x * 0.5)?.tanh()? + 1.0)? * 0.5);
        let mut hidden = Tensor::zeros((1, width), DType::F32, &Device::Cpu)?;
        let mut cell = hidden.clone();
        let mut features = Vec::new();
        for step in 0..x.dim(0)? {
            let from_state = apply(parameters, &hidden, &layers.state);
            let gates = (from_input.narrow(0, step, 1)? + from_state)?;
            let gate = |i: usize| gates.narrow(1, i * width, width);
            let candidate = gate(2)?.tanh()?;
            cell = ((sigmoid(gate(1)?)? * cell)? + (sigmoid(gate(0)?)? * candidate)?)?;
            hidden = (sigmoid(gate(3)?)? * cell.tanh()?)?;
            features.push(hidden.clone());
        }
        Tensor::cat(&features, 0)
    }

    /// Asserts that logits and values of an episode's observations are those of the engine's own operations.
    fn assert_plain(spec: &PolicySpec, raw: &[f32], logits: &[f32], values: &[f32]) {
        let parameters = parameters(spec);
        let shape = (values.len(), spec.obs_dim);
        let mut features = Tensor::from_slice(raw, shape, &Device::Cpu).unwrap();
        if let Encoder::Lstm { projection, state } = spec.encoder {
            let layers = LstmLayers::new(spec.obs_dim, projection, state);
            features = encode(&parameters, &layers, &features).unwrap();
        }
        for (fast, branch) in [(logits, Branch::Actor), (values, Branch::Critic)] {
            let plain = layers(spec, branch)
                .iter()
                .fold(features.clone(), |x, layer| apply(&parameters, &x, layer));
            let plain = plain.flatten_all().unwrap().to_vec1::<f32>().unwrap();
            for (i, (a, b)) in fast.iter().zip(&plain).enumerate() {
                // Sums of 64 terms of order one in another order, and a tanh within 4e-7.
                assert!((a - b).abs() < 2e-5, "{i}: {a} {b}");
            }
        }
    }

    #[test]
    fn fast_inference_agrees_with_the_plain_forward_pass() {
        let spec = notifier(60);
        let raw = observations(100, 60);
        let (mut logits, mut values) = (vec![0.0; 1400], vec![0.0; 100]);
        let mut policy = Policy::new(&spec, &parameters(&spec)).unwrap();
        policy.evaluate(&raw, &mut [], &mut logits, &mut values);
        assert_plain(&spec, &raw, &logits, &values);
    }

    #[test]
    fn a_recurrent_policy_is_the_plain_one_step_by_step() {
        for (projection, hidden) in [(32, vec![]), (0, vec![24])] {
            let spec = recurrent(projection, hidden);
            let raw = observations(9, 60);
            let mut policy = Policy::new(&spec, &parameters(&spec)).unwrap();
            let mut state = vec![0.0; spec.recurrent_dim()];
            let (mut logits, mut values) = (vec![0.0; 9 * 14], vec![0.0; 9]);
            for (i, observation) in raw.chunks_exact(60).enumerate() {
                let mut ahead = [0.0];
                policy.values_only(observation, &state, &mut ahead);
                let logits = &mut logits[i * 14..(i + 1) * 14];
                policy.evaluate(observation, &mut state, logits, &mut values[i..=i]);
                assert_eq!(ahead[0], values[i], "reading the value moved the state");
            }
            assert_plain(&spec, &raw, &logits, &values);
        }
    }

    #[test]
    fn what_the_heads_see_makes_the_logits() {
        let n = 60;
        for spec in [notifier(60), attentive(), recurrent(32, vec![]), recurrent(0, vec![24])] {
            let parameters = parameters(&spec);
            let mut policy = Policy::new(&spec, &parameters).unwrap();
            let raw = observations(n, spec.obs_dim);
            let before = observations(n, spec.recurrent_dim());
            let mut hidden = vec![0.0; n * policy.hidden_dim()];
            policy.hidden(&raw, &before, &mut hidden);
            let head = layers(&spec, Branch::Actor).pop().unwrap();
            let mut expected = vec![0.0; n * 14];
            let head = parameters.dense(&head).unwrap();
            head.forward(&hidden, &mut expected, Activation::Linear);
            let (mut logits, mut values) = (vec![0.0; n * 14], vec![0.0; n]);
            policy.evaluate(&raw, &mut before.clone(), &mut logits, &mut values);
            assert_eq!(logits, expected, "{:?}", spec.encoder);
        }
    }

    #[test]
    fn a_row_has_the_same_bits_in_every_batch() {
        for spec in [notifier(60), attentive(), recurrent(32, vec![])] {
            let normalize_observations = spec.recurrent_dim() == 0;
            let spec = PolicySpec { normalize_observations, ..spec };
            let (n, obs_dim, dim) = (65, spec.obs_dim, spec.recurrent_dim());
            let mut policy = Policy::new(&spec, &parameters(&spec)).unwrap();
            let (raw, before) = (observations(n, obs_dim), observations(n, dim));
            let (mut alone, mut alone_values) = (vec![0.0; n * 14], vec![0.0; n]);
            let mut alone_states = before.clone();
            for (i, observation) in raw.chunks_exact(obs_dim).enumerate() {
                let state = &mut alone_states[i * dim..(i + 1) * dim];
                let logits = &mut alone[i * 14..(i + 1) * 14];
                policy.evaluate(observation, state, logits, &mut alone_values[i..=i]);
            }
            for batch in 1..=n {
                let first = n - batch;
                let (mut logits, mut values) = (vec![0.0; batch * 14], vec![0.0; batch]);
                let (raw, before) = (&raw[first * obs_dim..], &before[first * dim..]);
                let mut states = before.to_vec();
                policy.evaluate(raw, &mut states, &mut logits, &mut values);
                assert_eq!(states, alone_states[first * dim..], "states of batch {batch}");
                assert_eq!(logits, alone[first * 14..], "batch {batch}");
                assert_eq!(values, alone_values[first..], "batch {batch}");
                policy.values_only(raw, before, &mut values);
                assert_eq!(values, alone_values[first..], "values of batch {batch}");
            }
        }
    }
}
