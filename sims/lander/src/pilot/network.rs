//! The trained pilot: an 8-64-64-4 tanh network that acts greedily.
//!
//! Weights come as safetensors with the names that our own learner writes (`actor.0.weight` ...), so a policy file
//! trained on the `pilot` task is a pilot as it stands; the critic in it is ignored, and an observation normaliser
//! is applied. The file's metadata say where the weights come from.

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
pub enum PilotError {
    /// The bytes are no safetensors file.
    #[error("pilot weights cannot be read")]
    Format(#[from] SafeTensorError),
    /// A tensor is missing, has the wrong shape or type, or holds a number that cannot be used.
    #[error("{0}")]
    Tensor(String),
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
}

#[derive(Clone, Debug)]
struct Normalizer {
    mean: Vec<f32>,
    scale: Vec<f32>,
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
    /// [`PilotError`] if the bytes are no safetensors, or a tensor is missing, misshapen or not finite; it names the
    /// tensor.
    pub fn from_safetensors(bytes: &[u8]) -> Result<Self, PilotError> {
        let tensors = SafeTensors::deserialize(bytes)?;
        Ok(Self {
            hidden: [
                layer(&tensors, "actor.0", [WIDTH, N_INPUTS])?,
                layer(&tensors, "actor.1", [WIDTH, WIDTH])?,
            ],
            head: layer(&tensors, "actor.head", [N_ENGINES, WIDTH])?,
            normalizer: normalizer(&tensors)?,
        })
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
        let mut input = *observation;
        if let Some(Normalizer { mean, scale }) = &self.normalizer {
            for ((x, mean), scale) in input.iter_mut().zip(mean).zip(scale) {
                *x = ((*x - mean) * scale).clamp(-NORMALIZED_MAX, NORMALIZED_MAX);
            }
        }
        let (mut first, mut second, mut logits) = ([0.0; WIDTH], [0.0; WIDTH], [0.0; N_ENGINES]);
        self.hidden[0].forward(&input, &mut first, Activation::Tanh);
        self.hidden[1].forward(&first, &mut second, Activation::Tanh);
        self.head.forward(&second, &mut logits, Activation::Linear);
        logits
    }
}

/// Returns whether a standing lander should let its engines rest: both legs down and hardly moving.
///
/// A person would; a network trained on the original reward often goes on hovering on its legs.
pub fn engines_off(observation: &[f32; N_INPUTS]) -> bool {
    let [_, _, vx, vy, _, spin, right, left] = *observation;
    let stands = right != 0.0 && left != 0.0;
    stands && vx.abs() < 0.08 && vy.abs() < 0.08 && spin.abs() < 0.15
}

fn layer(
    tensors: &SafeTensors<'_>,
    name: &str,
    [n_out, n_in]: [usize; 2],
) -> Result<Dense, PilotError> {
    let weights = numbers(tensors, &format!("{name}.weight"), &[n_out, n_in])?;
    let biases = numbers(tensors, &format!("{name}.bias"), &[n_out])?;
    Ok(Dense::new(&single(&weights), &single(&biases))?)
}

fn single(numbers: &[f64]) -> Vec<f32> {
    numbers.iter().map(|&x| x as f32).collect()
}

fn normalizer(tensors: &SafeTensors<'_>) -> Result<Option<Normalizer>, PilotError> {
    if tensors.tensor("normalizer.mean").is_err() {
        return Ok(None);
    }
    let mean = single(&numbers(tensors, "normalizer.mean", &[N_INPUTS])?);
    let variance = numbers(tensors, "normalizer.variance", &[N_INPUTS])?;
    if variance.iter().any(|&variance| variance < 0.0) {
        return Err(unusable("normalizer.variance"));
    }
    let scale = variance.iter().map(|x| (1.0 / (x + VARIANCE_FLOOR).sqrt()) as f32).collect();
    Ok(Some(Normalizer { mean, scale }))
}

fn unusable(name: &str) -> PilotError {
    PilotError::Tensor(format!("tensor `{name}` holds a number that cannot be used"))
}

/// Reads a tensor of a known shape; single-precision numbers pass through double precision unchanged.
fn numbers(
    tensors: &SafeTensors<'_>,
    name: &str,
    expected: &[usize],
) -> Result<Vec<f64>, PilotError> {
    let missing = |_cause| PilotError::Tensor(format!("pilot weights have no tensor `{name}`"));
    let tensor = tensors.tensor(name).map_err(missing)?;
    let (dtype, shape, data) = (tensor.dtype(), tensor.shape(), tensor.data());
    let numbers: Vec<f64> = match dtype {
        Dtype::F32 if shape == expected => {
            data.as_chunks().0.iter().map(|&bytes| f64::from(f32::from_le_bytes(bytes))).collect()
        }
        Dtype::F64 if shape == expected => {
            data.as_chunks().0.iter().map(|&bytes| f64::from_le_bytes(bytes)).collect()
        }
        _ => {
            let found =
                format!("tensor `{name}` is {dtype:?} {shape:?}, expected F32 {expected:?}");
            return Err(PilotError::Tensor(found));
        }
    };
    if numbers.iter().all(|number| number.is_finite()) { Ok(numbers) } else { Err(unusable(name)) }
}

#[cfg(test)]
#[path = "network_tests.rs"]
mod tests;
