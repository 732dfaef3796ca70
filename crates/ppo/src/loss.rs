//! PPO's loss as one node of the engine's graph: logits and values in, one number out, gradients in closed form.
//!
//! Spelled out in the engine's operations the loss is some sixty small tensors per minibatch; here it is one pass over
//! the samples.
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

use std::sync::{Arc, Mutex, PoisonError};

use candle_core::{CpuStorage, CustomOp2, Layout, Result, Shape, Tensor};
use leadtime_numerics::elementary::exp;
use leadtime_policy::{ActionDistribution, ActionTerms};
use leadtime_proto::Mask;

use crate::settings::LearnerSettings;
use crate::storage::{floats, with_floats};

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

/// The samples of one minibatch, but for their observations.
///
/// # Shapes
///
/// M samples, H heads.
#[derive(Clone, Debug, Default)]
pub(crate) struct Samples {
    /// `[M]`
    pub(crate) masks: Vec<u64>,
    /// `[M, H]`
    pub(crate) actions: Vec<u8>,
    /// Under the behaviour policy. `[M]`
    pub(crate) log_probs: Vec<f32>,
    /// `[M]`
    pub(crate) advantages: Vec<f32>,
    /// Targets of the critic. `[M]`
    pub(crate) returns: Vec<f32>,
    /// What clipped values start from. `[M]`
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
        Self { offset: mean as f32, factor: (1.0 / (deviation + 1e-8)) as f32 }
    }

    pub(crate) fn apply(self, advantages: &mut [f32]) {
        for advantage in advantages {
            *advantage = (*advantage - self.offset) * self.factor;
        }
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

/// What the forward pass leaves for the backward pass and for the report.
#[derive(Debug, Default)]
struct LossPass {
    report: LossReport,
    /// Whether the ratio left the clip range, sample by sample.
    clipped: Vec<bool>,
    d_logits: Vec<f32>,
    d_values: Vec<f32>,
}

/// The loss of one minibatch, or of a part of it.
#[derive(Debug)]
pub(crate) struct PpoLoss {
    distribution: Arc<ActionDistribution>,
    settings: LossSettings,
    samples: Samples,
    /// Samples of the whole minibatch, of which these may be a part.
    n_samples: usize,
    pass: Mutex<LossPass>,
}

impl PpoLoss {
    pub(crate) fn new(
        distribution: Arc<ActionDistribution>,
        settings: LossSettings,
        samples: Samples,
        n_samples: usize,
    ) -> Arc<Self> {
        Arc::new(Self { distribution, settings, samples, n_samples, pass: Mutex::default() })
    }

    /// Returns the means of the last forward pass.
    pub(crate) fn report(&self) -> LossReport {
        self.pass.lock().unwrap_or_else(PoisonError::into_inner).report
    }

    /// Tells of which samples the ratio left the clip range in the last forward pass. Shape `[n]`.
    pub(crate) fn clipped(&self) -> Vec<bool> {
        self.pass.lock().unwrap_or_else(PoisonError::into_inner).clipped.clone()
    }

    fn compute(&self, logits: &[f32], values: &[f32]) -> LossPass {
        let n_choices = self.distribution.n_choices();
        let n_heads = self.distribution.n_heads();
        let mut sums = LossReport::default();
        let mut d_logits = vec![0.0; logits.len()];
        let mut d_values = vec![0.0; values.len()];
        let mut clipped = Vec::with_capacity(values.len());
        let share = 1.0 / self.n_samples as f32;
        let mut terms = ActionTerms::default();
        let rows = logits.chunks_exact(n_choices).zip(d_logits.chunks_exact_mut(n_choices));
        for (i, (logits, d_logits)) in rows.enumerate() {
            let action = &self.samples.actions[i * n_heads..(i + 1) * n_heads];
            self.distribution.terms(logits, Mask(self.samples.masks[i]), action, &mut terms);
            let advantage = self.samples.advantages[i];
            let log_ratio = terms.log_prob - self.samples.log_probs[i];
            let n_clipped = sums.clip_fraction;
            let d_log_prob = self.settings.policy_term(log_ratio, advantage, &mut sums);
            clipped.push(sums.clip_fraction > n_clipped);
            sums.entropy += f64::from(terms.entropy);
            let d_entropy = -self.settings.entropy_coef * share;
            terms.gradient(&self.distribution, action, d_log_prob * share, d_entropy, d_logits);
            let (old, target) = (self.samples.values[i], self.samples.returns[i]);
            let slope = self.settings.value_term(values[i], old, target, &mut sums);
            d_values[i] = slope * self.settings.value_coef * share;
        }
        let report = self.settings.means(sums, self.n_samples as f64);
        LossPass { report, clipped, d_logits, d_values }
    }
}

impl LossSettings {
    /// Adds one sample's policy loss to the sums and returns its slope in the log-probability.
    #[inline]
    fn policy_term(&self, log_ratio: f32, advantage: f32, sums: &mut LossReport) -> f32 {
        let ratio = exp(log_ratio.min(MAX_LOG_RATIO));
        let clipped = ratio.clamp(1.0 - self.clip, 1.0 + self.clip);
        let (free, bound) = (-advantage * ratio, -advantage * clipped);
        sums.policy_loss += f64::from(free.max(bound));
        sums.old_approx_kl -= f64::from(log_ratio);
        sums.approx_kl += f64::from((ratio - 1.0) - log_ratio);
        sums.clip_fraction += f64::from(u8::from((ratio - 1.0).abs() > self.clip));
        // Within the range both branches are one; outside, only the free branch has a slope.
        if free >= bound { free } else { 0.0 }
    }

    /// Adds one sample's value loss to the sums and returns its slope in the value.
    #[inline]
    fn value_term(&self, value: f32, old: f32, target: f32, sums: &mut LossReport) -> f32 {
        let error = value - target;
        if !self.value_clip {
            sums.value_loss += 0.5 * f64::from(error * error);
            return error;
        }
        let change = value - old;
        let clipped = old + change.clamp(-self.clip, self.clip) - target;
        sums.value_loss += 0.5 * f64::from((error * error).max(clipped * clipped));
        let within = change.abs() <= self.clip;
        if within || error * error >= clipped * clipped { error } else { 0.0 }
    }

    fn means(&self, sums: LossReport, n: f64) -> LossReport {
        let mut means = sums.divided(n);
        means.total = means.policy_loss + f64::from(self.value_coef) * means.value_loss
            - f64::from(self.entropy_coef) * means.entropy;
        means
    }
}

/// The graph's handle on a [`PpoLoss`].
pub(crate) struct LossOp(pub(crate) Arc<PpoLoss>);

impl CustomOp2 for LossOp {
    fn name(&self) -> &'static str {
        "ppo-loss"
    }

    fn cpu_fwd(
        &self,
        logits: &CpuStorage,
        logits_layout: &Layout,
        values: &CpuStorage,
        values_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let (n, n_choices) = logits_layout.shape().dims2()?;
        let fits = n_choices == self.0.distribution.n_choices()
            && values_layout.shape().elem_count() == n
            && self.0.samples.masks.len() == n;
        if !fits {
            candle_core::bail!("ppo-loss: logits, values and samples differ in shape")
        }
        let logits = floats(logits, logits_layout)?;
        let pass = self.0.compute(logits, floats(values, values_layout)?);
        let total = pass.report.total as f32;
        *self.0.pass.lock().unwrap_or_else(PoisonError::into_inner) = pass;
        Ok((CpuStorage::F32(vec![total]), Shape::from(())))
    }

    fn bwd(
        &self,
        logits: &Tensor,
        values: &Tensor,
        _loss: &Tensor,
        gradient: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let factor = with_floats(gradient, |gradient| gradient[0])?;
        let mut pass = self.0.pass.lock().unwrap_or_else(PoisonError::into_inner);
        let scaled = |mut gradient: Vec<f32>| {
            // The loss is the root of the graph, so the factor is 1 but for tests.
            if factor != 1.0 {
                for x in &mut gradient {
                    *x *= factor;
                }
            }
            gradient
        };
        let d_logits = scaled(std::mem::take(&mut pass.d_logits));
        let d_values = scaled(std::mem::take(&mut pass.d_values));
        let d_logits = Tensor::from_vec(d_logits, logits.shape(), logits.device())?;
        Ok((Some(d_logits), Some(Tensor::from_vec(d_values, values.shape(), values.device())?)))
    }
}

#[cfg(test)]
#[expect(clippy::unreadable_literal, reason = "golden numbers are as the script writes them")]
#[path = "loss_tests.rs"]
mod tests;
