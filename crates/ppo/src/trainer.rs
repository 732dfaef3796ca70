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
//! * A pure function of state and rollouts: same state, same rollouts, same bits, however many threads share the work.
//! * [`Trainer::state`] is everything: a trainer restored from it goes on bit for bit.
//! * Version v is weights v *and* normaliser v: the update uses the statistics that the newest actors used, and only
//!   then takes the rollouts' observations in, in the order of environment ids.
//!
//! # Where to start
//!
//! [`Trainer::update`].

use std::collections::BTreeMap;

use leadtime_policy::{
    ActionDistribution, ObservationMoments, ObservationNormalizer, Parameters, Policy,
};
use leadtime_proto::limits::MAX_MAGNITUDE;
use leadtime_proto::{
    CheckedRollout, Encoder, EnvId, PolicySpec, PolicyVersion, Schedule, Staleness,
};
use serde::{Deserialize, Serialize};

use crate::TrainError;
use crate::adam::{Adam, clip_factor, global_norm};
use crate::batch::UpdateBatch;
use crate::dense::Gradients;
use crate::encoder::{EncoderInput, EncoderPass, Sequences};
use crate::loss::{AdvantageScale, LossReport, LossSettings, PpoLoss};
use crate::minibatch::Minibatches;
use crate::network::ActorCritic;
use crate::rewards::ReturnNormalizer;
use crate::settings::LearnerSettings;
use crate::stacks::{BLOCK, Features, Stacks};
use crate::storage::with_floats;
use crate::team::Team;

/// A critic's weights and its bias may together not make more than the largest value that a rollout may hold; the
/// factor leaves room for both and for rounding. Weights that learn are smaller by six orders of magnitude.
const LARGEST_SUM: f64 = MAX_MAGNITUDE / 4.0;

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
    /// Mean of -log r, over the minibatches of the last epoch.
    pub old_approx_kl: f64,
    /// Mean of (r - 1) - log r, over the minibatches of the last epoch.
    pub approx_kl: f64,
    /// Share of a minibatch's samples whose ratio left the clip range: mean over all minibatches, of whatever size.
    pub clip_fraction: f64,
    /// Share of all samples whose ratio left it, by staleness in versions; empty unless the schedule is asynchronous, where
    /// rollouts of an update differ in it.
    pub clip_by_staleness: BTreeMap<u64, f64>,
    /// Mean length of the gradient before clipping.
    pub gradient_norm: f64,
    /// Share of the targets' variance that the critic explained before the update.
    pub explained_variance: f64,
    /// Step size of the update, annealed.
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
    settings: LearnerSettings,
    run_seed: u64,
    distribution: ActionDistribution,
    pub(crate) version: PolicyVersion,
    pub(crate) parameters: Parameters,
    pub(crate) network: ActorCritic,
    encoder: Option<EncoderPass>,
    stacks: Stacks,
    team: Team,
    /// Those of the last minibatch, whose memory the next one takes.
    gradients: Gradients,
    pub(crate) adam: Adam,
    pub(crate) observations: Option<ObservationNormalizer>,
    pub(crate) rewards: ReturnNormalizer,
}

impl Trainer {
    /// Starts a run at version 0 with parameters drawn from the run's seed.
    ///
    /// # Errors
    ///
    /// [`TrainError`] if settings or specification cannot be used, or the system has no thread left.
    pub fn new(
        policy: &PolicySpec,
        settings: &LearnerSettings,
        run_seed: u64,
    ) -> Result<Self, TrainError> {
        settings.check()?;
        let parameters = Parameters::initialize(policy, run_seed)?;
        Self::from_parameters(policy, settings, run_seed, parameters)
    }

