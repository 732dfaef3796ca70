//! Rollouts that wait for their update, and where every environment stands.
//!
//! An environment has two places in time. `consumed` is the rollout boundary up to which updates have trained:
//! checkpoints hold it, because a resumed run goes on from there. `expected` is the boundary up to which
//! rollouts have arrived: an environment that moves to another actor goes on from there.
//!
//! ```text
//! env 0   r₀ r₁ │ r₂        │ = consumed      update 2 needs r₂ of every environment
//! env 1   r₀ r₁ │           end = expected    (deterministic schedules)
//! ```
//!
//! # Invariants
//!
//! * Rollouts of one environment are taken in the order of their iterations, without gaps.
//! * A deterministic schedule bounds the queue by itself (an actor cannot act ahead of the weights); `async`
//!   is bounded by [`Collector::room`], which is all that the learner gives credit for.

use std::collections::VecDeque;

use leadtime_proto::message::EnvAssignment;
use leadtime_proto::{CheckedRollout, EnvId, Iteration, PolicyVersion, Schedule, Staleness};

/// How many updates' worth of rollouts `async` lets wait.
const QUEUED_UPDATES: usize = 2;

/// Rollouts for one update, sorted by environment and iteration.
#[derive(Debug)]
pub struct Batch {
    /// The rollouts.
    pub rollouts: Vec<CheckedRollout>,
}

#[derive(Debug)]
struct EnvQueue {
    consumed: Iteration,
    snapshot: Vec<u8>,
    /// Arrival number and rollout.
    waiting: VecDeque<(u64, CheckedRollout)>,
}

impl EnvQueue {
    fn expected(&self) -> Iteration {
        Iteration(self.consumed.0 + self.waiting.len() as u64)
    }

    fn take(&mut self) -> Option<CheckedRollout> {
        let (_, mut rollout) = self.waiting.pop_front()?;
        self.snapshot = rollout.take_snapshot();
        self.consumed = self.consumed.next();
        Some(rollout)
    }
}

/// The queue between arrival and training.
#[derive(Debug)]
pub struct Collector {
    schedule: Schedule,
    envs: Vec<EnvQueue>,
    n_arrived: u64,
}

impl Collector {
    /// Starts from where the environments stand: a checkpoint's places, or the beginning.
    pub fn new(schedule: Schedule, places: Vec<EnvAssignment>) -> Self {
        let queue = |place: EnvAssignment| EnvQueue {
            consumed: place.iteration,
            snapshot: place.snapshot,
            waiting: VecDeque::new(),
        };
        Self { schedule, envs: places.into_iter().map(queue).collect(), n_arrived: 0 }
    }

    /// Returns the places of `n_envs` environments that have not begun.
    pub fn beginning(n_envs: usize) -> Vec<EnvAssignment> {
        let place =
            |id| EnvAssignment { env_id: EnvId(id), iteration: Iteration(0), snapshot: Vec::new() };
        (0_u32..).take(n_envs).map(place).collect()
    }

    /// Returns the iteration that an environment's next rollout must have; `None` if there is no such environment.
    pub fn expected(&self, env_id: EnvId) -> Option<Iteration> {
        self.envs.get(env_id.0 as usize).map(EnvQueue::expected)
    }

    /// Puts a rollout into the queue.
    ///
    /// # Panics
    ///
    /// If it is not the environment's expected one: the caller checks.
    pub fn accept(&mut self, rollout: CheckedRollout) {
        let env = &mut self.envs[rollout.env_id.0 as usize];
        assert_eq!(rollout.iteration, env.expected(), "rollouts are accepted in order");
        env.waiting.push_back((self.n_arrived, rollout));
        self.n_arrived += 1;
    }

    /// Returns how many rollouts wait.
    pub fn len(&self) -> usize {
        self.envs.iter().map(|env| env.waiting.len()).sum()
    }

    /// Tells whether nothing waits.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns how many more rollouts may come; `None` where the schedule sees to it.
    pub fn room(&self) -> Option<usize> {
        let all = QUEUED_UPDATES * self.envs.len();
        (!self.schedule.is_deterministic()).then(|| all.saturating_sub(self.len()))
    }

    /// Returns where an environment goes on when it moves: after its newest rollout.
    pub fn newest(&self, env_id: EnvId) -> EnvAssignment {
        let env = &self.envs[env_id.0 as usize];
        let snapshot = env.waiting.back().map_or(&env.snapshot, |(_, rollout)| &rollout.snapshot);
        EnvAssignment { env_id, iteration: env.expected(), snapshot: snapshot.clone() }
    }

    /// Returns where every environment goes on after a resume: after its last consumed rollout.
    pub fn consumed(&self) -> Vec<EnvAssignment> {
        let place = |(id, env): (u32, &EnvQueue)| EnvAssignment {
            env_id: EnvId(id),
            iteration: env.consumed,
            snapshot: env.snapshot.clone(),
        };
        (0_u32..).zip(&self.envs).map(place).collect()
    }

    /// Drops what is too stale for a learner at `version` and returns how many rollouts that was.
    pub fn drop_stale(&mut self, version: PolicyVersion) -> u64 {
        let Schedule::Async { staleness_max } = self.schedule else { return 0 };
        let mut n_dropped = 0;
        for env in &mut self.envs {
            while env.waiting.front().is_some_and(|(_, rollout)| {
                Staleness::between(version, rollout.version) > Staleness(staleness_max)
            }) {
                env.take();
                n_dropped += 1;
            }
        }
        n_dropped
    }

