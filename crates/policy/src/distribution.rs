//! The joint distribution over factored actions: sampled by actors, evaluated by the learner, with the same code.
//!
//! Heads are categorical and come in order; the environment's mask and the choices of earlier heads decide which
//! choices a head has left (`l >= k`), so the learner rebuilds each head's support from the stored choices. A gate and
//! [`HeadCredit::Active`] decide which heads count: with `w_h` 1 or 0,
//!
//! ```text
//! log π(a) = Σ_h w_h log p_h(a_h)        H = Σ_h w_h H(p_h)        p_h over the choices left to head h given a
//! ```
//!
//! Every head is sampled in every step, counted or not: so the number of draws is always the number of heads.
//!
//! # Where to start
//!
//! [`ActionDistribution::sample`] for acting; [`ActionDistribution::terms`] and [`ActionTerms::gradient`] for learning.

#![expect(
    clippy::inline_always,
    reason = "the learner compiles terms and gradients inside its dispatched target features"
)]

use std::ops::Range;

use leadtime_numerics::Pcg64;
use leadtime_numerics::elementary::{exp, ln};
use leadtime_proto::limits::{MAX_CHOICES, MAX_HEADS};
use leadtime_proto::{ActionSpec, HeadCredit, Mask};

#[derive(Clone, Debug)]
struct HeadLayout {
    offset: usize,
    n_choices: usize,
    /// The earlier head that decides and, per choice of it, what is left.
    rule: Option<(usize, Vec<u64>)>,
    /// Whether the head counts only behind an open gate.
    gated: bool,
}

/// The distribution over actions that logits, mask and the rules between heads make.
///
/// # Shapes
///
/// Everywhere `logits`: `[C]`, choices over all heads; `action`: `[H]`, a choice per head.
#[derive(Clone, Debug)]
pub struct ActionDistribution {
    heads: Vec<HeadLayout>,
    n_choices: usize,
    /// The first head's choice that opens the gate.
    open: Option<u8>,
}

/// Log-probability and entropy of one action, and what their gradients need.
#[derive(Clone, Debug)]
pub struct ActionTerms {
    /// Log-probability of the action over the heads that count.
    pub log_prob: f32,
    /// Entropy over the heads that count.
    pub entropy: f32,
    /// Per choice: its log-probability within its head; 0 where it is not offered.
    log_probs: [f32; MAX_CHOICES],
    /// Per choice: its probability within its head; 0 where it is not offered.
    probs: [f32; MAX_CHOICES],
    /// Per head: its entropy.
    entropies: [f32; MAX_HEADS],
    /// Per head: whether it counts.
    counts: [bool; MAX_HEADS],
}

impl Default for ActionTerms {
    fn default() -> Self {
        Self {
            log_prob: 0.0,
            entropy: 0.0,
            log_probs: [0.0; MAX_CHOICES],
            probs: [0.0; MAX_CHOICES],
            entropies: [0.0; MAX_HEADS],
            counts: [false; MAX_HEADS],
        }
    }
}

impl ActionDistribution {
    /// Prepares the distribution of an action space that has been checked ([`ActionSpec::check`]).
    ///
    /// # Panics
    ///
    /// If the action space has more heads or choices than a mask can hold.
    pub fn new(spec: &ActionSpec, credit: HeadCredit) -> Self {
        assert!(spec.heads.len() <= MAX_HEADS && spec.n_choices() <= MAX_CHOICES);
        let gate = spec.gate.filter(|_| credit == HeadCredit::Active);
        let layout = |(h, offset): (usize, usize)| {
            let rule = spec.conditionals.iter().find(|rule| rule.head == h);
            HeadLayout {
                offset,
                n_choices: spec.heads[h].n_choices,
                rule: rule.map(|rule| (rule.given, rule.allowed.clone())),
                gated: gate.is_some_and(|gate| gate.head != h),
            }
        };
        Self {
            heads: spec.offsets().into_iter().enumerate().map(layout).collect(),
            n_choices: spec.n_choices(),
            open: gate.map(|gate| gate.choice as u8),
        }
    }

    /// Returns the number of heads, so of choices in an action.
    pub fn n_heads(&self) -> usize {
        self.heads.len()
    }

