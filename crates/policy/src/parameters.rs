//! A policy's numbers: tensors by name and the observation statistics, as one value with a version and a digest.
//!
//! The tensors are candle's; iteration is always in the order of names, so that whatever folds over them (digest,
//! gradient norm, optimiser) does so in one order. Reading and writing files is in [`crate::file`].

use std::collections::BTreeMap;

use candle_core::{DType, Device, Tensor};
use leadtime_numerics::{Activation, Dense, Purpose, orthogonal, stream};
use leadtime_proto::{EgoAttention, Encoder, PolicySpec};
use sha2::{Digest as _, Sha256};

use crate::architecture::{AttentionLayers, Branch, Layer, LstmLayers, all_layers, layers};
use crate::{Error, ObservationNormalizer};

/// All weights of an actor-critic and the statistics of its inputs.
#[derive(Clone, Debug)]
pub struct Parameters {
    tensors: BTreeMap<String, Tensor>,
    normalizer: Option<ObservationNormalizer>,
}

impl Parameters {
    /// Draws initial parameters: orthogonal weights (gain √2, actor head 0.01, critic head and gates 1), zero biases except for
    /// the specification's [`PolicySpec::logit_bias`].
    ///
    /// # Errors
    ///
    /// [`Error::LogitBias`] or [`Error::Spec`] if the specification contradicts itself.
    pub fn initialize(spec: &PolicySpec, run_seed: u64) -> Result<Self, Error> {
        spec.check()?;
        let n_choices = spec.actions.n_choices();
        if !spec.logit_bias.is_empty() && spec.logit_bias.len() != n_choices {
            return Err(Error::LogitBias { found: spec.logit_bias.len(), expected: n_choices });
        }
        let mut values = BTreeMap::new();
        for (index, layer) in all_layers(spec).into_iter().enumerate() {
            let mut generator = stream(run_seed, Purpose::Initialise, 0, index as u64);
            let weight = orthogonal(layer.n_out, layer.n_in, layer.gain, &mut generator);
            let biased = layer.name == "actor.head" && !spec.logit_bias.is_empty();
            let bias = if biased { spec.logit_bias.clone() } else { vec![0.0; layer.n_out] };
            values.insert(layer.weight(), weight);
            if layer.biased {
                values.insert(layer.bias(), bias);
            }
        }
        let normalizer =
            spec.normalize_observations.then(|| ObservationNormalizer::new(spec.obs_dim));
        Self::from_values(spec, values, normalizer)
    }

    /// Makes parameters of plain numbers, checked against the architecture.
    ///
    /// # Shapes
    ///
    /// `values`: by tensor name, each by rows.
    ///
    /// # Errors
    ///
    /// [`Error`] naming the first tensor that is missing, unknown, misshapen or not finite.
    pub fn from_values(
        spec: &PolicySpec,
        mut values: BTreeMap<String, Vec<f32>>,
        normalizer: Option<ObservationNormalizer>,
    ) -> Result<Self, Error> {
        spec.check()?;
        let mut tensors = BTreeMap::new();
        for (name, shape) in shapes(spec) {
            let Some(numbers) = values.remove(&name) else {
                return Err(Error::Missing { name });
            };
            if numbers.len() != shape.iter().product::<usize>() {
                return Err(Error::Shape { name, found: vec![numbers.len()], expected: shape });
            }
            if numbers.iter().any(|x| !x.is_finite()) {
                return Err(Error::NonFinite { name });
            }
            tensors.insert(name, Tensor::from_vec(numbers, shape, &Device::Cpu)?);
        }
        if let Some(name) = values.into_keys().next() {
            return Err(Error::Unknown { name });
        }
        check_normalizer(spec, normalizer.as_ref())?;
        Ok(Self { tensors, normalizer })
    }

    /// Checks that these are parameters of an architecture: the same tensors in the same shapes.
    ///
    /// # Errors
    ///
    /// [`Error`] naming the first tensor that is missing, unknown or misshapen; [`Error::Spec`] if the architecture
    /// is impossible.
    pub fn check(&self, spec: &PolicySpec) -> Result<(), Error> {
        spec.check()?;
        let shapes = shapes(spec);
        for (name, expected) in &shapes {
            let tensor = self.tensors.get(name);
            let found = tensor.ok_or_else(|| Error::Missing { name: name.clone() })?.dims();
            if found != expected {
                let (name, found, expected) = (name.clone(), found.to_vec(), expected.clone());
                return Err(Error::Shape { name, found, expected });
            }
        }
        if let Some(name) = self.tensors.keys().find(|name| !shapes.contains_key(*name)) {
            return Err(Error::Unknown { name: name.clone() });
        }
        check_normalizer(spec, self.normalizer.as_ref())
    }

