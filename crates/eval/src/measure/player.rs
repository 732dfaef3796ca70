//! Who decides in an evaluation.

use leadtime_numerics::Pcg64;
use leadtime_policy::{ActionDistribution, Parameters, Policy};
use leadtime_proto::{EnvSpec, PolicySpec};
use leadtime_sims::Environment;
use serde::{Deserialize, Serialize};

use crate::error::Error;

/// How a policy's distribution becomes an action.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Choice {
    /// It is sampled, as in training.
    #[default]
    Sample,
    /// The likeliest choice of each head is taken.
    Greedy,
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
    Baseline { script: String },
}

impl Player {
    /// Lets a policy decide.
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

    /// Lets a freshly initialised network decide: what training started from.
    ///
    /// # Errors
    ///
    /// [`Error::Policy`] if the architecture is impossible.
    pub fn untrained(spec: &PolicySpec, run_seed: u64, choice: Choice) -> Result<Self, Error> {
        let parameters = Parameters::initialize(spec, run_seed)?;
        Self::policy("untrained", spec, &parameters, choice)
    }

    /// Lets one of the task's scripts decide ([`Environment::baselines`]).
    pub fn baseline(script: &str) -> Self {
        let kind = Kind::Baseline { script: script.to_owned() };
        Self { name: script.to_owned(), kind }
    }

    /// Gives the player another name.
    pub fn named(self, name: &str) -> Self {
        Self { name: name.to_owned(), ..self }
    }

    /// Returns the name that tables give the player.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Checks that the player can play this task.
    ///
    /// # Errors
    ///
    /// [`Error::PolicyShape`] or [`Error::UnknownBaseline`].
    pub fn check(&self, environment: &dyn Environment) -> Result<(), Error> {
        match &self.kind {
            Kind::Policy { policy, .. } => check_shape(policy, environment.spec()),
            Kind::Baseline { script } => {
                let known = environment.baselines();
                if known.contains(&script.as_str()) {
                    return Ok(());
                }
                Err(Error::UnknownBaseline { name: script.clone(), known })
            }
        }
    }

    /// Returns the width of what the policy's heads see; 0 for a script.
    pub(crate) fn hidden_dim(&self) -> usize {
        match &self.kind {
            Kind::Policy { policy, .. } => policy.hidden_dim(),
            Kind::Baseline { .. } => 0,
        }
    }

    /// Returns the width of the state carried from step to step.
    pub(crate) fn recurrent_dim(&self) -> usize {
        match &self.kind {
            Kind::Policy { policy, .. } => policy.recurrent_dim(),
            Kind::Baseline { .. } => 0,
        }
    }
}

fn check_shape(policy: &Policy, task: &EnvSpec) -> Result<(), Error> {
    let found = [policy.obs_dim(), policy.n_choices()];
    let expected = [task.obs_dim, task.actions.n_choices()];
    if found == expected { Ok(()) } else { Err(Error::PolicyShape { found, expected }) }
}

/// A player at work on a batch of episodes: its own copy of the network, and room for the outputs.
#[derive(Clone, Debug)]
pub(crate) struct Acting {
    player: Player,
    logits: Vec<f32>,
    values: Vec<f32>,
}

impl Acting {
    pub(crate) fn new(player: &Player) -> Self {
        Self { player: player.clone(), logits: Vec::new(), values: Vec::new() }
    }

    /// Thinks about `n` situations at once; must come before [`Acting::choose`].
    ///
    /// # Shapes
    ///
    /// `observations`: `[n, D]`; `recurrent`: `[n, S]`.
    pub(crate) fn think(&mut self, observations: &[f32], recurrent: &mut [f32], n: usize) {
        let Kind::Policy { policy, .. } = &mut self.player.kind else { return };
        self.logits.resize(n * policy.n_choices(), 0.0);
        self.values.resize(n, 0.0);
        policy.evaluate(observations, recurrent, &mut self.logits, &mut self.values);
    }

    /// Writes what the policy's heads see in one situation; the recurrent state is that before the step.
    ///
    /// # Shapes
    ///
    /// `observation`: `[D]`; `recurrent`: `[S]`; `out`: `[hidden_dim]`.
    pub(crate) fn hidden(&mut self, observation: &[f32], recurrent: &[f32], out: &mut [f32]) {
        if let Kind::Policy { policy, .. } = &mut self.player.kind {
            policy.hidden(observation, recurrent, out);
        }
    }

    /// Decides in situation `row` of the batch.
    pub(crate) fn choose(
        &self,
        row: usize,
        environment: &dyn Environment,
        generator: &mut Pcg64,
        action: &mut [u8],
    ) {
        match &self.player.kind {
            Kind::Policy { distribution, choice, .. } => {
                let width = distribution.n_choices();
                let logits = &self.logits[row * width..(row + 1) * width];
                let mask = environment.mask();
                match choice {
                    Choice::Sample => distribution.sample(logits, mask, generator, action),
                    Choice::Greedy => distribution.greedy(logits, mask, action),
                };
            }
            Kind::Baseline { script } => {
                let known = environment.baseline_action(script, action);
                debug_assert!(known, "`Player::check` comes first");
            }
        }
    }
}
