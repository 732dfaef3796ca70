//! Collecting rollouts: environments stepped in lockstep under one policy.
//!
//! ```text
//! step 0   [lane 0 | lane 3 | lane 5] -- one batched inference --> an action each --> one step each
//! step 1   ...
//! step T   value of the next observation, a snapshot each  ->  three rollouts
//! ```
//!
//! Only lanes at the same iteration are stepped together, the lowest first. Which lanes these are makes no
//! difference to the bits: every lane draws from its own stream, opened anew for every rollout, and inference
//! is row-invariant.
//!
//! # Invariants
//!
//! * No clock, no network: time is measured by the [`Stopwatch`] that the caller brings.
//! * The buffers of observations, logits and rollouts are reused; a step allocates nothing of its own but what
//!   an episode's end needs.

use std::collections::BTreeMap;

use leadtime_numerics::Pcg64;
use leadtime_policy::{ActionDistribution, Policy};
use leadtime_proto::message::EnvAssignment;
use leadtime_proto::{EnvId, EnvSpec, EpisodeEnd, Iteration, PolicySpec, PolicyVersion, Rollout};
use leadtime_sims::{End, Environment, SnapshotError};

use crate::lane::Lane;

/// What collecting spends its time on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Inference and sampling.
    Infer,
    /// Environments.
    Simulate,
}

/// Measures how long phases take.
pub trait Stopwatch {
    /// Ends a phase that began when the phase before it ended.
    fn lap(&mut self, phase: Phase);
}

/// Measures nothing.
impl Stopwatch for () {
    fn lap(&mut self, _phase: Phase) {}
}

/// What all lanes of a worker have in common.
#[derive(Clone, Debug)]
pub struct WorkerSettings {
    /// Seed of every random stream.
    pub run_seed: u64,
    /// Steps per rollout.
    pub n_steps: u32,
    /// The environments' shapes.
    pub env: EnvSpec,
    /// The policy's.
    pub policy: PolicySpec,
}

/// Buffers of one batched inference.
#[derive(Debug, Default)]
struct Batch {
    observations: Vec<f32>,
    recurrent: Vec<f32>,
    logits: Vec<f32>,
    values: Vec<f32>,
}

/// Final observations whose values are wanted, and the rollouts and ends they belong to.
#[derive(Debug, Default)]
struct Finals {
    owners: Vec<(usize, usize)>,
    observations: Vec<f32>,
    recurrent: Vec<f32>,
    values: Vec<f32>,
}

/// A set of environments and the means to collect rollouts from them.
pub struct Worker {
    settings: WorkerSettings,
    distribution: ActionDistribution,
    lanes: BTreeMap<EnvId, Lane>,
    rollouts: Vec<Rollout>,
    batch: Batch,
    finals: Finals,
    action: Vec<u8>,
}

impl std::fmt::Debug for Worker {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Worker").field("lanes", &self.lanes.keys()).finish_non_exhaustive()
    }
}

impl Worker {
    /// Starts without environments.
    pub fn new(settings: WorkerSettings) -> Self {
        let policy = &settings.policy;
        Self {
            distribution: ActionDistribution::new(&policy.actions, policy.head_credit),
            action: vec![0; policy.actions.heads.len()],
            lanes: BTreeMap::new(),
            rollouts: Vec::new(),
            batch: Batch::default(),
            finals: Finals::default(),
            settings,
        }
    }

    /// Takes an environment in, from its snapshot or from the beginning; one of the same id is replaced.
    ///
    /// # Errors
    ///
    /// [`SnapshotError`] if the snapshot is not one of such an environment.
    pub fn insert(
        &mut self,
        env: Box<dyn Environment>,
        assignment: &EnvAssignment,
    ) -> Result<(), SnapshotError> {
        let recurrent_dim = self.settings.policy.recurrent_dim();
        let lane = Lane::new(self.settings.run_seed, env, recurrent_dim, assignment)?;
        self.lanes.insert(assignment.env_id, lane);
        Ok(())
    }

