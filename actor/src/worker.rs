//! Collecting rollouts: environments stepped in lockstep under one policy.
//!
//! ```text
//! step 0   [slot 0 | slot 3 | slot 5] -- one batched inference --> an action each --> one step each
//! step 1   ...
//! step T   value of the next observation, a snapshot each  ->  three rollouts
//! ```
//!
//! Only environments at the same iteration are stepped together, the lowest first. Which ones these are makes no
//! difference to the bits: every slot draws from its own stream, opened anew for every rollout, and inference is
//! row-invariant.
//!
//! # Invariants
//!
//! * No clock, no network: time is measured by the [`Stopwatch`] that the caller brings.
//! * The buffers of observations, logits and rollouts are reused; a step allocates nothing of its own but what
//!   an episode's end needs.

use std::collections::BTreeMap;

use leadtime_episodes::{Choice, Decider, Decision, EnvSlot, Lockstep, Observer};
use leadtime_numerics::{Purpose, stream};
use leadtime_policy::{ActionDistribution, Policy};
use leadtime_proto::message::EnvAssignment;
use leadtime_proto::{EnvId, EpisodeEnd, Iteration, PolicyVersion, Rollout, RowRepeats, RunSpec};
use leadtime_sims::{End, Environment, EpisodeSeed, SnapshotError, StepOutcome};

/// What collecting spends its time on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Inference and sampling.
    Infer,
    /// Stepping the environments.
    Simulate,
}

/// Measures how long phases take.
pub trait Stopwatch {
    /// Ends a phase that began when the phase before it ended.
    fn lap(&mut self, phase: Phase);
}

/// For a caller who measures nothing: every lap is dropped.
impl Stopwatch for () {
    fn lap(&mut self, _phase: Phase) {}
}

/// A set of environments and the means to collect rollouts from them.
#[derive(Debug)]
pub struct Worker {
    spec: RunSpec,
    distribution: ActionDistribution,
    /// Each with the iteration that it does next.
    slots: BTreeMap<EnvId, (Iteration, EnvSlot)>,
    lockstep: Lockstep,
    rollouts: Vec<Rollout>,
}

