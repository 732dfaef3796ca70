//! The actor-critic as variables of the engine, and the graph of its encoder.

use std::collections::BTreeMap;
use std::sync::Arc;

use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor, Var};
use leadtime_policy::{ObservationNormalizer, Parameters};
use leadtime_proto::PolicySpec;

use crate::TrainError;
use crate::encoder::EncoderGraph;
use crate::lstm_op::Sequences;

/// What the names of an encoder's tensors begin with.
const ENCODER: &str = "encoder.";

/// The variables that learn, by tensor name.
#[derive(Clone, Debug)]
pub(crate) struct ActorCritic {
    spec: PolicySpec,
    encoder: EncoderGraph,
    pub(crate) vars: BTreeMap<String, Var>,
}

impl ActorCritic {
    /// Copies parameters into variables; an error if they are those of another specification.
    pub(crate) fn new(
        spec: &PolicySpec,
        parameters: &Parameters,
    ) -> std::result::Result<Self, TrainError> {
        parameters.check(spec)?;
        let mut vars = BTreeMap::new();
        for (name, tensor) in parameters.tensors() {
            vars.insert(name.clone(), Var::from_tensor(&tensor.copy()?)?);
        }
        Ok(Self { spec: spec.clone(), encoder: EncoderGraph::new(spec)?, vars })
    }

    /// Copies the variables' present numbers out, with the given statistics.
    pub(crate) fn parameters(
        &self,
        normalizer: Option<ObservationNormalizer>,
    ) -> std::result::Result<Parameters, TrainError> {
        let mut values = BTreeMap::new();
        for (name, var) in &self.vars {
            values.insert(name.clone(), var.flatten_all()?.to_vec1()?);
        }
        Ok(Parameters::from_values(&self.spec, values, normalizer)?)
    }

    /// Tells whether the encoder learns; if not, observations are the features.
    pub(crate) fn encoder_learns(&self) -> bool {
        self.encoder.learns()
    }

    /// Builds the encoder's graph from observations `[M, D]`, already normalised, to features `[M, F]`.
    ///
    /// A recurrent network takes the samples as whole sequences, one behind the other.
    pub(crate) fn features(
        &self,
        observations: &Tensor,
        sequences: &Arc<Sequences>,
    ) -> Result<Tensor> {
        self.encoder.forward(&self.vars, observations, sequences)
    }

    /// Computes the gradients of the encoder's variables from the loss's slopes in its features, `[M, F]`.
    pub(crate) fn encoder_gradients(
        &self,
        features: &Tensor,
        slopes: &[f32],
    ) -> Result<BTreeMap<String, Tensor>> {
        let mut store = features.apply_op1(LossAbove(slopes.to_vec()))?.backward()?;
        let own = self.vars.iter().filter(|(name, _)| name.starts_with(ENCODER));
        own.map(|(name, var)| match store.remove(var) {
            Some(gradient) => Ok((name.clone(), gradient)),
            None => Ok((name.clone(), var.zeros_like()?)),
        })
        .collect()
    }
}

/// What stands for everything above the features in the graph: a loss of which only its slopes in them count. `[M F]`
struct LossAbove(Vec<f32>);

impl CustomOp1 for LossAbove {
    fn name(&self) -> &'static str {
        "loss-above"
    }

    fn cpu_fwd(&self, _features: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        if layout.shape().elem_count() != self.0.len() {
            candle_core::bail!("{}: slopes and features differ in shape", self.name())
        }
        Ok((CpuStorage::F32(vec![0.0]), Shape::from(())))
    }

    fn bwd(&self, features: &Tensor, _loss: &Tensor, _slope: &Tensor) -> Result<Option<Tensor>> {
        Tensor::from_slice(&self.0, features.shape(), features.device()).map(Some)
    }
}

#[cfg(test)]
#[path = "network_tests.rs"]
mod tests;
