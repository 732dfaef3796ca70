//! A policy's numbers: tensors by name and the observation statistics, as one value with a version and a digest.
//!
//! The tensors are candle's; iteration is always in the order of names, so that whatever folds over them (digest,
//! gradient norm, optimiser) does so in one order. Reading and writing files is in [`crate::file`].

use std::collections::BTreeMap;

use candle_core::{Device, Tensor};
use leadtime_numerics::{Dense, Purpose, orthogonal, stream};
use leadtime_proto::PolicySpec;
use sha2::{Digest as _, Sha256};

use crate::architecture::{Layer, all_layers};
use crate::error::{check_shape, missing, non_finite, unknown};
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
    /// [`Error::Misfit`] or [`Error::Spec`] if the specification contradicts itself.
    pub fn initialize(spec: &PolicySpec, run_seed: u64) -> Result<Self, Error> {
        spec.check()?;
        let (found, expected) = (spec.logit_bias.len(), spec.actions.n_choices());
        if found != 0 && found != expected {
            return Err(Error::Misfit(format!(
                "`logit_bias` has {found} entries, the heads have {expected} choices"
            )));
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
    /// [`Error`] if the architecture is impossible, or a tensor is missing, unknown, misshapen or not finite; it names
    /// the first one.
    pub fn from_values(
        spec: &PolicySpec,
        mut values: BTreeMap<String, Vec<f32>>,
        normalizer: Option<ObservationNormalizer>,
    ) -> Result<Self, Error> {
        spec.check()?;
        let mut tensors = BTreeMap::new();
        for (name, shape) in shapes(spec) {
            let numbers = values.remove(&name).ok_or_else(|| missing(&name))?;
            if numbers.len() != shape.iter().product::<usize>() {
                check_shape(&name, &[numbers.len()], &shape)?;
            }
            if numbers.iter().any(|x| !x.is_finite()) {
                return Err(non_finite(&name));
            }
            tensors.insert(name, Tensor::from_vec(numbers, shape, &Device::Cpu)?);
        }
        if let Some(name) = values.keys().next() {
            return Err(unknown(name));
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
            check_shape(name, self.tensor(name)?.dims(), expected)?;
        }
        if let Some(name) = self.tensors.keys().find(|name| !shapes.contains_key(*name)) {
            return Err(unknown(name));
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
    /// [`Error::Misfit`] if there is no such tensor.
    pub fn values(&self, name: &str) -> Result<Vec<f32>, Error> {
        Ok(self.tensor(name)?.flatten_all()?.to_vec1()?)
    }

    fn tensor(&self, name: &str) -> Result<&Tensor, Error> {
        self.tensors.get(name).ok_or_else(|| missing(name))
    }

    /// Packs a layer's weights for acting; a layer without biases gets zeros.
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
    let normalizer = match (normalizer, spec.normalize_observations) {
        (None, false) => return Ok(()),
        (None, true) => return Err(missing("normalizer.mean")),
        (Some(_), false) => return Err(unknown("normalizer.mean")),
        (Some(normalizer), true) => normalizer,
    };
    for (name, values) in normalizer_tensors(normalizer) {
        let expected = if name == "normalizer.count" { 1 } else { spec.obs_dim };
        check_shape(name, &[values.len()], &[expected])?;
        if values.iter().any(|x| !x.is_finite() || (*x < 0.0 && name != "normalizer.mean")) {
            return Err(non_finite(name));
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
        let error = Parameters::initialize(&spec, 1).unwrap_err().to_string();
        assert_eq!(error, "`logit_bias` has 13 entries, the heads have 14 choices");
    }

    #[test]
    fn parameters_of_another_architecture_are_refused() {
        type Change = fn(&mut PolicySpec);
        let parameters = Parameters::initialize(&notifier(8), 1).unwrap();
        let error = |change: Change| {
            let mut spec = notifier(8);
            change(&mut spec);
            crate::Policy::new(&spec, &parameters).unwrap_err()
        };
        let changes: [(Change, &str); 4] = [
            (|spec| spec.obs_dim = 9, "has shape [64, 8], the architecture needs [64, 9]"),
            (|spec| spec.hidden.push(64), "no tensor `actor.2.bias`"),
            (|spec| spec.hidden.truncate(1), "hold a tensor `actor.1.bias` that"),
            (|spec| spec.normalize_observations = true, "no tensor `normalizer.mean`"),
        ];
        for (change, says) in changes {
            assert!(error(change).to_string().contains(says), "{}", error(change));
        }
        let nine_heads = |spec: &mut PolicySpec| {
            let head = spec.actions.heads[0].clone();
            spec.actions.heads.resize(9, head);
        };
        let error = error(nine_heads);
        assert!(matches!(error, Error::Spec(SpecError::Heads { n_heads: 9 })), "{error}");
    }
}