    /// Returns the width of the logits.
    pub fn n_choices(&self) -> usize {
        self.n_choices
    }

    /// Draws an action (one draw per head) and returns its log-probability.
    pub fn sample(
        &self,
        logits: &[f32],
        mask: Mask,
        generator: &mut Pcg64,
        action: &mut [u8],
    ) -> f32 {
        self.choose(logits, mask, action, |weights, allowed| {
            let total: f32 = each(allowed).map(|choice| weights[choice]).sum();
            let mut left = generator.unit() as f32 * total;
            let drawn = each(allowed).find(|&choice| {
                left -= weights[choice];
                left < 0.0
            });
            // Rounding can leave a crumb behind the last choice.
            drawn.or_else(|| each(allowed).last()).unwrap_or(0)
        })
    }

    /// Takes the likeliest choice of each head in turn (the first among equals) and returns the log-probability.
    pub fn greedy(&self, logits: &[f32], mask: Mask, action: &mut [u8]) -> f32 {
        self.choose(logits, mask, action, |weights, allowed| {
            let better =
                |best: usize, choice| if weights[choice] > weights[best] { choice } else { best };
            each(allowed).reduce(better).unwrap_or(0)
        })
    }

    /// Returns the log-probability of an action over the heads that count, in nats.
    pub fn log_prob(&self, logits: &[f32], mask: Mask, action: &[u8]) -> f32 {
        let mut terms = ActionTerms::default();
        self.terms(logits, mask, action, &mut terms);
        terms.log_prob
    }

    /// Computes log-probability and entropy of an action and keeps what their gradients need.
    #[inline(always)]
    pub fn terms(&self, logits: &[f32], mask: Mask, action: &[u8], terms: &mut ActionTerms) {
        // Loops over all choices at once, padded to whole vectors: heads of two to five are too short for any.
        let n = self.n_choices.next_multiple_of(8);
        let (mut offered, mut highest) = ([0.0_f32; MAX_CHOICES], [0.0_f32; MAX_CHOICES]);
        for head in &self.heads {
            let allowed = head.allowed(mask, action);
            let range = head.range();
            for (choice, slot) in offered[range.clone()].iter_mut().enumerate() {
                *slot = (allowed >> choice & 1) as f32;
            }
            highest[range.clone()].fill(highest_logit(&logits[range], allowed));
        }
        let ActionTerms { log_probs, probs, .. } = terms;
        log_probs[..self.n_choices].copy_from_slice(&logits[..self.n_choices]);
        for c in 0..n {
            log_probs[c] -= highest[c];
            probs[c] = exp(log_probs[c]) * offered[c];
        }
        let (mut log_total, mut scale) = ([0.0_f32; MAX_CHOICES], [0.0_f32; MAX_CHOICES]);
        for head in &self.heads {
            let total: f32 = probs[head.range()].iter().sum();
            log_total[head.range()].fill(ln(total));
            scale[head.range()].fill(1.0 / total);
        }
        let mut surprise = [0.0_f32; MAX_CHOICES];
        for c in 0..n {
            log_probs[c] = (log_probs[c] - log_total[c]) * offered[c];
            probs[c] *= scale[c];
            surprise[c] = probs[c] * log_probs[c];
        }
        self.add_up(action, &surprise, terms);
    }

    /// Sums log-probability and entropy over the heads that count.
    #[inline(always)]
    fn add_up(&self, action: &[u8], surprise: &[f32; MAX_CHOICES], terms: &mut ActionTerms) {
        terms.log_prob = 0.0;
        terms.entropy = 0.0;
        for (h, head) in self.heads.iter().enumerate() {
            terms.entropies[h] = -surprise[head.range()].iter().sum::<f32>();
            terms.counts[h] = self.counts(head, action);
            if terms.counts[h] {
                terms.log_prob += terms.log_probs[head.offset + usize::from(action[h])];
                terms.entropy += terms.entropies[h];
            }
        }
    }

    fn counts(&self, head: &HeadLayout, action: &[u8]) -> bool {
        !head.gated || self.open == Some(action[0])
    }

