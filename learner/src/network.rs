//! The actor-critic as variables of the engine and its forward graph of fused layers.

use std::collections::BTreeMap;

use candle_core::{Tensor, Var};
use leadtime_policy::architecture::{Layer, Network, layers};
use leadtime_policy::{ObservationNormalizer, Parameters};
use leadtime_proto::{Encoder, PolicySpec};

use crate::TrainError;
use crate::dense_op::DenseOp;
use crate::encoder::AttentionGraph;

/// The variables that learn, by tensor name.
#[derive(Clone, Debug)]
pub(crate) struct ActorCritic {
    spec: PolicySpec,
    encoder: Option<AttentionGraph>,
    actor: Vec<Layer>,
    critic: Vec<Layer>,
    vars: BTreeMap<String, Var>,
}

impl ActorCritic {
    /// Copies parameters into variables.
    pub(crate) fn new(spec: &PolicySpec, parameters: &Parameters) -> Result<Self, TrainError> {
        let mut vars = BTreeMap::new();
        for (name, tensor) in parameters.tensors() {
            vars.insert(name.clone(), Var::from_tensor(&tensor.copy()?)?);
        }
        let (actor, critic) = (layers(spec, Network::Actor), layers(spec, Network::Critic));
        let encoder = match &spec.encoder {
            Encoder::Identity => None,
            Encoder::EgoAttention(attention) => Some(AttentionGraph::new(attention)?),
        };
        Ok(Self { spec: spec.clone(), encoder, actor, critic, vars })
    }

    pub(crate) fn vars(&self) -> &BTreeMap<String, Var> {
        &self.vars
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
    pub(crate) fn forward(&self, observations: &Tensor) -> candle_core::Result<(Tensor, Tensor)> {
        let features = self.encode(observations)?;
        let run = |layers: &[Layer]| {
            let input = features.clone();
            layers.iter().enumerate().try_fold(input, |x, (i, layer)| {
                let input_gradient = i > 0 || self.encoder.is_some();
                let op = DenseOp { activation: layer.activation, input_gradient };
                x.apply_op3(&self.vars[&layer.weight()], &self.vars[&layer.bias()], op)
            })
        };
        Ok((run(&self.actor)?, run(&self.critic)?))
    }

    /// Builds the graph from observations to the features that actor and critic share.
    fn encode(&self, observations: &Tensor) -> candle_core::Result<Tensor> {
        match &self.encoder {
            None => Ok(observations.clone()),
            Some(encoder) => encoder.forward(&self.vars, observations),
        }
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
