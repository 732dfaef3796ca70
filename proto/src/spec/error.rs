//! Why a specification is impossible.

use thiserror::Error;

use crate::limits;

/// Why a specification is impossible.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum SpecError {
    /// No head, or too many.
    #[error("an action has {n_heads} heads; 1 to {max} are possible", max = limits::MAX_HEADS)]
    Heads {
        /// How many there are.
        n_heads: usize,
    },
    /// Two heads have this name.
    #[error("two heads of an action are `{0}`; each needs a name of its own")]
    SameHead(String),
    /// Two metrics have this name.
    #[error("two metrics are `{0}`; each needs a name of its own")]
    SameMetric(String),
    /// A metric has the name of a number that evaluations compute.
    #[error(
        "a metric is `{0}`, which is the name of a number that evaluations compute themselves; give it another name"
    )]
    ComputedMetric(String),
    /// A head without a choice, or with too many.
    #[error("head `{head}` has {n_choices} choices; 1 to 255 are possible")]
    Choices {
        /// Name of the head, as its environment gives it.
        head: String,
        /// How many choices it has.
        n_choices: usize,
    },
    /// So many choices over all heads.
    #[error("an action has {0} choices in all; at most {max} fit a mask", max = limits::MAX_CHOICES)]
    TotalChoices(usize),
    /// The gate is not a choice of the first head.
    #[error("gate on choice {choice} of head {head}; it must be a choice of head 0")]
    Gate {
        /// Index of the head that the gate is on.
        head: usize,
        /// Index of the gate's choice in that head.
        choice: usize,
    },
    /// A restriction that is out of order, has the wrong shape, or leaves no choice.
    #[error(
        "conditional of head {head} given head {given} is out of order, misshapen, or leaves no choice"
    )]
    Conditional {
        /// Index of the restricted head.
        head: usize,
        /// The head it depends on.
        given: usize,
    },
    /// An ego attention that does not fit the observation.
    #[error(
        "{encoder} does not fit {obs_dim} observed numbers; frames must fit, heads share out the width, two \
         entities be there, and counts be 1 to 1024"
    )]
    Attention {
        /// The encoder with its settings, as `Debug` writes them.
        encoder: String,
        /// Length of the observation.
        obs_dim: usize,
    },
    /// A policy for another observation or other actions than the environment's.
    #[error("the policy is for another observation or other actions than the environment's")]
    Policy,
    /// A rollout of so many steps: none, or too many.
    #[error("a rollout has {0} steps; 1 to {max} are possible", max = limits::MAX_ROLLOUT_STEPS)]
    Steps(u32),
}