    /// Takes the rollouts of the update that turns `version` into the next one, if they are all here.
    pub fn take_batch(&mut self, version: PolicyVersion) -> Option<Batch> {
        let mut rollouts = if self.schedule.is_deterministic() {
            let ready = self.envs.iter().all(|env| {
                env.waiting.front().is_some_and(|(_, rollout)| rollout.iteration.0 == version.0)
            });
            if !ready {
                return None;
            }
            self.envs.iter_mut().filter_map(EnvQueue::take).collect()
        } else {
            self.take_first_arrived()?
        };
        rollouts.sort_by_key(|rollout| (rollout.env_id, rollout.iteration));
        Some(Batch { rollouts })
    }

    fn take_first_arrived(&mut self) -> Option<Vec<CheckedRollout>> {
        let n_wanted = self.envs.len();
        if self.len() < n_wanted {
            return None;
        }
        let earliest = |envs: &mut Vec<EnvQueue>| {
            let waiting = envs.iter_mut().filter(|env| !env.waiting.is_empty());
            waiting.min_by_key(|env| env.waiting[0].0).and_then(EnvQueue::take)
        };
        (0..n_wanted).map(|_| earliest(&mut self.envs)).collect()
    }
}

#[cfg(test)]
mod tests {
    use leadtime_proto::{ActionSpec, EnvSpec, Rollout};

    use super::*;

    /// Makes a rollout of no steps.
    fn rollout(env_id: u32, iteration: u64, version: u64) -> CheckedRollout {
        let rollout = Rollout {
            env_id: EnvId(env_id),
            iteration: Iteration(iteration),
            version: PolicyVersion(version),
            snapshot: vec![env_id as u8, iteration as u8],
            ..Rollout::default()
        };
        let actions = ActionSpec::discrete("a", 2);
        rollout.check(&EnvSpec { obs_dim: 0, actions, metrics: Vec::new() }, 0, 0).unwrap()
    }

    fn ids(batch: Option<Batch>) -> Vec<(u32, u64)> {
        let rollouts = batch.map(|batch| batch.rollouts).unwrap_or_default();
        rollouts.iter().map(|rollout| (rollout.env_id.0, rollout.iteration.0)).collect()
    }

    #[test]
    fn an_update_takes_its_own_iteration_of_every_environment_in_their_order() {
        let mut collector = Collector::new(Schedule::Lag(1), Collector::beginning(2));
        collector.accept(rollout(1, 0, 0));
        collector.accept(rollout(1, 1, 0));
        assert!(collector.take_batch(PolicyVersion(0)).is_none(), "environment 0 is missing");
        collector.accept(rollout(0, 0, 0));
        assert_eq!(ids(collector.take_batch(PolicyVersion(0))), [(0, 0), (1, 0)]);
        assert!(collector.take_batch(PolicyVersion(1)).is_none());
        assert_eq!(collector.len(), 1);
    }

    #[test]
    fn a_move_goes_on_after_the_newest_rollout_and_a_resume_after_the_consumed_one() {
        let mut collector = Collector::new(Schedule::Lag(1), Collector::beginning(1));
        assert_eq!(collector.newest(EnvId(0)).snapshot, Vec::<u8>::new());
        collector.accept(rollout(0, 0, 0));
        collector.accept(rollout(0, 1, 0));
        collector.take_batch(PolicyVersion(0)).unwrap();
        let (moved, resumed) = (collector.newest(EnvId(0)), collector.consumed().remove(0));
        assert_eq!((moved.iteration, moved.snapshot), (Iteration(2), vec![0, 1]));
        assert_eq!((resumed.iteration, resumed.snapshot), (Iteration(1), vec![0, 0]));
        assert_eq!(collector.expected(EnvId(0)), Some(Iteration(2)));
        assert_eq!(collector.expected(EnvId(1)), None);
    }

    #[test]
    fn async_takes_the_first_to_arrive_even_twice_from_one_environment() {
        let schedule = Schedule::Async { staleness_max: 1 };
        let mut collector = Collector::new(schedule, Collector::beginning(2));
        collector.accept(rollout(1, 0, 0));
        assert!(collector.take_batch(PolicyVersion(0)).is_none());
        collector.accept(rollout(1, 1, 0));
        collector.accept(rollout(0, 0, 0));
        assert_eq!(ids(collector.take_batch(PolicyVersion(0))), [(1, 0), (1, 1)]);
        assert_eq!(collector.len(), 1);
    }

    #[test]
    fn async_drops_what_is_too_stale_and_is_full_at_twice_an_update() {
        let schedule = Schedule::Async { staleness_max: 1 };
        let mut collector = Collector::new(schedule, Collector::beginning(1));
        collector.accept(rollout(0, 0, 0));
        assert_eq!(collector.room(), Some(1));
        collector.accept(rollout(0, 1, 2));
        assert_eq!(collector.room(), Some(0));
        assert_eq!(collector.drop_stale(PolicyVersion(1)), 0);
        assert_eq!(collector.drop_stale(PolicyVersion(2)), 1);
        assert_eq!(collector.consumed()[0].iteration, Iteration(1));
        assert_eq!(ids(collector.take_batch(PolicyVersion(2))), [(0, 1)]);
    }
}
