//! Everything that a trainer's future depends on, as plain data for a checkpoint.

use std::collections::BTreeMap;

use leadtime_policy::{ObservationNormalizer, Parameters};
use leadtime_proto::{EnvId, PolicyVersion, packed};
use serde::{Deserialize, Serialize};

use crate::TrainError;
use crate::adam::{Adam, Moments};
use crate::network::ActorCritic;
use crate::rewards::ReturnNormalizer;
use crate::trainer::Trainer;

/// A tensor's numbers as their bytes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
struct Numbers(#[serde(with = "packed")] Vec<f32>);

/// A parameter tensor and the optimiser's moments of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct SavedTensor {
    values: Numbers,
    first_moment: Numbers,
    second_moment: Numbers,
}

/// A trainer's state between two updates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainerState {
    version: PolicyVersion,
    parameters: BTreeMap<String, SavedTensor>,
    powers: [f64; 2],
    observations: Option<ObservationNormalizer>,
    rewards: ReturnNormalizer,
}

impl TrainerState {
    /// Returns the version of the policy in it.
    pub fn version(&self) -> PolicyVersion {
        self.version
    }

    /// Notes the same as [`Trainer::forget_episode`], for a trainer that goes on from here.
    pub fn forget_episode(&mut self, env_id: EnvId) {
        self.rewards.forget(env_id);
    }
}

impl Trainer {
    /// Copies the trainer's state.
    ///
    /// # Errors
    ///
    /// [`TrainError`] if the engine cannot read a tensor.
    pub fn state(&self) -> Result<TrainerState, TrainError> {
        let mut parameters = BTreeMap::new();
        for (name, moments) in &self.adam.moments {
            let entry = SavedTensor {
                values: Numbers(self.parameters.values(name)?),
                first_moment: Numbers(moments.first.clone()),
                second_moment: Numbers(moments.second.clone()),
            };
            parameters.insert(name.clone(), entry);
        }
        Ok(TrainerState {
            version: self.version,
            parameters,
            powers: self.adam.powers,
            observations: self.observations.clone(),
            rewards: self.rewards.clone(),
        })
    }

    /// Goes back (or on) to a state; what follows is as if it had never been left.
    ///
    /// # Errors
    ///
    /// [`TrainError`] if the state belongs to another architecture; the trainer is then as it was.
    pub fn restore(&mut self, state: TrainerState) -> Result<(), TrainError> {
        let mut values = BTreeMap::new();
        let mut moments = BTreeMap::new();
        for (name, entry) in state.parameters {
            let (first, second) = (entry.first_moment.0, entry.second_moment.0);
            if first.len() != entry.values.0.len() || second.len() != first.len() {
                return Err(TrainError::State { what: name });
            }
            moments.insert(name.clone(), Moments { first, second });
            values.insert(name, entry.values.0);
        }
        let parameters =
            Parameters::from_values(&self.policy_spec, values, state.observations.clone())?;
        self.network = ActorCritic::new(&self.policy_spec, &parameters)?;
        self.parameters = parameters;
        self.adam = Adam { moments, powers: state.powers };
        self.version = state.version;
        self.observations = state.observations;
        self.rewards = state.rewards;
        Ok(())
    }
}
