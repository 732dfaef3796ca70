//! What an environment asks for and what a policy is: shapes, factored action heads, masks.
//!
//! An action is a tuple with one choice per **head**; for a notifier (initiate, topic, k, l). The heads are sampled
//! in order. Three rules shape the joint distribution, and actor and learner apply the same three:
//!
//! * the environment's **mask** of this step removes choices (a message may not start now);
//! * a [`Conditional`] removes choices of one head given an earlier head's choice (l >= k);
//! * a [`Gate`] says when the other heads matter at all (only when a message starts); with
//!   [`HeadCredit::Active`] heads behind a closed gate add nothing to log-probability and entropy.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::limits;

/// One categorical part of an action.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Head {
    /// What is chosen, for logs and metadata.
    pub name: String,
    /// How many choices there are, 1..=255.
    pub n_choices: usize,
}

/// Says that heads other than `head` matter only when `head` took `choice`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Gate {
    /// Index of the deciding head; it comes first.
    pub head: usize,
    /// The choice that makes the other heads matter.
    pub choice: usize,
}

/// Restricts the choices of `head` given the choice of an earlier head.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Conditional {
    /// The restricted head.
    pub head: usize,
    /// The earlier head that decides.
    pub given: usize,
    /// Per choice of `given`: the allowed choices of `head`, bit `i` for choice `i`; never empty.
    pub allowed: Vec<u64>,
}

/// The choices that an environment offers in one step: bit `offset(head) + choice`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Mask(pub u64);

impl Mask {
    /// Offers every choice.
    pub const ALL: Self = Self(u64::MAX);

    /// Returns the offered choices of the head that starts at `offset`, bit 0 for its first choice.
    pub fn of_head(self, offset: usize, n_choices: usize) -> u64 {
        (self.0 >> offset) & bits(n_choices)
    }
}

/// Returns a word whose lowest `n` bits are set.
fn bits(n: usize) -> u64 {
    if n >= 64 { u64::MAX } else { (1 << n) - 1 }
}

/// The factored, conditional action space of an environment.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ActionSpec {
    /// The heads in sampling order.
    pub heads: Vec<Head>,
    /// When heads matter; `None`: always.
    pub gate: Option<Gate>,
    /// Restrictions between heads, at most one per restricted head.
    pub conditionals: Vec<Conditional>,
}

impl ActionSpec {
    /// Describes a single plain choice out of `n_choices`, as in classic control.
    pub fn discrete(name: &str, n_choices: usize) -> Self {
        let heads = vec![Head { name: name.to_owned(), n_choices }];
        Self { heads, gate: None, conditionals: Vec::new() }
    }

    /// Returns the number of choices over all heads: the width of the logits.
    pub fn n_choices(&self) -> usize {
        self.heads.iter().map(|head| head.n_choices).sum()
    }

    /// Returns where each head's choices start in the logits and in a [`Mask`].
    pub fn offsets(&self) -> Vec<usize> {
        let mut next = 0;
        let starts = self.heads.iter().map(|head| {
            let start = next;
            next += head.n_choices;
            start
        });
        starts.collect()
    }

    /// Checks that the heads, gate and conditionals fit together.
    ///
    /// # Errors
    ///
    /// [`SpecError`] naming the first thing that does not.
    pub fn check(&self) -> Result<(), SpecError> {
        let n_heads = self.heads.len();
        if !(1..=limits::MAX_HEADS).contains(&n_heads) {
            return Err(SpecError::Heads { n_heads });
        }
        if let Some(head) = self.heads.iter().find(|h| !(1..=255).contains(&h.n_choices)) {
            return Err(SpecError::Choices { head: head.name.clone(), n_choices: head.n_choices });
        }
        if self.n_choices() > limits::MAX_CHOICES {
            return Err(SpecError::TotalChoices { n_choices: self.n_choices() });
        }
        if let Some(gate) = self.gate
            && (gate.head != 0 || gate.choice >= self.heads[0].n_choices)
        {
            return Err(SpecError::Gate { head: gate.head, choice: gate.choice });
        }
        self.conditionals.iter().try_for_each(|rule| self.check_conditional(rule))
    }

