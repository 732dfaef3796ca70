//! PPO's loss, row by row: logits and values in, what each row contributes out, gradients in closed form.
//!
//! Spelled out in the engine's operations the loss is some sixty small tensors per minibatch; here it is one pass over
//! the rows.
//!
//! ```text
//! r = π(a|s) / μ(a|s)      L = mean max(-A r, -A clip(r, 1 ± ε))                                  policy
//!                            + value_coef · ½ mean max((v - R)², (v₀ + clip(v - v₀, ±ε) - R)²)    value
//!                            - entropy_coef · mean H                                              entropy
//! ```
//!
//! # Source
//!
//! Schulman et al., *Proximal policy optimization algorithms*, 2017 (arXiv:1707.06347), with the details of `CleanRL`'s
//! `ppo.py`: advantages normalised per minibatch with the unbiased deviation, values clipped like ratios.

#![expect(
    clippy::inline_always,
    reason = "what a row computes must be compiled inside the dispatched target features"
)]

use leadtime_numerics::Panels;
use leadtime_numerics::elementary::exp;
use leadtime_policy::{ActionDistribution, ActionTerms};
use leadtime_proto::Mask;
use leadtime_proto::limits::MAX_CHOICES;
use pulp::Arch;

use crate::settings::LearnerSettings;

/// Ratios are not taken beyond exp(20): a sender may claim that an action was all but impossible, and an infinite
/// ratio would end the run.
const MAX_LOG_RATIO: f32 = 20.0;

/// What the loss takes from the settings.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LossSettings {
    clip: f32,
    value_clip: bool,
    entropy_coef: f32,
    value_coef: f32,
}

impl From<&LearnerSettings> for LossSettings {
    fn from(settings: &LearnerSettings) -> Self {
        Self {
            clip: settings.clip as f32,
            value_clip: settings.value_clip,
            entropy_coef: settings.entropy_coef as f32,
            value_coef: settings.value_coef as f32,
        }
    }
}

/// The samples of an update, but for their observations.
///
/// # Shapes
///
/// N samples, H heads.
#[derive(Clone, Debug, Default)]
pub(crate) struct Samples {
    /// Offered choices, a word per sample. `[N]`
    pub(crate) masks: Vec<u64>,
    /// What was chosen. `[N, H]`
    pub(crate) actions: Vec<u8>,
    /// Under the behaviour policy. `[N]`
    pub(crate) log_probs: Vec<f32>,
    /// Advantages of the actions. `[N]`
    pub(crate) advantages: Vec<f32>,
    /// Targets of the critic. `[N]`
    pub(crate) returns: Vec<f32>,
    /// What clipped values start from. `[N]`
    pub(crate) values: Vec<f32>,
}

/// What gives the advantages of a minibatch mean 0 and (unbiased) deviation 1.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AdvantageScale {
    offset: f32,
    factor: f32,
}

impl AdvantageScale {
    /// Measures a whole minibatch; one sample has no deviation and keeps its advantage.
    pub(crate) fn of(advantages: impl ExactSizeIterator<Item = f32> + Clone) -> Self {
        let n = advantages.len() as f64;
        if advantages.len() < 2 {
            return Self { offset: 0.0, factor: 1.0 };
        }
        let mean = advantages.clone().map(f64::from).sum::<f64>() / n;
        let squares: f64 = advantages.map(|a| (f64::from(a) - mean).powi(2)).sum();
        let deviation = (squares / (n - 1.0)).sqrt();
        // The 1e-8 is the original's: equal advantages have deviation 0.
        Self { offset: mean as f32, factor: (1.0 / (deviation + 1e-8)) as f32 }
    }

    fn apply(self, advantage: f32) -> f32 {
        (advantage - self.offset) * self.factor
    }
}

/// Sums over samples, divided by the samples of their minibatch: those of its parts add up to its means.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct LossReport {
    pub(crate) total: f64,
    pub(crate) policy_loss: f64,
    pub(crate) value_loss: f64,
    pub(crate) entropy: f64,
    pub(crate) old_approx_kl: f64,
    pub(crate) approx_kl: f64,
    pub(crate) clip_fraction: f64,
}