    /// Lets go of all environments but these.
    pub fn retain(&mut self, keep: &[EnvId]) {
        self.lanes.retain(|env_id, _| keep.contains(env_id));
    }

    /// Lists the environments with the iteration that each does next.
    pub fn lanes(&self) -> impl Iterator<Item = (EnvId, Iteration)> {
        self.lanes.values().map(|lane| (lane.env_id, lane.iteration))
    }

    /// Returns the lowest iteration of any environment: the one that is collected next.
    pub fn next_iteration(&self) -> Option<Iteration> {
        self.lanes.values().map(|lane| lane.iteration).min()
    }

    /// Collects one rollout from every environment that is at the lowest iteration.
    ///
    /// The rollouts are in the order of environment ids, and stay until the next call.
    pub fn collect(
        &mut self,
        policy: &mut Policy,
        version: PolicyVersion,
        watch: &mut dyn Stopwatch,
    ) -> &[Rollout] {
        let iteration = self.next_iteration();
        let lanes: Vec<&mut Lane> =
            self.lanes.values_mut().filter(|lane| Some(lane.iteration) == iteration).collect();
        self.rollouts.resize_with(lanes.len(), Rollout::default);
        let mut round = Round {
            dims: Dims::of(&self.settings, lanes.len()),
            streams: lanes.iter().map(|lane| lane.action_stream()).collect(),
            lanes,
            rollouts: &mut self.rollouts,
        };
        round.begin(version, self.settings.n_steps);
        for step in 0..self.settings.n_steps {
            self.batch.gather(&round.lanes, round.dims);
            let Batch { observations, recurrent, logits, values } = &mut self.batch;
            policy.evaluate(observations, recurrent, logits, values);
            round.act(&self.batch, &self.distribution, &mut self.action);
            watch.lap(Phase::Infer);
            round.step(step, &mut self.finals);
            watch.lap(Phase::Simulate);
            self.finals.evaluate(policy, round.rollouts);
        }
        self.batch.gather(&round.lanes, round.dims);
        let Batch { observations, recurrent, values, .. } = &mut self.batch;
        policy.values_only(observations, recurrent, values);
        watch.lap(Phase::Infer);
        round.finish(values);
        watch.lap(Phase::Simulate);
        &self.rollouts
    }
}

/// One rollout of several lanes in the making.
struct Round<'a> {
    lanes: Vec<&'a mut Lane>,
    rollouts: &'a mut [Rollout],
    streams: Vec<Pcg64>,
    dims: Dims,
}

impl Round<'_> {
    fn begin(&mut self, version: PolicyVersion, n_steps: u32) {
        for (lane, rollout) in self.lanes.iter().zip(self.rollouts.iter_mut()) {
            begin(rollout, lane, version, n_steps);
        }
    }

    /// Samples an action for every lane and writes down what it acted on.
    fn act(&mut self, batch: &Batch, distribution: &ActionDistribution, action: &mut [u8]) {
        let Dims { state, choices, .. } = self.dims;
        for (row, lane) in self.lanes.iter_mut().enumerate() {
            lane.recurrent.copy_from_slice(&batch.recurrent[row * state..][..state]);
            let rollout = &mut self.rollouts[row];
            let mask = lane.env.mask();
            let logits = &batch.logits[row * choices..][..choices];
            let log_prob = distribution.sample(logits, mask, &mut self.streams[row], action);
            rollout.observations.extend_from_slice(&lane.observation);
            rollout.masks.push(mask.0);
            rollout.actions.extend_from_slice(action);
            rollout.log_probs.push(log_prob);
            rollout.values.push(batch.values[row]);
        }
    }

    /// Steps every lane with the action just sampled.
    fn step(&mut self, step: u32, finals: &mut Finals) {
        let n_heads = self.dims.heads;
        for (row, lane) in self.lanes.iter_mut().enumerate() {
            let rollout = &mut self.rollouts[row];
            let action = &rollout.actions[step as usize * n_heads..][..n_heads];
            let outcome = lane.env.step(action, &mut lane.observation);
            rollout.rewards.push(outcome.reward);
            lane.count(outcome.reward);
            if let Some(end) = outcome.end {
                let truncated = end == End::Truncated;
                if truncated {
                    finals.want(row, rollout.ends.len(), lane);
                }
                rollout.ends.push(end_of_episode(lane, step, truncated));
                lane.next_episode();
            }
        }
    }

    /// Writes down where every lane stands.
    fn finish(&mut self, values: &[f32]) {
        for (row, lane) in self.lanes.iter_mut().enumerate() {
            let rollout = &mut self.rollouts[row];
            rollout.next_observation.extend_from_slice(&lane.observation);
            rollout.next_value = values[row];
            lane.snapshot(&mut rollout.snapshot);
            lane.iteration = lane.iteration.next();
        }
    }
}