    fn check_conditional(&self, rule: &Conditional) -> Result<(), SpecError> {
        let error = SpecError::Conditional { head: rule.head, given: rule.given };
        if rule.head >= self.heads.len() || rule.given >= rule.head {
            return Err(error);
        }
        let choices = bits(self.heads[rule.head].n_choices);
        let right_len = rule.allowed.len() == self.heads[rule.given].n_choices;
        let twice = self.conditionals.iter().filter(|other| other.head == rule.head).count() > 1;
        if !right_len || twice || rule.allowed.iter().any(|allowed| allowed & choices == 0) {
            return Err(error);
        }
        Ok(())
    }

    /// Tells whether an action of one choice per head is one that could have been sampled under `mask`.
    ///
    /// Heads behind a closed gate are still sampled, so they are still checked.
    pub fn allows(&self, mask: Mask, action: &[u8]) -> bool {
        let offsets = self.offsets();
        action.len() == self.heads.len()
            && (0..action.len()).all(|h| {
                let choice = usize::from(action[h]);
                choice < self.heads[h].n_choices
                    && self.allowed(h, &offsets, mask, action) >> choice & 1 == 1
            })
    }

    /// Returns the allowed choices of head `h` given the mask and the earlier heads' choices.
    ///
    /// Where mask and conditional leave nothing, the conditional alone decides: an environment that offers an
    /// impossible combination must not bring a run down.
    pub fn allowed(&self, h: usize, offsets: &[usize], mask: Mask, action: &[u8]) -> u64 {
        let n_choices = self.heads[h].n_choices;
        let offered = mask.of_head(offsets[h], n_choices);
        let rule = self.conditionals.iter().find(|rule| rule.head == h);
        let conditional = rule.map_or(bits(n_choices), |rule| {
            rule.allowed[usize::from(action[rule.given])] & bits(n_choices)
        });
        if offered & conditional == 0 { conditional } else { offered & conditional }
    }
}

/// Why an action space is impossible.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum SpecError {
    /// No head, or too many.
    #[error("an action has {n_heads} heads; 1 to {max} are possible", max = limits::MAX_HEADS)]
    Heads {
        /// How many there are.
        n_heads: usize,
    },
    /// A head without a choice, or with too many.
    #[error("head `{head}` has {n_choices} choices; 1 to 255 are possible")]
    Choices {
        /// The head's name.
        head: String,
        /// How many choices it has.
        n_choices: usize,
    },
    /// Too many choices over all heads.
    #[error("an action has {n_choices} choices in all; at most {max} fit a mask", max = limits::MAX_CHOICES)]
    TotalChoices {
        /// How many there are.
        n_choices: usize,
    },
    /// The gate is not a choice of the first head.
    #[error("gate on choice {choice} of head {head}; it must be a choice of head 0")]
    Gate {
        /// The gate's head.
        head: usize,
        /// The gate's choice.
        choice: usize,
    },
    /// A restriction that is out of order, has the wrong shape, or leaves no choice.
    #[error(
        "conditional of head {head} given head {given} is out of order, misshapen, or leaves no choice"
    )]
    Conditional {
        /// The restricted head.
        head: usize,
        /// The head it depends on.
        given: usize,
    },
    /// An ego attention that does not fit the observation.
    #[error(
        "{encoder:?} does not fit {obs_dim} observed numbers; frames must fit, heads share out the width, two \
         entities be there, and counts be 1 to 1024"
    )]
    Attention {
        /// The encoder.
        encoder: EgoAttention,
        /// Length of the observation.
        obs_dim: usize,
    },
}

