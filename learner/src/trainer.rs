//! The update: rollouts in, the next policy version out.
//!
//! ```text
//! rollouts (sorted) ─► rewards ─► advantages, targets ─► epochs x minibatches ─► normaliser ─► version + 1
//!                      scaled,    GAE on stored values   loss, gradient, clip,    updated from
//!                      normalised or V-trace (async)     Adam                     these rollouts
//! ```
//!
//! # Invariants
//!
//! * Single-threaded, and a pure function of state and rollouts: same state, same rollouts, same bits.
//! * [`Trainer::state`] is everything: a trainer restored from it goes on bit for bit.
//! * Version v is weights v *and* normaliser v: the update uses the statistics that the newest actors used, and only
//!   then takes the rollouts' observations in, in the order of environment ids.
//!
//! # Where to start
//!
//! [`Trainer::update`].

use std::collections::BTreeMap;
use std::sync::Arc;

use candle_core::{Device, Tensor};
use leadtime_policy::{ActionDistribution, ObservationNormalizer, Parameters, Policy};
use leadtime_proto::{EnvSpec, PolicySpec, PolicyVersion, Rollout, Schedule, Staleness};
use serde::{Deserialize, Serialize};

use crate::TrainError;
use crate::adam::{Adam, clip_factor, global_norm};
use crate::batch::Batch;
use crate::loss::{AdvantageScale, LossOp, LossReport, LossSettings, PpoLoss};
use crate::lstm_op::Sequences;
use crate::minibatch::Minibatches;
use crate::network::ActorCritic;
use crate::rewards::ReturnNormalizer;
use crate::settings::LearnerSettings;

/// Samples whose activations are in the graph at a time: those of 512 rows stay in the second-level cache.
const BLOCK: usize = 512;

/// What one update did.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UpdateReport {
    /// The version that the update made.
    pub version: PolicyVersion,
    /// Mean over all minibatches.
    pub policy_loss: f64,
    /// Mean over all minibatches, with its factor ½ and without its coefficient.
    pub value_loss: f64,
    /// Mean over all minibatches, in nats.
    pub entropy: f64,
    /// Mean of -log r over the last epoch.
    pub old_approx_kl: f64,
    /// Mean of (r - 1) - log r over the last epoch.
    pub approx_kl: f64,
    /// Share of samples whose ratio left the clip range, over all minibatches.
    pub clip_fraction: f64,
    /// Mean length of the gradient before clipping.
    pub gradient_norm: f64,
    /// Share of the targets' variance that the critic explained before the update.
    pub explained_variance: f64,
    /// As used.
    pub learning_rate: f64,
    /// Rollouts by staleness in versions.
    pub staleness: BTreeMap<u64, u64>,
    /// Environment steps that were trained on.
    pub n_samples: u64,
    /// Epochs that were run: fewer than set if the target KL ended the update.
    pub n_epochs: u64,
}

/// Turns rollouts into policies.
#[derive(Debug)]
pub struct Trainer {
    pub(crate) policy_spec: PolicySpec,
    env_spec: EnvSpec,
    settings: LearnerSettings,
    run_seed: u64,
    distribution: Arc<ActionDistribution>,
    pub(crate) version: PolicyVersion,
    pub(crate) parameters: Parameters,
    pub(crate) network: ActorCritic,
    pub(crate) adam: Adam,
    pub(crate) observations: Option<ObservationNormalizer>,
    pub(crate) rewards: ReturnNormalizer,
}

impl Trainer {
    /// Starts a run at version 0 with parameters drawn from the run's seed.
    ///
    /// # Errors
    ///
    /// [`TrainError`] if settings or specification cannot be used.
    pub fn new(
        policy: &PolicySpec,
        env: &EnvSpec,
        settings: &LearnerSettings,
        run_seed: u64,
    ) -> Result<Self, TrainError> {
        settings.check()?;
        let parameters = Parameters::initialize(policy, run_seed)?;
        Self::from_parameters(policy, env, settings, (run_seed, parameters))
    }

    /// Starts a run at version 0 from given parameters, as a fork of another run does.
    ///
    /// # Errors
    ///
    /// [`TrainError`] if settings, specification and parameters cannot be used together.
    pub fn from_parameters(
        policy: &PolicySpec,
        env: &EnvSpec,
        settings: &LearnerSettings,
        (run_seed, parameters): (u64, Parameters),
    ) -> Result<Self, TrainError> {
        settings.check()?;
        let network = ActorCritic::new(policy, &parameters)?;
        Ok(Self {
            policy_spec: policy.clone(),
            env_spec: env.clone(),
            settings: settings.clone(),
            run_seed,
            distribution: Arc::new(ActionDistribution::new(&policy.actions, policy.head_credit)),
            version: PolicyVersion(0),
            adam: Adam::new(network.vars()),
            network,
            observations: parameters.normalizer().cloned(),
            parameters,
            rewards: ReturnNormalizer::default(),
        })
    }

