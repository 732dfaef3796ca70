//! The actor-critic as variables of the engine and its forward graph of fused layers.

use std::collections::BTreeMap;
use std::sync::Arc;

use candle_core::{Tensor, Var};
use leadtime_policy::architecture::{Branch, Layer, layers};
use leadtime_policy::{ObservationNormalizer, Parameters};
use leadtime_proto::PolicySpec;

use crate::TrainError;
use crate::encoder::{EncoderGraph, dense};
use crate::lstm_op::Sequences;

/// The variables that learn, by tensor name.
#[derive(Clone, Debug)]
pub(crate) struct ActorCritic {
    spec: PolicySpec,
    encoder: EncoderGraph,
    actor: Vec<Layer>,
    critic: Vec<Layer>,
    pub(crate) vars: BTreeMap<String, Var>,
}

impl ActorCritic {
    /// Copies parameters into variables; an error if they are those of another specification.
    pub(crate) fn new(spec: &PolicySpec, parameters: &Parameters) -> Result<Self, TrainError> {
        parameters.check(spec)?;
        let mut vars = BTreeMap::new();
        for (name, tensor) in parameters.tensors() {
            vars.insert(name.clone(), Var::from_tensor(&tensor.copy()?)?);
        }
        let (actor, critic) = (layers(spec, Branch::Actor), layers(spec, Branch::Critic));
        let encoder = EncoderGraph::new(spec)?;
        Ok(Self { spec: spec.clone(), encoder, actor, critic, vars })
    }

    /// Copies the variables' present numbers out, with the given statistics.
    pub(crate) fn parameters(
        &self,
        normalizer: Option<ObservationNormalizer>,
    ) -> Result<Parameters, TrainError> {
        let mut values = BTreeMap::new();
        for (name, var) in &self.vars {
            values.insert(name.clone(), var.flatten_all()?.to_vec1()?);
        }
        Ok(Parameters::from_values(&self.spec, values, normalizer)?)
    }

    /// Builds the graph from observations `[M, D]`, already normalised, to logits `[M, C]` and values `[M, 1]`.
    ///
    /// A recurrent network takes the samples as whole sequences, one behind the other.
    pub(crate) fn forward(
        &self,
        observations: &Tensor,
        sequences: &Arc<Sequences>,
    ) -> candle_core::Result<(Tensor, Tensor)> {
        let features = self.encoder.forward(&self.vars, observations, sequences)?;
        let learns = self.encoder.learns();
        let run = |layers: &[Layer]| {
            layers.iter().enumerate().try_fold(features.clone(), |x, (i, layer)| {
                dense(&self.vars, &x, layer, learns || i > 0)
            })
        };
        Ok((run(&self.actor)?, run(&self.critic)?))
    }

    /// Collects the gradients of all variables in the order of names.
    pub(crate) fn gradients(&self, loss: &Tensor) -> candle_core::Result<BTreeMap<String, Tensor>> {
        let mut store = loss.backward()?;
        let gradient = |(name, var): (&String, &Var)| match store.remove(var) {
            Some(gradient) => Ok((name.clone(), gradient)),
            None => Ok((name.clone(), var.zeros_like()?)),
        };
        self.vars.iter().map(gradient).collect()
    }
}

#[cfg(test)]
#[path = "network_tests.rs"]
mod tests;
