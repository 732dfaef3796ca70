//! The actor-critic as variables of the engine and its forward graph of fused layers.

use std::collections::BTreeMap;

use candle_core::{Tensor, Var};
use leadtime_numerics::kernel::Activation;
use leadtime_policy::architecture::{Layer, Network, layers};
use leadtime_policy::{ObservationNormalizer, Parameters};
use leadtime_proto::PolicySpec;

use crate::TrainError;
use crate::dense_op::DenseOp;

/// The variables that learn, by tensor name.
#[derive(Clone, Debug)]
pub(crate) struct ActorCritic {
    spec: PolicySpec,
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
        Ok(Self { spec: spec.clone(), actor, critic, vars })
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

    /// Builds the graph from features `[M, D]` to logits `[M, C]` and values `[M, 1]`.
    pub(crate) fn forward(&self, features: &Tensor) -> candle_core::Result<(Tensor, Tensor)> {
        let run = |layers: &[Layer]| {
            let input = features.clone();
            layers.iter().enumerate().try_fold(input, |x, (i, layer)| {
                let activation = if layer.tanh { Activation::Tanh } else { Activation::Linear };
                let op = DenseOp { activation, input_gradient: i > 0 };
                x.apply_op3(&self.vars[&layer.weight()], &self.vars[&layer.bias()], op)
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