impl LossReport {
    pub(crate) fn add(&mut self, other: &Self) {
        self.total += other.total;
        self.policy_loss += other.policy_loss;
        self.value_loss += other.value_loss;
        self.entropy += other.entropy;
        self.old_approx_kl += other.old_approx_kl;
        self.approx_kl += other.approx_kl;
        self.clip_fraction += other.clip_fraction;
    }

    pub(crate) fn divided(&self, n: f64) -> Self {
        Self {
            total: self.total / n,
            policy_loss: self.policy_loss / n,
            value_loss: self.value_loss / n,
            entropy: self.entropy / n,
            old_approx_kl: self.old_approx_kl / n,
            approx_kl: self.approx_kl / n,
            clip_fraction: self.clip_fraction / n,
        }
    }
}

/// What one row contributes to the policy's loss and to the report.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct PolicyTerms {
    policy_loss: f32,
    entropy: f32,
    log_ratio: f32,
    approx_kl: f32,
    /// Whether the ratio left the clip range.
    pub(crate) is_clipped: bool,
}

/// The loss of one minibatch.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PpoLoss<'a> {
    pub(crate) distribution: &'a ActionDistribution,
    pub(crate) settings: LossSettings,
    /// All samples of the update.
    pub(crate) samples: &'a Samples,
    /// `None`: advantages stay as they are.
    pub(crate) scale: Option<AdvantageScale>,
    /// Rows of the minibatch.
    pub(crate) n_rows: usize,
}

impl PpoLoss<'_> {
    /// Appends what rows contribute to the policy's loss, and computes the loss's slopes in their logits.
    ///
    /// # Shapes
    ///
    /// M rows: `samples`: `[M]`, their samples; `logits`: `[M, C]`; `slopes`: becomes `[M, C]`.
    pub(crate) fn policy_rows(
        &self,
        samples: &[usize],
        logits: &Panels,
        slopes: &mut Panels,
        terms: &mut Vec<PolicyTerms>,
    ) {
        Arch::new().dispatch(
            #[inline(always)]
            || {
                let n_choices = self.distribution.n_choices();
                slopes.resize(samples.len(), n_choices);
                let (mut own, mut own_slopes) = ([0.0; MAX_CHOICES], [0.0; MAX_CHOICES]);
                let mut action_terms = ActionTerms::default();
                for (row, &sample) in samples.iter().enumerate() {
                    logits.copy_row(row, &mut own[..n_choices]);
                    let own_slopes = &mut own_slopes[..n_choices];
                    terms.push(self.policy_row(
                        sample,
                        &own[..n_choices],
                        &mut action_terms,
                        own_slopes,
                    ));
                    slopes.set_row(row, own_slopes);
                }
            },
        );
    }

    #[inline(always)]
    fn policy_row(
        &self,
        sample: usize,
        logits: &[f32],
        action_terms: &mut ActionTerms,
        slopes: &mut [f32],
    ) -> PolicyTerms {
        let Samples { masks, actions, log_probs, advantages, .. } = self.samples;
        let n_heads = self.distribution.n_heads();
        let action = &actions[sample * n_heads..][..n_heads];
        self.distribution.terms(logits, Mask(masks[sample]), action, action_terms);
        let advantage = advantages[sample];
        let advantage = self.scale.map_or(advantage, |scale| scale.apply(advantage));
        // log r = log π(a|s) - log μ(a|s), where μ is the policy that acted: of a stale batch, not the newest.
        let log_ratio = action_terms.log_prob - log_probs[sample];
        let (terms, d_log_prob) =
            self.settings.policy_term(log_ratio, advantage, action_terms.entropy);
        let share = self.share();
        // ∂L/∂H of this row: the entropy term is -entropy_coef · mean H.
        let d_entropy = -self.settings.entropy_coef * share;
        action_terms.gradient(self.distribution, action, d_log_prob * share, d_entropy, slopes);
        terms
    }

    /// Appends what rows contribute to the value loss, without its factor ½, and computes the loss's slopes in their
    /// values.
    ///
    /// # Shapes
    ///
    /// M rows: `samples`: `[M]`, their samples; `values`: `[M, 1]`; `slopes`: becomes `[M, 1]`.
    pub(crate) fn value_rows(
        &self,
        samples: &[usize],
        values: &Panels,
        slopes: &mut Panels,
        losses: &mut Vec<f32>,
    ) {
        slopes.resize(samples.len(), 1);
        let share = self.share();
        for (row, &sample) in samples.iter().enumerate() {
            let mut value = [0.0];
            values.copy_row(row, &mut value);
            let (old, target) = (self.samples.values[sample], self.samples.returns[sample]);
            let (loss, slope) = self.settings.value_term(value[0], old, target);
            losses.push(loss);
            // The ½ of the value loss and the 2 of its square cancel: `value_term` has neither.
            slopes.set_row(row, &[slope * self.settings.value_coef * share]);
        }
    }

    /// The weight of one row in a mean.
    fn share(&self) -> f32 {
        1.0 / self.n_rows as f32
    }

    /// Returns the share of some rows in the means over the minibatch.
    pub(crate) fn report(&self, policy: &[PolicyTerms], value_losses: &[f32]) -> LossReport {
        let mut sums = LossReport::default();
        for terms in policy {
            sums.policy_loss += f64::from(terms.policy_loss);
            sums.entropy += f64::from(terms.entropy);
            // Two estimates of KL(μ‖π): mean -log r, and mean (r - 1) - log r, which is never negative (Schulman, 2020).
            sums.old_approx_kl -= f64::from(terms.log_ratio);
            sums.approx_kl += f64::from(terms.approx_kl);
            sums.clip_fraction += f64::from(u8::from(terms.is_clipped));
        }
        for loss in value_losses {
            sums.value_loss += 0.5 * f64::from(*loss);
        }
        self.settings.means(sums, self.n_rows as f64)
    }
}

