//! The actor-critic's parameters as variables of the engine.

use std::collections::BTreeMap;

use candle_core::Var;
use leadtime_policy::{ObservationNormalizer, Parameters};
use leadtime_proto::PolicySpec;

use crate::TrainError;

/// The variables that learn, by tensor name.
#[derive(Clone, Debug)]
pub(crate) struct ActorCritic {
    spec: PolicySpec,
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
        Ok(Self { spec: spec.clone(), vars })
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
}