    /// Starts a run at version 0 from given parameters, as a fork of another run does.
    ///
    /// # Errors
    ///
    /// [`TrainError`] if settings, specification and parameters cannot be used together, or the system has no thread left.
    pub fn from_parameters(
        policy: &PolicySpec,
        settings: &LearnerSettings,
        run_seed: u64,
        parameters: Parameters,
    ) -> Result<Self, TrainError> {
        settings.check()?;
        let network = ActorCritic::new(policy, &parameters)?;
        Ok(Self {
            policy_spec: policy.clone(),
            settings: settings.clone(),
            run_seed,
            distribution: ActionDistribution::new(&policy.actions, policy.head_credit),
            version: PolicyVersion(0),
            encoder: EncoderPass::new(policy),
            stacks: Stacks::new(policy),
            team: Team::new(settings.threads)?,
            gradients: Gradients::new(),
            adam: Adam::new(&network.vars),
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

    /// Notes that an environment's next rollout does not begin where its last one ended: the episode before is over.
    pub fn forget_episode(&mut self, env_id: EnvId) {
        self.rewards.forget(env_id);
    }

    /// Makes one update.
    ///
    /// # Errors
    ///
    /// [`TrainError`] if there is no rollout, they are not sorted by environment id and iteration, or training
    /// diverges. After a divergence the trainer is unusable and must be restored.
    ///
    /// # Panics
    ///
    /// If a rollout was checked against another specification than that of this trainer's policy.
    pub fn update(&mut self, rollouts: &[CheckedRollout]) -> Result<UpdateReport, TrainError> {
        self.update_in_parts(rollouts, &mut |_part| {})
    }

    /// As [`Self::update`], and calls `ended` at the end of each part: `batch`, `epochs`.
    ///
    /// # Errors
    ///
    /// [`TrainError`] in the cases of [`Self::update`]: no rollouts, rollouts out of order, or divergence.
    pub fn update_in_parts(
        &mut self,
        rollouts: &[CheckedRollout],
        ended: &mut dyn FnMut(&'static str),
    ) -> Result<UpdateReport, TrainError> {
        check_order(rollouts)?;
        let batch = self.batch(rollouts)?;
        ended("batch");
        let learning_rate = self.settings.learning_rate_at(self.version.0);
        let totals = self.learn(&batch, learning_rate)?;
        ended("epochs");
        check_weights(&self.network)?;
        self.take_in_observations(rollouts);
        self.parameters = self.network.parameters(self.observations.clone())?;
        self.check_outputs(rollouts)?;
        let mut staleness = BTreeMap::new();
        for rollout in rollouts {
            *staleness.entry(self.staleness(rollout)).or_default() += 1;
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
            clip_by_staleness: totals.clipped.shares(),
            gradient_norm: totals.gradient_norm / totals.all.n as f64,
            explained_variance: batch.explained_variance(),
            learning_rate,
            staleness,
            n_samples: batch.n_samples() as u64,
            n_epochs: totals.n_epochs,
        })
    }

    fn staleness(&self, rollout: &CheckedRollout) -> u64 {
        let Staleness(age) = Staleness::between(self.version, rollout.version);
        age
    }

    /// Lays out the samples of an update with their targets.
    fn batch(&mut self, rollouts: &[CheckedRollout]) -> Result<UpdateBatch, TrainError> {
        let rewards = self.scaled_rewards(rollouts);
        let frozen = self.observations.as_ref().map(ObservationNormalizer::freeze);
        let is_async = matches!(self.settings.schedule(), Schedule::Async { .. });
        let mut batch = UpdateBatch::of(rollouts, frozen.as_ref(), &self.team);
        if !is_async {
            batch.set_gae(rollouts, &rewards, &self.settings, &self.team);
            return Ok(batch);
        }
        let mut policy = Policy::new(&self.policy_spec, &self.parameters)?;
        for (rollout, rewards) in rollouts.iter().zip(&rewards) {
            let n_samples = batch.staleness.len() + rollout.masks.len();
            batch.staleness.resize(n_samples, self.staleness(rollout));
            batch.push_vtrace(rollout, rewards, &self.settings, &mut policy, &self.distribution);
        }
        Ok(batch)
    }

    /// Updates the statistics of observations; what does not depend on the order of rollouts is shared by the threads.
    fn take_in_observations(&mut self, rollouts: &[CheckedRollout]) {
        let Some(normalizer) = &mut self.observations else { return };
        let obs_dim = self.policy_spec.obs_dim;
        let mut found = vec![ObservationMoments::default(); rollouts.len()];
        self.team.for_each(rollouts.iter().zip(&mut found), |(rollout, moments)| {
            *moments = ObservationMoments::of(obs_dim, &rollout.observations);
        });
        for moments in &found {
            normalizer.merge(&self.policy_spec, moments);
        }
    }

    /// Returns each rollout's rewards, scaled and (after the statistics took all of them in) normalised.
    fn scaled_rewards(&mut self, rollouts: &[CheckedRollout]) -> Vec<Vec<f32>> {
        let scale = self.settings.reward_scale as f32;
        let scaled = |rollout: &CheckedRollout| rollout.rewards.iter().map(|r| r * scale).collect();
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

    /// Runs the epochs of one update, minibatch by minibatch.
    fn learn(&mut self, batch: &UpdateBatch, learning_rate: f64) -> Result<Totals, TrainError> {
        let unit_len = if self.is_recurrent() { self.settings.n_steps } else { 1 };
        let n_minibatches = self.settings.n_minibatches.min(batch.n_samples() / unit_len);
        let (n_samples, update) = (batch.n_samples(), self.version.0);
        let mut order = Minibatches::new(n_samples, unit_len, n_minibatches, self.run_seed, update);
        let mut indices = Vec::new();
        let mut totals = Totals::default();
        for _ in 0..self.settings.n_epochs {
            order.shuffle();
            totals.last_epoch = Mean::default();
            for minibatch in 0..n_minibatches {
                order.indices(minibatch, &mut indices);
                let (report, norm) =
                    self.step(batch, &indices, learning_rate, &mut totals.clipped)?;
                if !norm.is_finite() {
                    let minibatch = totals.all.n;
                    let says = format!("gradient norm of minibatch {minibatch} is {norm}");
                    return Err(TrainError::Diverged(says));
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

    /// Takes one optimiser step; returns the loss and the gradient's norm, and counts what was clipped.
    fn step(
        &mut self,
        batch: &UpdateBatch,
        indices: &[usize],
        learning_rate: f64,
        clipped: &mut ClipCounts,
    ) -> Result<(LossReport, f64), TrainError> {
        let advantages = indices.iter().map(|&i| batch.samples.advantages[i]);
        let loss = PpoLoss {
            distribution: &self.distribution,
            settings: LossSettings::from(&self.settings),
            samples: &batch.samples,
            scale: self.settings.normalize_advantages.then(|| AdvantageScale::of(advantages)),
            n_rows: indices.len(),
        };
        self.stacks.begin(&self.network.vars)?;
        if let Some(encoder) = &mut self.encoder {
            encoder.pack(&self.network.vars)?;
        }
        let mut report = LossReport::default();
        // An encoder takes a block at a time; a recurrent one keeps its sequences together.
        let is_recurrent = self.is_recurrent();
        let by_block = self.encoder.is_some() && !is_recurrent;
        let at_once = if by_block { BLOCK } else { indices.len() };
        for rows in indices.chunks(at_once) {
            if let Some(encoder) = &mut self.encoder {
                let obs_dim = self.policy_spec.obs_dim;
                let input = EncoderInput { observations: &batch.features, samples: rows, obs_dim };
                let sequences =
                    if is_recurrent { batch.gather_sequences(rows) } else { Sequences::default() };
                let features = Features::OfRows(encoder.forward(input, sequences, &self.team));
                report.add(&self.stacks.run(&loss, features, rows, &self.team));
                encoder.backward(self.stacks.d_features(), &mut self.gradients, &self.team);
            } else {
                let features = Features::OfSamples(&batch.features);
                report.add(&self.stacks.run(&loss, features, rows, &self.team));
            }
            if !batch.staleness.is_empty() {
                let terms = self.stacks.policy_terms().iter();
                let staleness = rows.iter().map(|&row| batch.staleness[row]);
                clipped.count(staleness.zip(terms.map(|terms| terms.is_clipped)));
            }
        }
        self.gradients.extend(self.stacks.gradients());
        let norm = global_norm(&self.gradients);
        if norm.is_finite() {
            let scale = clip_factor(norm, self.settings.max_grad_norm);
            self.adam.step(&self.network.vars, &self.gradients, learning_rate, scale)?;
        }
        Ok((report, norm))
    }

    /// Finds outputs that no rollout may hold, where the size of the weights does not bound them already: heads
    /// that follow ego attention at once see features of any size. All others see the range of tanh.
    fn check_outputs(&self, rollouts: &[CheckedRollout]) -> Result<(), TrainError> {
        let is_bounded = !matches!(self.policy_spec.encoder, Encoder::EgoAttention(_))
            || !self.policy_spec.hidden.is_empty();
        if is_bounded {
            return Ok(());
        }
        let mut policy = Policy::new(&self.policy_spec, &self.parameters)?;
        let mut largest = 0.0_f64;
        for rollout in rollouts {
            let n = rollout.masks.len();
            let (mut logits, mut values) = (vec![0.0; n * policy.n_choices()], vec![0.0; n]);
            policy.evaluate(&rollout.observations, &mut [], &mut logits, &mut values);
            for output in logits.into_iter().chain(values) {
                let size = if output.is_nan() { f32::INFINITY } else { output.abs() };
                largest = largest.max(size.into());
            }
        }
        if largest > LARGEST_SUM {
            return Err(TrainError::Diverged(format!("the policy's outputs reach {largest:e}")));
        }
        Ok(())
    }

    fn is_recurrent(&self) -> bool {
        self.policy_spec.recurrent_dim() > 0
    }
}

/// Refuses an order that depends on who arrived first.
fn check_order(rollouts: &[CheckedRollout]) -> Result<(), TrainError> {
    if rollouts.is_empty() {
        return Err(TrainError::Rollouts("an update needs at least one rollout".to_owned()));
    }
    let sorted = |pair: &[CheckedRollout]| {
        (pair[0].env_id, pair[0].iteration) < (pair[1].env_id, pair[1].iteration)
    };
    match rollouts.windows(2).position(|pair| !sorted(pair)) {
        Some(i) => Err(TrainError::Rollouts(format!(
            "rollouts are not sorted by environment id and iteration at index {}",
            i + 1
        ))),
        None => Ok(()),
    }
}

/// Finds weights with which actors would make numbers that no rollout may hold: the run has diverged, and its actors
/// are not to blame for what they would send.
fn check_weights(network: &ActorCritic) -> Result<(), TrainError> {
    for (name, var) in &network.vars {
        let sum =
            with_floats(var, |values| values.iter().map(|&x| f64::from(x).abs()).sum::<f64>())?;
        if sum.is_nan() || sum > LARGEST_SUM {
            let says = format!("magnitudes of tensor `{name}` sum up to {sum:e}");
            return Err(TrainError::Diverged(says));
        }
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
        self.sum.divided(self.n.max(1) as f64)
    }
}

/// Samples by staleness: how many, and how many of them were clipped.
#[derive(Default)]
struct ClipCounts(BTreeMap<u64, [u64; 2]>);

impl ClipCounts {
    fn count(&mut self, rows: impl Iterator<Item = (u64, bool)>) {
        for (staleness, clipped) in rows {
            let [n, n_clipped] = self.0.entry(staleness).or_default();
            *n += 1;
            *n_clipped += u64::from(clipped);
        }
    }

    fn shares(&self) -> BTreeMap<u64, f64> {
        let share = |(&staleness, &[n, n_clipped]): (&u64, &[u64; 2])| {
            (staleness, n_clipped as f64 / n as f64)
        };
        self.0.iter().map(share).collect()
    }
}

/// What the epochs of an update add up to.
#[derive(Default)]
struct Totals {
    clipped: ClipCounts,
    all: Mean,
    last_epoch: Mean,
    gradient_norm: f64,
    n_epochs: u64,
}

#[cfg(test)]
#[path = "trainer_tests.rs"]
mod tests;