impl LossSettings {
    /// Returns one row's terms and the slope of its policy loss in the log-probability.
    #[inline(always)]
    fn policy_term(&self, log_ratio: f32, advantage: f32, entropy: f32) -> (PolicyTerms, f32) {
        let ratio = exp(log_ratio.min(MAX_LOG_RATIO));
        let clipped = ratio.clamp(1.0 - self.clip, 1.0 + self.clip);
        // max(-A r, -A clip(r, 1 ± ε)).
        let (free, bound) = (-advantage * ratio, -advantage * clipped);
        let terms = PolicyTerms {
            policy_loss: free.max(bound),
            entropy,
            log_ratio,
            approx_kl: (ratio - 1.0) - log_ratio,
            is_clipped: (ratio - 1.0).abs() > self.clip,
        };
        // Within the range both branches are one; outside, only the free branch has a slope.
        (terms, if free >= bound { free } else { 0.0 })
    }

    /// Returns one row's value loss, without its factor ½, and its slope in the value.
    fn value_term(&self, value: f32, old: f32, target: f32) -> (f32, f32) {
        // Without clipping (v - R)²; its slope, halved as the loss is, is v - R.
        let error = value - target;
        if !self.value_clip {
            return (error * error, error);
        }
        let change = value - old;
        let clipped = old + change.clamp(-self.clip, self.clip) - target;
        // max((v - R)², (v₀ + clip(v - v₀, ±ε) - R)²); like the ratio's, the clipped branch has no slope outside the range.
        let within = change.abs() <= self.clip;
        let has_slope = within || error * error >= clipped * clipped;
        ((error * error).max(clipped * clipped), if has_slope { error } else { 0.0 })
    }

    fn means(&self, sums: LossReport, n: f64) -> LossReport {
        let mut means = sums.divided(n);
        means.total = means.policy_loss + f64::from(self.value_coef) * means.value_loss
            - f64::from(self.entropy_coef) * means.entropy;
        means
    }
}

#[cfg(test)]
#[expect(clippy::unreadable_literal, reason = "golden numbers are as the script writes them")]
#[path = "loss_tests.rs"]
mod tests;