    /// Returns the tensors by name.
    pub fn tensors(&self) -> &BTreeMap<String, Tensor> {
        &self.tensors
    }

    /// Returns the observation statistics, if the policy normalises its input.
    pub fn normalizer(&self) -> Option<&ObservationNormalizer> {
        self.normalizer.as_ref()
    }

    /// Returns a tensor's numbers by rows.
    ///
    /// # Errors
    ///
    /// [`Error::Missing`] if there is no such tensor.
    pub fn values(&self, name: &str) -> Result<Vec<f32>, Error> {
        let tensor =
            self.tensors.get(name).ok_or_else(|| Error::Missing { name: name.to_owned() })?;
        Ok(tensor.flatten_all()?.to_vec1()?)
    }

    /// Packs a layer's weights for acting; a layer without biases gets zeros.
    ///
    /// # Errors
    ///
    /// [`Error`] if a tensor of the layer is missing, or its weights do not fit its biases.
    pub(crate) fn dense(&self, layer: &Layer) -> Result<Dense, Error> {
        let weight = self.values(&layer.weight())?;
        let bias = if layer.biased { self.values(&layer.bias())? } else { vec![0.0; layer.n_out] };
        Ok(Dense::new(&weight, &bias)?)
    }

    /// Computes the SHA-256 over names and little-endian numbers, in the order of names.
    ///
    /// Two parameter sets have the same digest exactly if every bit of them agrees.
    ///
    /// # Errors
    ///
    /// [`Error::Tensor`] if the engine cannot read a tensor.
    pub fn digest(&self) -> Result<[u8; 32], Error> {
        let mut hasher = Sha256::new();
        for name in self.tensors.keys() {
            hasher.update(name.as_bytes());
            for value in self.values(name)? {
                hasher.update(value.to_le_bytes());
            }
        }
        if let Some(normalizer) = &self.normalizer {
            for (name, values) in normalizer_tensors(normalizer) {
                hasher.update(name.as_bytes());
                for value in values {
                    hasher.update(value.to_le_bytes());
                }
            }
        }
        Ok(hasher.finalize().into())
    }

    /// Computes logits and values with the engine's own operations: slow, plain, and what the fast paths are
    /// tested against.
    ///
    /// # Shapes
    ///
    /// `observations`: `[N, D]`, already normalised; to a recurrent policy they are N steps of one episode, from its
    /// start. Returns logits `[N, C]` and values `[N, 1]`.
    ///
    /// # Errors
    ///
    /// [`Error::Tensor`] if the shapes do not hold.
    pub fn forward(
        &self,
        spec: &PolicySpec,
        observations: &Tensor,
    ) -> Result<(Tensor, Tensor), Error> {
        let features = match &spec.encoder {
            Encoder::Identity => observations.clone(),
            &Encoder::Lstm { projection, state } => {
                let layers = LstmLayers::new(spec.obs_dim, projection, state);
                self.encode_episode(&layers, state, observations)?
            }
            Encoder::EgoAttention(attention) => self.encode(attention, observations)?,
        };
        let run = |branch| -> Result<Tensor, Error> {
            layers(spec, branch).iter().try_fold(features.clone(), |x, layer| self.apply(&x, layer))
        };
        Ok((run(Branch::Actor)?, run(Branch::Critic)?))
    }

    /// Runs an LSTM of `width` units over the steps of an episode.
    fn encode_episode(
        &self,
        layers: &LstmLayers,
        width: usize,
        x: &Tensor,
    ) -> Result<Tensor, Error> {
        let mut before = layers.projection.iter().chain([&layers.input]);
        let from_input = before.try_fold(x.clone(), |x, layer| self.apply(&x, layer))?;
        let sigmoid = |x: Tensor| ((x * 0.5)?.tanh()? + 1.0)? * 0.5;
        let mut hidden = Tensor::zeros((1, width), DType::F32, &Device::Cpu)?;
        let mut cell = hidden.clone();
        let mut features = Vec::new();
        for step in 0..x.dim(0)? {
            let gates = (from_input.narrow(0, step, 1)? + self.apply(&hidden, &layers.state)?)?;
            let gate = |i: usize| gates.narrow(1, i * width, width);
            let candidate = gate(2)?.tanh()?;
            cell = ((sigmoid(gate(1)?)? * cell)? + (sigmoid(gate(0)?)? * candidate)?)?;
            hidden = (sigmoid(gate(3)?)? * cell.tanh()?)?;
            features.push(hidden.clone());
        }
        Ok(Tensor::cat(&features, 0)?)
    }

