//! An actor-critic's architecture: encoder, layers, heads.

use serde::{Deserialize, Serialize};

use super::action::{ActionSpec, EnvSpec};
use super::error::SpecError;

/// How the input becomes the features that the actor's and the critic's stacks see.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Encoder {
    /// None: the observation itself is the features.
    Identity,
    /// A recurrent layer over the steps of an episode, which actor and critic share; its output is the features.
    Lstm {
        /// Width of the tanh layer in front of it; 0: none.
        projection: usize,
        /// Width of the hidden state and of the cell state.
        state: usize,
    },
    /// Each observation of a history becomes what an ego pays attention to in it.
    EgoAttention(EgoAttention),
}

/// Attention of an ego to the entities around it, for a history of observations of entities.
///
/// The input is `n_frames` times (`n_entities` rows of `n_features`, the ego first, each beginning with whether it is
/// there; then `action_dim` numbers that are passed on), and then whatever is left, which is passed on too. All
/// frames share one set of weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EgoAttention {
    /// Observations in the input, the history.
    pub n_frames: usize,
    /// Entities per observation, the ego included (at least 2).
    pub n_entities: usize,
    /// Numbers that describe one entity.
    pub n_features: usize,
    /// Numbers behind each observation: the own action.
    pub action_dim: usize,
    /// Width of the embeddings and of the attention.
    pub width: usize,
    /// Attention heads; they share out the width.
    pub n_heads: usize,
}

impl EgoAttention {
    /// Returns the length of one observation and the action behind it.
    pub fn frame_dim(&self) -> usize {
        self.n_entities * self.n_features + self.action_dim
    }

    /// Returns the width of the features that come of an observation vector; it must have passed [`Self::check`].
    pub fn feature_dim(&self, obs_dim: usize) -> usize {
        let passed_on = obs_dim - self.n_frames * self.n_entities * self.n_features;
        self.n_frames * self.width + passed_on
    }

    /// Checks that it fits an observation vector.
    ///
    /// # Errors
    ///
    /// [`SpecError::Attention`] if a number is out of range, or the frames are longer than the vector.
    pub fn check(&self, obs_dim: usize) -> Result<(), SpecError> {
        let Self { n_frames, n_entities, n_features, action_dim, width, n_heads } = *self;
        let counts = [n_frames, n_entities, n_features, width, n_heads];
        let in_range = counts.iter().all(|count| (1..=1024).contains(count));
        let fits = in_range
            && n_entities > 1
            && action_dim <= 1024
            && width.is_multiple_of(n_heads)
            && n_frames * self.frame_dim() <= obs_dim;
        if fits {
            Ok(())
        } else {
            Err(SpecError::Attention { encoder: format!("{self:?}"), obs_dim })
        }
    }
}

/// Which heads' log-probabilities and entropies count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HeadCredit {
    /// Every head in every step (the paper's sum over heads).
    All,
    /// Heads behind a closed gate do not count: the true likelihood of what was executed.
    Active,
}

/// An actor-critic's architecture: everything that weights need to become a policy.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PolicySpec {
    /// Length of the observation vector.
    pub obs_dim: usize,
    /// What stands between observation and hidden layers.
    pub encoder: Encoder,
    /// Widths of the tanh layers, in the actor and again in the separate critic; none: the heads follow at once.
    pub hidden: Vec<usize>,
    /// The heads of an action: the actor's output is their logits.
    pub actions: ActionSpec,
    /// Whether heads behind a closed gate count in log-probability and entropy.
    pub head_credit: HeadCredit,
    /// Initial bias per logit (all zero: empty); -1 on "initiate" makes an untrained notifier quiet.
    pub logit_bias: Vec<f32>,
    /// Whether observations are normalised by the running statistics that travel with the weights.
    pub normalize_observations: bool,
}

impl PolicySpec {
    /// Describes a plain policy for an environment: dense layers on the observation as it is, every head counts.
    pub fn dense(env: &EnvSpec, hidden: &[usize]) -> Self {
        Self {
            obs_dim: env.obs_dim,
            encoder: Encoder::Identity,
            hidden: hidden.to_vec(),
            actions: env.actions.clone(),
            head_credit: HeadCredit::All,
            logit_bias: Vec::new(),
            normalize_observations: false,
        }
    }

    /// Returns the width of the recurrent state that an actor carries from step to step; 0 if there is none.
    pub fn recurrent_dim(&self) -> usize {
        match self.encoder {
            Encoder::Identity | Encoder::EgoAttention(_) => 0,
            // Hidden state and cell state.
            Encoder::Lstm { state, .. } => 2 * state,
        }
    }

    /// Checks that encoder and heads fit the observation.
    ///
    /// # Errors
    ///
    /// [`SpecError`] if the heads fail [`ActionSpec::check`], or an ego attention does not fit the length of the
    /// observation.
    pub fn check(&self) -> Result<(), SpecError> {
        self.actions.check()?;
        match &self.encoder {
            Encoder::Identity | Encoder::Lstm { .. } => Ok(()),
            Encoder::EgoAttention(attention) => attention.check(self.obs_dim),
        }
    }
}