    /// Goes through the heads, choosing from unnormalised probabilities, and returns the log-probability.
    fn choose(
        &self,
        logits: &[f32],
        mask: Mask,
        action: &mut [u8],
        mut pick: impl FnMut(&[f32], u64) -> usize,
    ) -> f32 {
        let mut log_prob = 0.0;
        let (mut log_probs, mut probs) = ([0.0; MAX_CHOICES], [0.0; MAX_CHOICES]);
        for (h, head) in self.heads.iter().enumerate() {
            let allowed = head.allowed(mask, action);
            softmax(&logits[head.range()], allowed, &mut log_probs, &mut probs);
            let choice = pick(&probs, allowed);
            action[h] = choice as u8;
            if self.counts(head, action) {
                log_prob += log_probs[choice];
            }
        }
        log_prob
    }
}

impl HeadLayout {
    /// Returns where the head's choices are among all.
    fn range(&self) -> Range<usize> {
        self.offset..self.offset + self.n_choices
    }

    /// Returns the choices left to this head; as [`ActionSpec::allowed`].
    fn allowed(&self, mask: Mask, action: &[u8]) -> u64 {
        let all = Mask::ALL.of_head(0, self.n_choices);
        let offered = mask.of_head(self.offset, self.n_choices);
        let rule = match &self.rule {
            None => all,
            Some((given, allowed)) => allowed[usize::from(action[*given])] & all,
        };
        if offered & rule == 0 { rule } else { offered & rule }
    }
}

/// Returns the highest logit among the allowed choices.
#[inline(always)]
fn highest_logit(logits: &[f32], allowed: u64) -> f32 {
    let masked = logits
        .iter()
        .enumerate()
        .map(|(choice, &logit)| if allowed >> choice & 1 == 1 { logit } else { f32::NEG_INFINITY });
    masked.fold(f32::NEG_INFINITY, |highest, logit| if logit > highest { logit } else { highest })
}

/// Computes one head's log-probabilities and unnormalised probabilities, with the bits of
/// [`ActionDistribution::terms`].
fn softmax(logits: &[f32], allowed: u64, log_probs: &mut [f32], weights: &mut [f32]) {
    let highest = highest_logit(logits, allowed);
    let offered = |choice: usize| (allowed >> choice & 1) as f32;
    for (choice, &logit) in logits.iter().enumerate() {
        log_probs[choice] = logit - highest;
        weights[choice] = exp(log_probs[choice]) * offered(choice);
    }
    let log_total = ln(weights[..logits.len()].iter().sum());
    for log_prob in &mut log_probs[..logits.len()] {
        *log_prob -= log_total;
    }
}

/// Iterates over the set bits of a word, lowest first.
fn each(mut bits: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lowest = (bits != 0).then(|| bits.trailing_zeros() as usize);
        bits &= bits.wrapping_sub(1);
        lowest
    })
}

impl ActionTerms {
    /// Computes the gradient `d_log_prob · ∂log π/∂logits + d_entropy · ∂H/∂logits`.
    ///
    /// With p the probabilities of a head, `∂log p(a)/∂z_c = [c = a] - p_c` and `∂H/∂z_c = -p_c (log p_c + H)`.
    ///
    /// # Shapes
    ///
    /// `action`: the `[H]` that the terms are of; `gradient`: `[C]`.
    #[inline(always)]
    pub fn gradient(
        &self,
        distribution: &ActionDistribution,
        action: &[u8],
        d_log_prob: f32,
        d_entropy: f32,
        gradient: &mut [f32],
    ) {
        for (h, head) in distribution.heads.iter().enumerate() {
            let range = head.range();
            let gradient = &mut gradient[range.clone()];
            if !self.counts[h] {
                gradient.fill(0.0);
                continue;
            }
            let terms = self.probs[range.clone()].iter().zip(&self.log_probs[range]);
            for (slot, (&p, &log_p)) in gradient.iter_mut().zip(terms) {
                *slot = -p * (d_log_prob + d_entropy * (log_p + self.entropies[h]));
            }
            gradient[usize::from(action[h])] += d_log_prob;
        }
    }
}

#[cfg(test)]
#[path = "distribution_tests.rs"]
mod tests;
