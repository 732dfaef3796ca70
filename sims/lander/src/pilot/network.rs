//! The trained pilot: an 8-64-64-4 tanh network that acts greedily.
//!
//! Weights come as safetensors with the names that our own learner writes (`actor.0.weight` ...), so a policy file
//! trained on the `pilot` task is a pilot as it stands; the critic in it is ignored, and an observation normaliser
//! is applied. The file's metadata say where the weights come from.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use leadtime_numerics::{Activation, Dense, DenseError};
use safetensors::{Dtype, SafeTensorError, SafeTensors};
use thiserror::Error;

use crate::world::Engine;

const N_INPUTS: usize = 8;
const WIDTH: usize = 64;
const N_ENGINES: usize = Engine::ALL.len();
/// Bounds of a normalised input, and the least variance it is divided by: those of the learner.
const NORMALIZED_MAX: f32 = 10.0;
const VARIANCE_FLOOR: f64 = 1e-8;

static EMBEDDED: LazyLock<Pilot> = LazyLock::new(|| {
    Pilot::from_safetensors(include_bytes!("pilot.safetensors"))
        .expect("the embedded pilot is checked by a test")
});

/// Why a file is no pilot.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the sentence of each variant names its fields")]
pub enum PilotError {
    /// The bytes are no safetensors file.
    #[error("pilot weights cannot be read")]
    Format(#[from] SafeTensorError),
    /// A tensor is missing.
    #[error("pilot weights have no tensor `{name}`")]
    Missing { name: &'static str },
    /// A tensor has the wrong shape, or holds something else than 32-bit (a normaliser: or 64-bit) floats.
    #[error("tensor `{name}` is {dtype:?} {shape:?}, expected F32 {expected:?}")]
    Shape { name: &'static str, dtype: Dtype, shape: Vec<usize>, expected: Vec<usize> },
    /// A number is NaN or infinite, or a variance is negative.
    #[error("tensor `{name}` holds a number that cannot be used")]
    BadNumber { name: &'static str },
    /// The layers do not fit together.
    #[error("pilot weights do not form layers")]
    Layer(#[from] DenseError),
}

/// A network that flies the lander.
#[derive(Clone, Debug)]
pub struct Pilot {
    hidden: [Dense; 2],
    head: Dense,
    normalizer: Option<Normalizer>,
    provenance: BTreeMap<String, String>,
}

#[derive(Clone, Debug)]
struct Normalizer {
    mean: [f32; N_INPUTS],
    scale: [f32; N_INPUTS],
}

impl Pilot {
    /// Returns the pilot that is part of the program.
    pub fn embedded() -> &'static Self {
        &EMBEDDED
    }

    /// Reads a pilot from the bytes of a safetensors file, such as a `policy.safetensors` trained by Leadtime.
    ///
    /// # Shapes
    ///
    /// `actor.0.weight`: `[64, 8]`; `actor.1.weight`: `[64, 64]`; `actor.head.weight`: `[4, 64]`; biases
    /// accordingly; optionally `normalizer.mean` and `normalizer.variance`: `[8]`. Other tensors are ignored.
    ///
    /// # Errors
    ///
    /// [`PilotError`] naming the tensor that is missing, misshapen or not finite.
    pub fn from_safetensors(bytes: &[u8]) -> Result<Self, PilotError> {
        let tensors = SafeTensors::deserialize(bytes)?;
        let (_, metadata) = SafeTensors::read_metadata(bytes)?;
        let provenance = metadata.metadata().iter().flatten();
        Ok(Self {
            hidden: [
                layer(&tensors, ["actor.0.weight", "actor.0.bias"], [WIDTH, N_INPUTS])?,
                layer(&tensors, ["actor.1.weight", "actor.1.bias"], [WIDTH, WIDTH])?,
            ],
            head: layer(&tensors, ["actor.head.weight", "actor.head.bias"], [N_ENGINES, WIDTH])?,
            normalizer: normalizer(&tensors)?,
            provenance: provenance.map(|(key, value)| (key.clone(), value.clone())).collect(),
        })
    }

    /// Returns what the file says about where the weights come from.
    pub fn provenance(&self) -> &BTreeMap<String, String> {
        &self.provenance
    }

    /// Chooses the engine with the largest logit; the first one, if several are.
    pub fn engine(&self, observation: &[f32; N_INPUTS]) -> Engine {
        let logits = self.logits(observation);
        let best =
            (1..N_ENGINES).fold(0, |best, i| if logits[i] > logits[best] { i } else { best });
        Engine::ALL[best]
    }

    /// Computes the four logits.
    pub fn logits(&self, observation: &[f32; N_INPUTS]) -> [f32; N_ENGINES] {
        let input = self.normalizer.as_ref().map_or(*observation, |n| n.apply(observation));
        let (mut first, mut second, mut logits) = ([0.0; WIDTH], [0.0; WIDTH], [0.0; N_ENGINES]);
        self.hidden[0].forward(&input, &mut first, Activation::Tanh);
        self.hidden[1].forward(&first, &mut second, Activation::Tanh);
        self.head.forward(&second, &mut logits, Activation::Linear);
        logits
    }
}

impl Normalizer {
    fn apply(&self, observation: &[f32; N_INPUTS]) -> [f32; N_INPUTS] {
        std::array::from_fn(|i| {
            let normalized = (observation[i] - self.mean[i]) * self.scale[i];
            normalized.clamp(-NORMALIZED_MAX, NORMALIZED_MAX)
        })
    }
}

/// Tells whether a standing lander should let its engines rest: both legs down and hardly moving.
///
/// A person would; a network trained on the original reward often goes on hovering on its legs.
pub fn engines_off(observation: &[f32; N_INPUTS]) -> bool {
    let [_, _, vx, vy, _, spin, right, left] = *observation;
    let stands = right != 0.0 && left != 0.0;
    stands && vx.abs() < 0.08 && vy.abs() < 0.08 && spin.abs() < 0.15
}

fn layer(
    tensors: &SafeTensors<'_>,
    [weight, bias]: [&'static str; 2],
    [n_out, n_in]: [usize; 2],
) -> Result<Dense, PilotError> {
    let weights = numbers(tensors, weight, &[n_out, n_in])?.map(|x| x as f32);
    let biases = numbers(tensors, bias, &[n_out])?.map(|x| x as f32);
    Ok(Dense::new(&weights.collect::<Vec<_>>(), &biases.collect::<Vec<_>>())?)
}

fn normalizer(tensors: &SafeTensors<'_>) -> Result<Option<Normalizer>, PilotError> {
    if tensors.tensor("normalizer.mean").is_err() {
        return Ok(None);
    }
    let mut normalizer = Normalizer { mean: [0.0; N_INPUTS], scale: [0.0; N_INPUTS] };
    let mean = numbers(tensors, "normalizer.mean", &[N_INPUTS])?;
    for (slot, mean) in normalizer.mean.iter_mut().zip(mean) {
        *slot = mean as f32;
    }
    let name = "normalizer.variance";
    for (slot, variance) in normalizer.scale.iter_mut().zip(numbers(tensors, name, &[N_INPUTS])?) {
        if variance < 0.0 {
            return Err(PilotError::BadNumber { name });
        }
        *slot = (1.0 / (variance + VARIANCE_FLOOR).sqrt()) as f32;
    }
    Ok(Some(normalizer))
}

/// Reads a tensor of a known shape; single-precision numbers pass through double precision unchanged.
fn numbers(
    tensors: &SafeTensors<'_>,
    name: &'static str,
    expected: &[usize],
) -> Result<std::vec::IntoIter<f64>, PilotError> {
    let missing = |_cause| PilotError::Missing { name };
    let tensor = tensors.tensor(name).map_err(missing)?;
    let data = tensor.data();
    let right_shape = tensor.shape() == expected;
    let numbers: Vec<f64> = match tensor.dtype() {
        Dtype::F32 if right_shape => data
            .chunks_exact(4)
            .map(|b| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])))
            .collect(),
        Dtype::F64 if right_shape => data
            .chunks_exact(8)
            .map(|b| f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]))
            .collect(),
        dtype => {
            let (shape, expected) = (tensor.shape().to_vec(), expected.to_vec());
            return Err(PilotError::Shape { name, dtype, shape, expected });
        }
    };
    if numbers.iter().any(|number| !number.is_finite()) {
        return Err(PilotError::BadNumber { name });
    }
    Ok(numbers.into_iter())
}

#[cfg(test)]
#[path = "network_tests.rs"]
mod tests;
