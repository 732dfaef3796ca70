//! What an environment asks of a policy: its factored, conditional action space and which choices a step offers.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use super::error::SpecError;
use crate::limits;

/// Names of what evaluations compute of rewards, steps and metrics: no metric of a task has one of these. The two shares of
/// messages that were followed are not among them: notifier tasks report them while they train.
pub const COMPUTED: [&str; 12] = [
    "return",
    "length",
    "averted",
    "harmed",
    "lead_time",
    "first_l",
    "later_l",
    "per_step_before_hazard",
    "per_step_after_hazard",
    "long_rate",
    "preempted_rate",
    "overwritten_rate",
];

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
    /// Index of the restricted head.
    pub head: usize,
    /// The earlier head that decides.
    pub given: usize,
    /// Per choice of `given`: the allowed choices of `head`, bit `i` for choice `i`; never empty.
    pub allowed: Vec<u64>,
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
            next += head.n_choices;
            next - head.n_choices
        });
        starts.collect()
    }

    /// Checks that the heads, gate and conditionals fit together.
    ///
    /// # Errors
    ///
    /// [`SpecError`] for the first fault that is found: if there are no heads or too many, two of one name, a head without a
    /// choice, too many choices in all, a gate that is no choice of the first head, or a conditional that is out of order, has the
    /// wrong length or leaves no choice.
    pub fn check(&self) -> Result<(), SpecError> {
        let n_heads = self.heads.len();
        if !(1..=limits::MAX_HEADS).contains(&n_heads) {
            return Err(SpecError::Heads { n_heads });
        }
        if let Some(name) = repeated(self.heads.iter().map(|head| &head.name)) {
            return Err(SpecError::SameHead(name.clone()));
        }
        if let Some(head) = self.heads.iter().find(|h| !(1..=255).contains(&h.n_choices)) {
            return Err(SpecError::Choices { head: head.name.clone(), n_choices: head.n_choices });
        }
        if self.n_choices() > limits::MAX_CHOICES {
            return Err(SpecError::TotalChoices(self.n_choices()));
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

    /// Returns whether an action of one choice per head is one that could have been sampled under `mask`.
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

/// The choices that an environment offers in one step: bit `offset(head) + choice`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Mask(pub u64);

impl Mask {
    /// Offers every choice of every head.
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

/// What an environment asks of a policy and states about itself.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EnvSpec {
    /// Length of an observation vector.
    pub obs_dim: usize,
    /// The heads of an action, and how they depend on each other.
    pub actions: ActionSpec,
    /// Names of the metrics in an episode's summary, in order; `success` first where there is such a thing.
    pub metrics: Vec<String>,
}

impl EnvSpec {
    /// Checks the action space, and that reports can tell the metrics apart.
    ///
    /// # Errors
    ///
    /// [`SpecError`] as for [`ActionSpec::check`] and [`EnvSpec::check_metrics`].
    pub fn check(&self) -> Result<(), SpecError> {
        self.actions.check()?;
        Self::check_metrics(&self.metrics)
    }

    /// Checks that no two metrics have one name, and none that of a number which evaluations compute themselves.
    ///
    /// # Errors
    ///
    /// [`SpecError::SameMetric`] or [`SpecError::ComputedMetric`].
    pub fn check_metrics(names: &[String]) -> Result<(), SpecError> {
        if let Some(name) = repeated(names.iter()) {
            return Err(SpecError::SameMetric(name.clone()));
        }
        match names.iter().find(|name| COMPUTED.contains(&name.as_str())) {
            Some(name) => Err(SpecError::ComputedMetric(name.clone())),
            None => Ok(()),
        }
    }
}

/// Returns the first name that is there a second time.
fn repeated<'a>(mut names: impl Iterator<Item = &'a String>) -> Option<&'a String> {
    let mut seen = BTreeSet::new();
    names.find(|name| !seen.insert(*name))
}