    /// Returns the present version: the number of updates made.
    pub fn version(&self) -> PolicyVersion {
        self.version
    }

    /// Returns the present parameters, normaliser included.
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// Returns the number of updates of the whole run.
    pub fn n_updates(&self) -> u64 {
        self.settings.n_updates()
    }

    /// Makes one update.
    ///
    /// # Errors
    ///
    /// [`TrainError`] if the rollouts are not sorted by environment id and iteration, one does not fit the
    /// specification, or training diverges. The trainer is then unusable and must be restored.
    pub fn update(&mut self, rollouts: &[Rollout]) -> Result<UpdateReport, TrainError> {
        self.check(rollouts)?;
        let batch = self.batch(rollouts)?;
        let learning_rate = self.settings.learning_rate_at(self.version.0);
        let totals = self.learn(&batch, learning_rate)?;
        if let Some(normalizer) = &mut self.observations {
            for rollout in rollouts {
                normalizer.update(&rollout.observations);
            }
        }
        self.parameters = self.network.parameters(self.observations.clone())?;
        let mut staleness = BTreeMap::new();
        for rollout in rollouts {
            let Staleness(age) = Staleness::between(self.version, rollout.version);
            *staleness.entry(age).or_default() += 1;
        }
        self.version = self.version.next();
        let (all, last) = (totals.all.mean(), totals.last_epoch.mean());
        Ok(UpdateReport {
            version: self.version,
            policy_loss: all.policy_loss,
            value_loss: all.value_loss,
            entropy: all.entropy,
            old_approx_kl: last.old_approx_kl,
            approx_kl: last.approx_kl,
            clip_fraction: all.clip_fraction,
            gradient_norm: totals.gradient_norm / totals.all.n as f64,
            explained_variance: batch.explained_variance(),
            learning_rate,
            staleness,
            n_samples: batch.n_samples() as u64,
            n_epochs: totals.n_epochs,
        })
    }

    fn check(&self, rollouts: &[Rollout]) -> Result<(), TrainError> {
        if rollouts.is_empty() {
            return Err(TrainError::NoRollouts);
        }
        let key = |rollout: &Rollout| (rollout.env_id, rollout.iteration);
        if let Some(i) = rollouts.windows(2).position(|pair| key(&pair[0]) >= key(&pair[1])) {
            return Err(TrainError::Unsorted { index: i + 1 });
        }
        let recurrent_dim = self.policy_spec.recurrent_dim();
        rollouts.iter().try_for_each(|rollout| {
            rollout
                .check(&self.env_spec, self.settings.n_steps, recurrent_dim)
                .map_err(|source| TrainError::Rollout { env_id: rollout.env_id, source })
        })
    }

    /// Lays out the samples of an update with their targets.
    fn batch(&mut self, rollouts: &[Rollout]) -> Result<Batch, TrainError> {
        let rewards = self.scaled_rewards(rollouts);
        let frozen = self.observations.as_ref().map(ObservationNormalizer::freeze);
        let is_async = matches!(self.settings.schedule(), Schedule::Async { .. });
        let mut policy =
            if is_async { Some(Policy::new(&self.policy_spec, &self.parameters)?) } else { None };
        let mut batch = Batch::default();
        for (rollout, rewards) in rollouts.iter().zip(&rewards) {
            batch.push(rollout, frozen.as_ref());
            match &mut policy {
                None => batch.push_gae(rollout, rewards, &self.settings),
                Some(policy) => {
                    let judge = (policy, &*self.distribution);
                    batch.push_vtrace(rollout, rewards, &self.settings, judge);
                }
            }
        }
        Ok(batch)
    }

    /// Returns each rollout's rewards, scaled and (after the statistics took all of them in) normalised.
    fn scaled_rewards(&mut self, rollouts: &[Rollout]) -> Vec<Vec<f32>> {
        let scale = self.settings.reward_scale as f32;
        let scaled = |rollout: &Rollout| rollout.rewards.iter().map(|r| r * scale).collect();
        let mut rewards: Vec<Vec<f32>> = rollouts.iter().map(scaled).collect();
        if self.settings.normalize_rewards {
            for (rollout, rewards) in rollouts.iter().zip(&rewards) {
                self.rewards.update(rollout, rewards, self.settings.gamma);
            }
            for rewards in &mut rewards {
                self.rewards.apply(rewards);
            }
        }
        rewards
    }