    /// Computes the features of ego attention with the engine's own operations.
    fn encode(&self, spec: &EgoAttention, observations: &Tensor) -> Result<Tensor, Error> {
        let &EgoAttention { n_frames, n_entities, n_features, action_dim, width, n_heads } = spec;
        let layers = AttentionLayers::new(spec);
        let (n, frame_dim) = (observations.dim(0)?, spec.frame_dim());
        let frames = observations.narrow(1, 0, n_frames * frame_dim)?;
        let frames = frames.reshape((n * n_frames, frame_dim))?;
        let entities = frames.narrow(1, 0, n_entities * n_features)?;
        let entities = entities.reshape((n * n_frames, n_entities, n_features))?;
        let embed = |x: Tensor, layers: &[Layer; 2]| {
            let n_rows = x.elem_count() / n_features;
            let rows = x.contiguous()?.reshape((n_rows, n_features))?;
            layers.iter().try_fold(rows, |x, layer| self.apply(&x, layer))
        };
        let ego = embed(entities.narrow(1, 0, 1)?, &layers.ego)?;
        let others = embed(entities.narrow(1, 1, n_entities - 1)?, &layers.others)?;
        let others = others.reshape((n * n_frames, n_entities - 1, width))?;
        let all = Tensor::cat(&[&ego.unsqueeze(1)?, &others], 1)?;
        let all = all.reshape((n * n_frames * n_entities, width))?;
        // [frames, heads, entities, width of a head]
        let split = |x: Tensor, n_entities| {
            x.reshape((n * n_frames, n_entities, n_heads, width / n_heads))?.transpose(1, 2)
        };
        let keys = split(self.apply(&all, &layers.key)?, n_entities)?.contiguous()?;
        let values = split(self.apply(&all, &layers.value)?, n_entities)?.contiguous()?;
        let query = split(self.apply(&ego, &layers.query)?, 1)?.contiguous()?;
        let scores = query.matmul(&keys.transpose(2, 3)?.contiguous()?)?;
        let scores = (scores / ((width / n_heads) as f64).sqrt())?;
        let there = entities.narrow(2, 0, 1)?.ge(0.5)?.reshape((n * n_frames, 1, 1, n_entities))?;
        let hidden = Tensor::full(-1e9_f32, scores.shape(), scores.device())?;
        let scores = there.broadcast_as(scores.shape())?.where_cond(&scores, &hidden)?;
        let shifted = scores.broadcast_sub(&scores.max_keepdim(3)?)?.exp()?;
        let shares = shifted.broadcast_div(&shifted.sum_keepdim(3)?)?;
        let seen = shares.matmul(&values)?.transpose(1, 2)?.reshape((n * n_frames, width))?;
        let encoded = ((self.apply(&seen, &layers.combine)? + ego)? / 2.0)?;
        let encoded = beside(&encoded, &frames, n_entities * n_features)?;
        let encoded = encoded.reshape((n, n_frames * (width + action_dim)))?;
        beside(&encoded, observations, n_frames * frame_dim)
    }

    fn apply(&self, x: &Tensor, layer: &Layer) -> Result<Tensor, Error> {
        let tensor = |name: String| self.tensors.get(&name).ok_or(Error::Missing { name });
        let mut sum = x.matmul(&tensor(layer.weight())?.t()?)?;
        if layer.biased {
            sum = sum.broadcast_add(tensor(layer.bias())?)?;
        }
        Ok(match layer.activation {
            Activation::Linear => sum,
            Activation::Tanh => sum.tanh()?,
            Activation::Relu => sum.relu()?,
        })
    }
}

/// Puts what follows column `from` of `source` behind the columns of `x`.
fn beside(x: &Tensor, source: &Tensor, from: usize) -> Result<Tensor, Error> {
    match source.dim(1)? - from {
        0 => Ok(x.clone()),
        n_columns => Ok(Tensor::cat(&[x, &source.narrow(1, from, n_columns)?], 1)?),
    }
}

/// Lists the names and shapes of all weights in the order of names.
pub fn shapes(spec: &PolicySpec) -> BTreeMap<String, Vec<usize>> {
    let mut shapes = BTreeMap::new();
    for layer in all_layers(spec) {
        shapes.insert(layer.weight(), vec![layer.n_out, layer.n_in]);
        if layer.biased {
            shapes.insert(layer.bias(), vec![layer.n_out]);
        }
    }
    shapes
}