/// What an environment asks of a policy and tells about itself.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EnvSpec {
    /// Length of an observation vector.
    pub obs_dim: usize,
    /// The action space.
    pub actions: ActionSpec,
    /// Names of the metrics in an episode's summary, in order; `success` first where there is such a thing.
    pub metrics: Vec<String>,
}

/// How the input becomes the features that the actor's and the critic's stacks see.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Encoder {
    /// The observation itself.
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
    /// Numbers per entity.
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
        if fits { Ok(()) } else { Err(SpecError::Attention { encoder: *self, obs_dim }) }
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
    /// The heads.
    pub actions: ActionSpec,
    /// Which heads count.
    pub head_credit: HeadCredit,
    /// Initial bias per logit (all zero: empty); -1 on "initiate" makes an untrained notifier quiet.
    pub logit_bias: Vec<f32>,
    /// Whether observations are normalised by the running statistics that travel with the weights.
    pub normalize_observations: bool,
}

impl PolicySpec {
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
    /// [`SpecError`] naming the first thing that does not.
    pub fn check(&self) -> Result<(), SpecError> {
        self.actions.check()?;
        match &self.encoder {
            Encoder::Identity | Encoder::Lstm { .. } => Ok(()),
            Encoder::EgoAttention(attention) => attention.check(self.obs_dim),
        }
    }
}

/// Which task, with which settings; only the crate that builds the task understands the settings.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskSpec {
    /// The domain's name: `lander`, `pilot`, `cartpole` or one of the user's own; part of keys and file names.
    pub domain: String,
    /// The checked settings as JSON.
    pub settings: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn notifier() -> ActionSpec {
        let head = |name: &str, n_choices| Head { name: name.to_owned(), n_choices };
        let allowed = vec![0b1111, 0b1110, 0b1100, 0b1000];
        ActionSpec {
            heads: vec![head("initiate", 2), head("topic", 4), head("k", 4), head("l", 4)],
            gate: Some(Gate { head: 0, choice: 1 }),
            conditionals: vec![Conditional { head: 3, given: 2, allowed }],
        }
    }

    #[test]
    fn a_message_is_never_shorter_than_its_comprehension() {
        let spec = notifier();
        spec.check().unwrap();
        assert!(spec.allows(Mask::ALL, &[1, 0, 2, 2]));
        assert!(!spec.allows(Mask::ALL, &[1, 0, 2, 1]));
    }

    #[test]
    fn attention_fits_its_observation() {
        let attention = EgoAttention {
            n_frames: 4,
            n_entities: 10,
            n_features: 7,
            action_dim: 13,
            width: 64,
            n_heads: 2,
        };
        // Four frames of 10 x 7 numbers and an action of 13, then the utterance's status of 5.
        attention.check(337).unwrap();
        assert_eq!(attention.feature_dim(337), 4 * (64 + 13) + 5);
        assert_eq!(
            attention.check(331),
            Err(SpecError::Attention { encoder: attention, obs_dim: 331 })
        );
        EgoAttention { n_heads: 3, ..attention }.check(337).unwrap_err();
        EgoAttention { n_frames: usize::MAX, ..attention }.check(337).unwrap_err();
    }

    #[test]
    fn a_mask_removes_choices() {
        let silent = Mask(!0b10);
        assert!(!notifier().allows(silent, &[1, 0, 0, 0]));
        assert!(notifier().allows(silent, &[0, 0, 0, 0]));
    }

    #[test]
    fn impossible_action_spaces_are_named() {
        let mut spec = notifier();
        spec.conditionals[0].allowed[3] = 0;
        assert_eq!(spec.check(), Err(SpecError::Conditional { head: 3, given: 2 }));
        let mut spec = notifier();
        spec.gate = Some(Gate { head: 1, choice: 0 });
        assert_eq!(spec.check(), Err(SpecError::Gate { head: 1, choice: 0 }));
        assert_eq!(
            ActionSpec::discrete("a", 65).check(),
            Err(SpecError::TotalChoices { n_choices: 65 })
        );
    }
}