    /// Runs the epochs.
    fn learn(&mut self, batch: &Batch, learning_rate: f64) -> Result<Totals, TrainError> {
        let unit_len = if self.is_recurrent() { self.settings.n_steps } else { 1 };
        let n_minibatches = self.settings.n_minibatches.min(batch.n_samples() / unit_len);
        let place = (self.run_seed, self.version.0);
        let mut order = Minibatches::new(batch.n_samples(), unit_len, n_minibatches, place);
        let mut indices = Vec::new();
        let mut totals = Totals::default();
        for _ in 0..self.settings.n_epochs {
            order.shuffle();
            totals.last_epoch = Mean::default();
            for minibatch in 0..n_minibatches {
                order.indices(minibatch, &mut indices);
                let (report, norm) = self.step(batch, &indices, learning_rate)?;
                if !norm.is_finite() {
                    return Err(TrainError::Diverged { minibatch: totals.all.n, norm });
                }
                totals.all.add(&report);
                totals.last_epoch.add(&report);
                totals.gradient_norm += norm;
            }
            totals.n_epochs += 1;
            let kl = totals.last_epoch.mean().approx_kl;
            if self.settings.target_kl.is_some_and(|target| kl > target) {
                break;
            }
        }
        Ok(totals)
    }

    /// Takes one optimiser step; returns the loss and the gradient's norm.
    fn step(
        &mut self,
        batch: &Batch,
        indices: &[usize],
        learning_rate: f64,
    ) -> Result<(LossReport, f64), TrainError> {
        let advantages = indices.iter().map(|&i| batch.samples.advantages[i]);
        let scale = self.settings.normalize_advantages.then(|| AdvantageScale::of(advantages));
        // A recurrent network takes the minibatch whole: its sequences stay together.
        let block = if self.is_recurrent() { indices.len() } else { BLOCK };
        let mut report = LossReport::default();
        let mut gradients = BTreeMap::new();
        for rows in indices.chunks(block) {
            let (total, loss) = self.loss(batch, rows, (scale, indices.len()))?;
            add_gradients(&mut gradients, self.network.gradients(&total)?)?;
            report.add(&loss.report());
        }
        let norm = global_norm(&gradients)?;
        if norm.is_finite() {
            let scale = clip_factor(norm, self.settings.max_grad_norm);
            self.adam.step(self.network.vars(), &gradients, learning_rate, scale)?;
        }
        Ok((report, norm))
    }

    /// Builds the graph of the share that some rows have in the loss of their minibatch of `n_samples`.
    fn loss(
        &self,
        batch: &Batch,
        rows: &[usize],
        (scale, n_samples): (Option<AdvantageScale>, usize),
    ) -> Result<(Tensor, Arc<PpoLoss>), TrainError> {
        let obs_dim = self.policy_spec.obs_dim;
        let (features, mut samples) = batch.gather(rows, obs_dim);
        if let Some(scale) = scale {
            scale.apply(&mut samples.advantages);
        }
        let features = Tensor::from_vec(features, (rows.len(), obs_dim), &Device::Cpu)?;
        let sequences =
            if self.is_recurrent() { batch.gather_sequences(rows) } else { Sequences::default() };
        let (logits, values) = self.network.forward(&features, &Arc::new(sequences))?;
        let settings = LossSettings::from(&self.settings);
        let loss = PpoLoss::new(Arc::clone(&self.distribution), settings, samples, n_samples);
        let total = logits.apply_op2(&values, LossOp(Arc::clone(&loss)))?;
        Ok((total, loss))
    }

    fn is_recurrent(&self) -> bool {
        self.policy_spec.recurrent_dim() > 0
    }
}

/// Adds one block's gradients to those of the blocks before it.
fn add_gradients(
    sums: &mut BTreeMap<String, Tensor>,
    block: BTreeMap<String, Tensor>,
) -> candle_core::Result<()> {
    for (name, gradient) in block {
        let sum = match sums.get(&name) {
            Some(sum) => (sum + gradient)?,
            None => gradient,
        };
        sums.insert(name, sum);
    }
    Ok(())
}

/// Running mean of loss reports.
#[derive(Default)]
struct Mean {
    sum: LossReport,
    n: usize,
}

impl Mean {
    fn add(&mut self, report: &LossReport) {
        self.sum.add(report);
        self.n += 1;
    }

    fn mean(&self) -> LossReport {
        let n = self.n.max(1) as f64;
        LossReport {
            total: self.sum.total / n,
            policy_loss: self.sum.policy_loss / n,
            value_loss: self.sum.value_loss / n,
            entropy: self.sum.entropy / n,
            old_approx_kl: self.sum.old_approx_kl / n,
            approx_kl: self.sum.approx_kl / n,
            clip_fraction: self.sum.clip_fraction / n,
        }
    }
}

/// What the epochs of an update add up to.
#[derive(Default)]
struct Totals {
    all: Mean,
    last_epoch: Mean,
    gradient_norm: f64,
    n_epochs: u64,
}

#[cfg(test)]
#[path = "trainer_tests.rs"]
mod tests;