/// Returns an upper bound on the size of a file with all weights and statistics, in bytes.
pub fn max_bytes(spec: &PolicySpec) -> usize {
    // A tensor's name, shape and place in the file.
    const TENSOR: usize = 192;
    let tensor = |shape: &Vec<usize>| 4 * shape.iter().product::<usize>() + TENSOR;
    let statistics = 2 * 8 * spec.obs_dim + 3 * TENSOR;
    shapes(spec).values().map(tensor).sum::<usize>() + statistics
}

/// Lists the statistics as tensors, in the order of names.
pub(crate) fn normalizer_tensors(
    normalizer: &ObservationNormalizer,
) -> [(&'static str, Vec<f64>); 3] {
    [
        ("normalizer.count", vec![normalizer.count]),
        ("normalizer.mean", normalizer.mean.clone()),
        ("normalizer.variance", normalizer.variance.clone()),
    ]
}

fn check_normalizer(
    spec: &PolicySpec,
    normalizer: Option<&ObservationNormalizer>,
) -> Result<(), Error> {
    let Some(normalizer) = normalizer else {
        let missing = Error::Missing { name: "normalizer.mean".to_owned() };
        return if spec.normalize_observations { Err(missing) } else { Ok(()) };
    };
    if !spec.normalize_observations {
        return Err(Error::Unknown { name: "normalizer.mean".to_owned() });
    }
    for (name, values) in normalizer_tensors(normalizer) {
        let expected = if name == "normalizer.count" { 1 } else { spec.obs_dim };
        let name = name.to_owned();
        if values.len() != expected {
            return Err(Error::Shape { name, found: vec![values.len()], expected: vec![expected] });
        }
        if values.iter().any(|x| !x.is_finite() || (*x < 0.0 && name != "normalizer.mean")) {
            return Err(Error::NonFinite { name });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use leadtime_proto::spec::SpecError;

    use super::*;
    use crate::tests::notifier;

    #[test]
    fn initial_parameters_derive_from_the_seed_alone() {
        let spec = notifier(60);
        let digest = |seed| Parameters::initialize(&spec, seed).unwrap().digest().unwrap();
        assert_eq!(digest(1), digest(1));
        assert_ne!(digest(1), digest(2));
    }

    #[test]
    fn heads_start_small_and_biased_as_asked() {
        let mut spec = notifier(8);
        spec.logit_bias = (0..14).map(|i| i as f32).collect();
        let parameters = Parameters::initialize(&spec, 1).unwrap();
        assert_eq!(parameters.values("actor.head.bias").unwrap(), spec.logit_bias);
        assert_eq!(parameters.values("critic.head.bias").unwrap(), [0.0]);
        let norm = |name: &str| -> f32 {
            parameters.values(name).unwrap().iter().map(|x| x * x).sum::<f32>().sqrt()
        };
        assert!((norm("actor.head.weight") - 0.01 * 14_f32.sqrt()).abs() < 1e-5);
        assert!((norm("critic.head.weight") - 1.0).abs() < 1e-5);
        assert!((norm("critic.1.weight") - 128_f32.sqrt()).abs() < 1e-4);
        spec.logit_bias.pop();
        assert!(matches!(
            Parameters::initialize(&spec, 1),
            Err(Error::LogitBias { found: 13, expected: 14 })
        ));
    }
    #[test]
    fn parameters_of_another_architecture_are_refused() {
        let parameters = Parameters::initialize(&notifier(8), 1).unwrap();
        let error = |change: fn(&mut PolicySpec)| {
            let mut spec = notifier(8);
            change(&mut spec);
            crate::Policy::new(&spec, &parameters).unwrap_err()
        };
        assert!(matches!(error(|spec| spec.obs_dim = 9), Error::Shape { .. }));
        assert!(matches!(error(|spec| spec.hidden.push(64)), Error::Missing { .. }));
        assert!(matches!(error(|spec| spec.hidden.truncate(1)), Error::Unknown { .. }));
        assert!(matches!(error(|spec| spec.normalize_observations = true), Error::Missing { .. }));
        let nine_heads = |spec: &mut PolicySpec| {
            let head = spec.actions.heads[0].clone();
            spec.actions.heads.resize(9, head);
        };
        let error = error(nine_heads);
        assert!(matches!(error, Error::Spec(SpecError::Heads { n_heads: 9 })), "{error}");
    }
}
