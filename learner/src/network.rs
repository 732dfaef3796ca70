//! The actor-critic as variables of the engine and its forward graph of fused layers.

use std::collections::BTreeMap;
use std::sync::Arc;

use candle_core::{Tensor, Var};
use leadtime_numerics::kernel::Activation;
use leadtime_policy::architecture::{Layer, Network, encoder_layers, layers};
use leadtime_policy::{ObservationNormalizer, Parameters};
use leadtime_proto::{Encoder, PolicySpec};

use crate::TrainError;
use crate::dense_op::DenseOp;
use crate::lstm_op::{LstmOp, Sequences};

/// The variables that learn, by tensor name.
#[derive(Clone, Debug)]
pub(crate) struct ActorCritic {
    spec: PolicySpec,
    encoder: Vec<Layer>,
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
        Ok(Self { spec: spec.clone(), encoder: encoder_layers(spec), actor, critic, vars })
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

    /// Builds the graph from observations `[M, D]` to logits `[M, C]` and values `[M, 1]`.
    ///
    /// A recurrent network takes the samples as whole sequences, one behind the other.
    pub(crate) fn forward(
        &self,
        observations: &Tensor,
        sequences: &Arc<Sequences>,
    ) -> candle_core::Result<(Tensor, Tensor)> {
        let features = self.encode(observations, sequences)?;
        let learns = !self.encoder.is_empty();
        let run = |layers| self.stack(layers, &features, learns);
        Ok((run(&self.actor)?, run(&self.critic)?))
    }

    /// Builds the encoder's graph: from observations `[M, D]` to features `[M, F]`.
    fn encode(&self, x: &Tensor, sequences: &Arc<Sequences>) -> candle_core::Result<Tensor> {
        let (Encoder::Lstm { state: width, .. }, Some((state, before))) =
            (self.spec.encoder, self.encoder.split_last())
        else {
            return Ok(x.clone());
        };
        let gates = self.stack(before, x, false)?;
        let op = LstmOp::new(Arc::clone(sequences), width);
        gates.apply_op3(&self.vars[&state.weight()], &self.vars[&state.bias()], op)
    }

    /// Runs layers one behind the other; `learns`: something upstream wants a gradient.
    fn stack(&self, layers: &[Layer], x: &Tensor, learns: bool) -> candle_core::Result<Tensor> {
        layers.iter().enumerate().try_fold(x.clone(), |x, (i, layer)| {
            let activation = if layer.tanh { Activation::Tanh } else { Activation::Linear };
            let op = DenseOp { activation, input_gradient: learns || i > 0 };
            x.apply_op3(&self.vars[&layer.weight()], &self.vars[&layer.bias()], op)
        })
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
