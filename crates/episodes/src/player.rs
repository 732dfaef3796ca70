//! Who decides: a policy or one of the task's scripts.

use leadtime_policy::{ActionDistribution, Parameters, Policy};
use leadtime_proto::PolicySpec;
use leadtime_sims::Environment;
use serde::{Deserialize, Serialize};

use crate::error::Error;
use crate::scripted::Scripted;

/// How a policy's distribution becomes an action.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Choice {
    /// The action is sampled, as in training.
    #[default]
    Sample,
    /// Each head takes its likeliest choice.
    Greedy,
}

/// What decides in a step of [`crate::Lockstep`].
#[derive(Debug)]
pub enum Decider<'a> {
    /// A policy, and how its distribution becomes an action.
    Policy {
        /// The network with its weights.
        policy: &'a mut Policy,
        /// The distribution that its logits parametrise.
        distribution: &'a ActionDistribution,
        /// How an action is chosen.
        choice: Choice,
    },
    /// A script of the task, one of [`Environment::baselines`].
    Script(&'a str),
    /// A script that is no part of the task.
    Scripted(&'a mut dyn Scripted),
}

/// A policy or a scripted player, with the name that tables give it.
#[derive(Clone, Debug)]
pub struct Player {
    name: String,
    kind: Kind,
}

#[derive(Clone, Debug)]
enum Kind {
    Policy { policy: Box<Policy>, distribution: ActionDistribution, choice: Choice },
    Script(String),
    Scripted(Box<dyn Scripted>),
}

impl Player {
    /// Makes a player of a policy.
    ///
    /// # Errors
    ///
    /// [`Error::Policy`] if the parameters are not those of this architecture.
    pub fn policy(
        name: &str,
        spec: &PolicySpec,
        parameters: &Parameters,
        choice: Choice,
    ) -> Result<Self, Error> {
        let policy = Box::new(Policy::new(spec, parameters)?);
        let distribution = ActionDistribution::new(&spec.actions, spec.head_credit);
        Ok(Self { name: name.to_owned(), kind: Kind::Policy { policy, distribution, choice } })
    }

    /// Makes a player of a freshly initialised network: what training started from.
    ///
    /// # Errors
    ///
    /// [`Error::Policy`] if no network can be built from the specification.
    pub fn untrained(spec: &PolicySpec, run_seed: u64, choice: Choice) -> Result<Self, Error> {
        let parameters = Parameters::initialize(spec, run_seed)?;
        Self::policy("untrained", spec, &parameters, choice)
    }

    /// Makes a player of one of the task's scripts ([`Environment::baselines`]).
    pub fn baseline(script: &str) -> Self {
        Self { name: script.to_owned(), kind: Kind::Script(script.to_owned()) }
    }

    /// Makes a player of a script that is no part of the task.
    pub fn scripted(name: &str, script: Box<dyn Scripted>) -> Self {
        Self { name: name.to_owned(), kind: Kind::Scripted(script) }
    }

    /// Gives the player another name.
    pub fn named(self, name: &str) -> Self {
        Self { name: name.to_owned(), ..self }
    }

    /// Returns the name that tables give the player.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns whether the player is the script of that name.
    pub fn is_script(&self, name: &str) -> bool {
        matches!(&self.kind, Kind::Script(script) if script == name)
    }

    /// Checks that the player can play this task.
    ///
    /// # Errors
    ///
    /// [`Error::PolicyShape`] if a policy's shape is not the task's; [`Error::UnknownBaseline`] if the task has no such
    /// script; [`Error::Script`] if a script does not fit it.
    pub fn check(&self, environment: &dyn Environment) -> Result<(), Error> {
        match &self.kind {
            Kind::Policy { policy, .. } => {
                let task = environment.spec();
                let found = [policy.obs_dim(), policy.n_choices()];
                let expected = [task.obs_dim, task.actions.n_choices()];
                if found == expected { Ok(()) } else { Err(Error::PolicyShape { found, expected }) }
            }
            Kind::Script(name) => {
                let (name, known) = (name.clone(), environment.baselines());
                let is_known = known.contains(&name.as_str());
                if is_known { Ok(()) } else { Err(Error::UnknownBaseline { name, known }) }
            }
            Kind::Scripted(script) => {
                let refused = |source| Error::Script { name: self.name.clone(), source };
                script.check(environment).map_err(refused)
            }
        }
    }

    /// Returns the width of what the policy's heads see; 0 for a script.
    pub fn hidden_dim(&self) -> usize {
        self.network().map_or(0, Policy::hidden_dim)
    }

    /// Returns the width of the state carried from step to step; 0 for a script of the task.
    pub fn recurrent_dim(&self) -> usize {
        match &self.kind {
            Kind::Policy { policy, .. } => policy.recurrent_dim(),
            Kind::Script(_) => 0,
            Kind::Scripted(script) => script.memory_dim(),
        }
    }

    fn network(&self) -> Option<&Policy> {
        match &self.kind {
            Kind::Policy { policy, .. } => Some(policy),
            Kind::Script(_) | Kind::Scripted(_) => None,
        }
    }

    /// Returns what decides, borrowed for one run of slots.
    pub fn decider(&mut self) -> Decider<'_> {
        match &mut self.kind {
            Kind::Policy { policy, distribution, choice } => {
                Decider::Policy { policy, distribution, choice: *choice }
            }
            Kind::Script(script) => Decider::Script(script),
            Kind::Scripted(script) => Decider::Scripted(script.as_mut()),
        }
    }
}