impl Worker {
    /// Starts without environments.
    pub fn new(spec: RunSpec) -> Self {
        let policy = &spec.policy;
        Self {
            distribution: ActionDistribution::new(&policy.actions, policy.head_credit),
            slots: BTreeMap::new(),
            lockstep: Lockstep::default(),
            rollouts: Vec::new(),
            spec,
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
        let slot = ready_slot(&self.spec, env, assignment)?;
        self.adopt(assignment.iteration, slot);
        Ok(())
    }

    /// Takes in an environment that is ready to be stepped; one of the same id is replaced.
    pub(crate) fn adopt(&mut self, iteration: Iteration, slot: EnvSlot) {
        self.slots.insert(slot.seed().env_id, (iteration, slot));
    }

    /// Drops all environments except these.
    pub fn retain(&mut self, keep: &[EnvId]) {
        self.slots.retain(|env_id, _| keep.contains(env_id));
    }

    /// Returns the lowest iteration of any environment: the one that is collected next.
    pub fn next_iteration(&self) -> Option<Iteration> {
        self.slots.values().map(|(iteration, _)| *iteration).min()
    }

    /// Returns an environment that cannot be stepped any more, and why, if there is one: the rollouts of its batch mean nothing.
    pub fn failure(&self) -> Option<(EnvId, String)> {
        self.slots.iter().find_map(|(env_id, (_, slot))| Some((*env_id, slot.env().failure()?)))
    }

    /// Collects one rollout from every environment that is at the lowest iteration.
    ///
    /// The rollouts are in the order of environment ids, and stay until the next call; what happens to them meanwhile does not
    /// matter.
    pub fn collect(
        &mut self,
        policy: &mut Policy,
        version: PolicyVersion,
        watch: &mut dyn Stopwatch,
    ) -> &mut [Rollout] {
        let Some(iteration) = self.next_iteration() else { return &mut [] };
        let (run_seed, n_steps) = (self.spec.seed, self.spec.n_steps);
        let at_it = self.slots.values_mut().filter(|(at, _)| *at == iteration);
        let mut slots: Vec<&mut EnvSlot> = at_it
            .map(|(at, slot)| {
                *at = iteration.next();
                let env_id = slot.seed().env_id;
                slot.draw_from(stream(run_seed, Purpose::Act, env_id.0, iteration.0));
                slot
            })
            .collect();
        self.rollouts.resize_with(slots.len(), Rollout::default);
        let begun = slots.iter().zip(&mut self.rollouts).map(|(slot, rollout)| {
            begin(rollout, slot, n_steps);
            (rollout.iteration, rollout.version) = (iteration, version);
            Recorder { rollout }
        });
        let mut recorders: Vec<Recorder<'_>> = begun.collect();
        let lockstep = &mut self.lockstep;
        for _ in 0..n_steps {
            let (distribution, choice) = (&self.distribution, Choice::Sample);
            let mut decider = Decider::Policy { policy: &mut *policy, distribution, choice };
            lockstep.act(&mut decider, &mut slots, &mut recorders);
            watch.lap(Phase::Infer);
            lockstep.advance(&mut slots, &mut recorders);
            watch.lap(Phase::Simulate);
            if lockstep.ended().is_empty() {
                continue;
            }
            // The slots still show the final observations, which beginning another episode overwrites.
            for (row, value) in lockstep.final_values(policy, &slots) {
                if let Some(end) = recorders[row].rollout.ends.last_mut() {
                    end.final_value = value;
                }
            }
            watch.lap(Phase::Infer);
            lockstep.ended().iter().for_each(|&(row, _)| slots[row].begin_next());
            watch.lap(Phase::Simulate);
        }
        let values = lockstep.values(policy, &slots);
        watch.lap(Phase::Infer);
        for ((slot, Recorder { rollout }), value) in slots.iter().zip(recorders).zip(values) {
            rollout.next_observation.extend_from_slice(slot.observation());
            rollout.next_value = *value;
            slot.snapshot(&mut rollout.snapshot);
        }
        watch.lap(Phase::Simulate);
        &mut self.rollouts
    }
}

/// Makes an environment ready to be stepped, from its snapshot or from the beginning.
pub(crate) fn ready_slot(
    spec: &RunSpec,
    env: Box<dyn Environment>,
    assignment: &EnvAssignment,
) -> Result<EnvSlot, SnapshotError> {
    let (run_seed, env_id) = (spec.seed, assignment.env_id);
    let recurrent_dim = spec.policy.recurrent_dim();
    if assignment.snapshot.is_empty() {
        // After a snapshot was lost in the middle of a run, no episode is played once more: an environment has not ended more
        // of them than it has taken steps.
        let episode = assignment.iteration.0.saturating_mul(spec.n_steps.into());
        let seed = EpisodeSeed { run_seed, env_id, episode };
        return Ok(EnvSlot::new(env, recurrent_dim, seed));
    }
    EnvSlot::restored(env, recurrent_dim, run_seed, env_id, &assignment.snapshot)
}

/// Writes a slot's steps into a rollout.
struct Recorder<'a> {
    rollout: &'a mut Rollout,
}

impl Observer for Recorder<'_> {
    fn on_decision(&mut self, slot: &EnvSlot, decision: &Decision<'_>) {
        let rollout = &mut *self.rollout;
        rollout.observations.extend_from_slice(slot.observation());
        rollout.masks.push(decision.mask.0);
        rollout.actions.extend_from_slice(decision.choices);
        rollout.log_probs.push(decision.log_prob);
        rollout.values.push(decision.value);
    }

    fn on_step(&mut self, slot: &EnvSlot, outcome: StepOutcome) {
        let step = self.rollout.rewards.len() as u32;
        self.rollout.rewards.push(outcome.reward);
        if let Some(end) = outcome.end {
            self.rollout.ends.push(EpisodeEnd {
                step,
                truncated: end == End::Truncated,
                final_observation: slot.observation().to_vec(),
                final_value: 0.0,
                summary: slot.summary(),
            });
        }
    }
}

/// Empties a rollout that was used before and notes where it starts.
fn begin(rollout: &mut Rollout, slot: &EnvSlot, n_steps: u32) {
    rollout.env_id = slot.seed().env_id;
    rollout.n_steps = n_steps;
    rollout.observations.clear();
    rollout.repeats = RowRepeats::default();
    rollout.next_observation.clear();
    rollout.masks.clear();
    rollout.actions.clear();
    rollout.log_probs.clear();
    rollout.values.clear();
    rollout.rewards.clear();
    rollout.ends.clear();
    rollout.recurrent.clear();
    rollout.recurrent.extend_from_slice(slot.recurrent());
    rollout.snapshot.clear();
}

#[cfg(test)]
mod tests;