/// Widths of a lockstep batch.
#[derive(Clone, Copy, Debug)]
struct Dims {
    lanes: usize,
    state: usize,
    choices: usize,
    heads: usize,
}

impl Dims {
    fn of(settings: &WorkerSettings, lanes: usize) -> Self {
        let actions = &settings.policy.actions;
        Self {
            lanes,
            state: settings.policy.recurrent_dim(),
            choices: actions.n_choices(),
            heads: actions.heads.len(),
        }
    }
}

impl Batch {
    /// Fills the inputs from the lanes and makes room for the outputs.
    fn gather(&mut self, lanes: &[&mut Lane], dims: Dims) {
        self.observations.clear();
        self.recurrent.clear();
        for lane in lanes {
            self.observations.extend_from_slice(&lane.observation);
            self.recurrent.extend_from_slice(&lane.recurrent);
        }
        self.logits.resize(dims.lanes * dims.choices, 0.0);
        self.values.resize(dims.lanes, 0.0);
    }
}

impl Finals {
    /// Notes that the value of a lane's observation is wanted for an episode end.
    fn want(&mut self, row: usize, end: usize, lane: &Lane) {
        self.owners.push((row, end));
        self.observations.extend_from_slice(&lane.observation);
        self.recurrent.extend_from_slice(&lane.recurrent);
    }

    fn evaluate(&mut self, policy: &mut Policy, rollouts: &mut [Rollout]) {
        if self.owners.is_empty() {
            return;
        }
        self.values.resize(self.owners.len(), 0.0);
        policy.values_only(&self.observations, &self.recurrent, &mut self.values);
        for (&(row, end), &value) in self.owners.iter().zip(&self.values) {
            rollouts[row].ends[end].final_value = value;
        }
        self.owners.clear();
        self.observations.clear();
        self.recurrent.clear();
    }
}

/// Empties a rollout that was used before and notes what it is.
fn begin(rollout: &mut Rollout, lane: &Lane, version: PolicyVersion, n_steps: u32) {
    rollout.env_id = lane.env_id;
    rollout.iteration = lane.iteration;
    rollout.version = version;
    rollout.n_steps = n_steps;
    rollout.observations.clear();
    rollout.next_observation.clear();
    rollout.masks.clear();
    rollout.actions.clear();
    rollout.log_probs.clear();
    rollout.values.clear();
    rollout.rewards.clear();
    rollout.ends.clear();
    rollout.recurrent.clone_from(&lane.recurrent);
    rollout.snapshot.clear();
}

fn end_of_episode(lane: &Lane, step: u32, truncated: bool) -> EpisodeEnd {
    EpisodeEnd {
        step,
        truncated,
        final_observation: lane.observation.clone(),
        final_value: 0.0,
        summary: lane.summary(),
    }
}

#[cfg(test)]
mod tests;
