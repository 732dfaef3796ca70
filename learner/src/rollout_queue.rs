//! Rollouts that wait for their update, and where every environment stands.
//!
//! Each environment has three cursors, each a rollout boundary with the state there:
//!
//! ```text
//! env 0   r₀ r₁ ┃ r₂ │ r₃      ┃ consumed   updates up to here are done: checkpoints hold it, a resume goes on there
//! env 1   r₀ r₁ ┃ r₂ │         │ training   the update under way ends here
//!                              end  newest  rollouts have arrived up to here: a move to another actor goes on there
//! ```
//!
//! # Invariants
//!
//! * Rollouts of one environment are taken in the order of their iterations, without gaps.
//! * `consumed` moves when an update is done, not when it begins: so a checkpoint can be written while the next
//!   update is under way, and matches the trainer's state before it.
//! * A deterministic schedule bounds the queue by itself (an actor cannot act ahead of the weights); `async`
//!   is bounded by [`RolloutQueue::room`], which is all that the learner gives credit for.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use leadtime_proto::message::EnvAssignment;
use leadtime_proto::{
    ActorId, CheckedRollout, EnvId, Iteration, PolicyVersion, Refusal, Schedule, Staleness,
};

use crate::books::SenderKey;

/// How many updates' worth of rollouts `async` lets wait.
const QUEUED_UPDATES: usize = 2;

/// The actors that do not go on from a snapshot, each with the refusals of what it made from it; without one it cannot restore it.
pub type Doubters = BTreeMap<ActorId, Vec<Refusal>>;

/// A rollout boundary of one environment.
#[derive(Clone, Debug, Default)]
struct Cursor {
    /// The iteration that comes next.
    iteration: Iteration,
    /// The state there; empty: a fresh episode begins.
    snapshot: Vec<u8>,
    /// Who sent the snapshot; `None` for one from a checkpoint.
    author: Option<SenderKey>,
    /// Who began the episode that goes on there; `None` if that was before a checkpoint.
    begun_by: Option<SenderKey>,
}

#[derive(Debug)]
struct Waiting {
    arrival: u64,
    author: SenderKey,
    /// As of [`Cursor`], where the rollout ends.
    begun_by: Option<SenderKey>,
    rollout: CheckedRollout,
}

/// The state at an environment's newest boundary, and who is answerable for it.
#[derive(Debug)]
struct NewestState<'a> {
    snapshot: &'a [u8],
    author: Option<&'a SenderKey>,
    begun_by: Option<&'a SenderKey>,
}

#[derive(Debug, Default)]
struct EnvQueue {
    consumed: Cursor,
    training: Option<Cursor>,
    waiting: VecDeque<Waiting>,
    /// The actors that did not go on from the newest snapshot.
    doubters: Doubters,
}

impl EnvQueue {
    /// Returns the boundary before the first waiting rollout.
    fn taken(&mut self) -> &mut Cursor {
        self.training.as_mut().unwrap_or(&mut self.consumed)
    }

    fn expected(&self) -> Iteration {
        let taken = self.training.as_ref().unwrap_or(&self.consumed);
        // Waiting rollouts have no gaps, so their number says which one comes next.
        Iteration(taken.iteration.0 + self.waiting.len() as u64)
    }

    fn newest(&self) -> NewestState<'_> {
        let taken = self.training.as_ref().unwrap_or(&self.consumed);
        match self.waiting.back() {
            Some(last) => NewestState {
                snapshot: &last.rollout.snapshot,
                author: Some(&last.author),
                begun_by: last.begun_by.as_ref(),
            },
            None => NewestState {
                snapshot: &taken.snapshot,
                author: taken.author.as_ref(),
                begun_by: taken.begun_by.as_ref(),
            },
        }
    }

    fn take(&mut self) -> Option<CheckedRollout> {
        let Waiting { author, begun_by, mut rollout, .. } = self.waiting.pop_front()?;
        // A second rollout of the same environment in one `async` batch replaces this boundary by its own, later one.
        self.training = Some(Cursor {
            iteration: rollout.iteration.next(),
            snapshot: rollout.take_snapshot(),
            author: Some(author),
            begun_by,
        });
        Some(rollout)
    }

    fn commit(&mut self) {
        if let Some(cursor) = self.training.take() {
            self.consumed = cursor;
        }
    }
}

/// What happens to an environment whose newest snapshot is given up.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Recovery {
    /// The rollout that ended there was still waiting: it is dropped and made again. Who sent it.
    Redo(SenderKey),
    /// It is trained, or under way: the environment begins a fresh episode. Who sent the snapshot; `None` if it comes
    /// from a checkpoint.
    FreshEpisode(Option<SenderKey>),
}

/// The queue between arrival and training.
#[derive(Debug)]
pub struct RolloutQueue {
    schedule: Schedule,
    envs: Vec<EnvQueue>,
    n_arrived: u64,
    /// Those whose next rollout of a batch does not begin where the last one ended.
    broken_off: BTreeSet<EnvId>,
    /// Those whose `consumed` has passed over dropped rollouts since the last update that is done.
    passed_over: BTreeSet<EnvId>,
}

impl RolloutQueue {
    /// Starts from where the environments stand: a checkpoint's places, or the beginning.
    pub fn new(schedule: Schedule, places: Vec<EnvAssignment>) -> Self {
        let queue = |place: EnvAssignment| EnvQueue {
            consumed: Cursor {
                iteration: place.iteration,
                snapshot: place.snapshot,
                ..Cursor::default()
            },
            ..EnvQueue::default()
        };
        // Where a fresh episode begins, that of before may have been given up.
        let broken_off = places.iter().filter(|place| place.snapshot.is_empty());
        let broken_off = broken_off.map(|place| place.env_id).collect();
        let envs = places.into_iter().map(queue).collect();
        Self { schedule, envs, n_arrived: 0, broken_off, passed_over: BTreeSet::new() }
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

    /// Puts a rollout into the queue. Returns the actors that had not gone on from the snapshot that it began with.
    ///
    /// # Panics
    ///
    /// If it is not the environment's expected one: the caller checks.
    pub fn accept(&mut self, author: SenderKey, rollout: CheckedRollout) -> Doubters {
        let env = &mut self.envs[rollout.env_id.0 as usize];
        assert_eq!(rollout.iteration, env.expected(), "rollouts are accepted in order");
        let before = env.newest();
        // No episode depends on the one before: the actor that begins one answers for all of it, until another goes on with it.
        let begins = before.snapshot.is_empty() || !rollout.ends.is_empty();
        let begun_by = if begins { Some(author.clone()) } else { before.begun_by.cloned() };
        env.waiting.push_back(Waiting { arrival: self.n_arrived, author, begun_by, rollout });
        self.n_arrived += 1;
        // They doubted the snapshot before this one, which nobody has to restore any more.
        std::mem::take(&mut env.doubters)
    }

    /// Returns how many rollouts wait.
    pub fn len(&self) -> usize {
        self.envs.iter().map(|env| env.waiting.len()).sum()
    }

    /// Returns whether nothing waits.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns how many more rollouts may come; `None` if the schedule already limits them.
    pub fn room(&self) -> Option<usize> {
        // Twice an update: one batch can fill up while another is trained, and what waits longer only grows stale.
        let all = QUEUED_UPDATES * self.envs.len();
        (!self.schedule.is_deterministic()).then(|| all.saturating_sub(self.len()))
    }

    /// Lists the environments of which no rollout waits: a deterministic schedule's next update lacks theirs.
    pub fn lacking(&self) -> impl Iterator<Item = EnvId> {
        let lacking = (0_u32..).zip(&self.envs).filter(|(_, env)| env.waiting.is_empty());
        lacking.map(|(id, _)| EnvId(id))
    }

    /// Returns where an environment goes on when it moves: after its newest rollout.
    pub fn newest(&self, env_id: EnvId) -> EnvAssignment {
        let env = &self.envs[env_id.0 as usize];
        let snapshot = env.newest().snapshot.to_vec();
        EnvAssignment { env_id, iteration: env.expected(), snapshot }
    }

    /// Returns whether what a start of an actor makes of an environment next may follow from what others have made of it: not if it
    /// began the episode, and nobody else went on with it.
    pub fn is_inherited(&self, env_id: EnvId, by: &SenderKey) -> bool {
        let newest = self.envs[env_id.0 as usize].newest();
        let is_own = newest.author == Some(by) && newest.begun_by == Some(by);
        !newest.snapshot.is_empty() && !is_own
    }

    /// Returns whether another actor than the sender of an environment's newest snapshot began the episode that goes on there.
    pub fn is_passed_on(&self, env_id: EnvId) -> bool {
        let newest = self.envs[env_id.0 as usize].newest();
        newest.author != newest.begun_by
    }

    /// Returns whether an actor began the episode that goes on there, or sent the snapshot.
    pub fn had(&self, env_id: EnvId, actor: &ActorId) -> bool {
        let newest = self.envs[env_id.0 as usize].newest();
        [newest.author, newest.begun_by].into_iter().flatten().any(|(name, _)| name == actor)
    }

    /// Returns whether an actor is known to have had nothing to do with that episode: one other actor alone had it.
    pub fn is_impartial(&self, env_id: EnvId, actor: &ActorId) -> bool {
        let is_known = self.envs[env_id.0 as usize].newest().author.is_some();
        is_known && !self.is_passed_on(env_id) && !self.had(env_id, actor)
    }

    /// Returns who began the episode that goes on there; `None` if that was before a checkpoint.
    pub fn begun_by(&self, env_id: EnvId) -> Option<&SenderKey> {
        self.envs[env_id.0 as usize].newest().begun_by
    }

    /// Returns where every environment goes on after a resume: after its last consumed rollout.
    pub fn consumed(&self) -> Vec<EnvAssignment> {
        let place = |(id, env): (u32, &EnvQueue)| EnvAssignment {
            env_id: EnvId(id),
            iteration: env.consumed.iteration,
            snapshot: env.consumed.snapshot.clone(),
        };
        (0_u32..).zip(&self.envs).map(place).collect()
    }

    /// Notes that an actor does not go on from an environment's newest snapshot: it cannot restore it, or what it made from it was
    /// refused.
    pub fn doubt(&mut self, env_id: EnvId, actor: &ActorId, refusal: Option<Refusal>) {
        let doubters = &mut self.envs[env_id.0 as usize].doubters;
        doubters.entry(actor.clone()).or_default().extend(refusal);
    }

    /// Returns the actors that do not go on from an environment's newest snapshot.
    pub fn doubters(&self, env_id: EnvId) -> &Doubters {
        &self.envs[env_id.0 as usize].doubters
    }

    /// Gives up an environment's newest snapshot, and with it all others of its episode since somebody else began that: what they
    /// went on from may be what is wrong. Returns what happens, one after the other.
    pub fn recover_inherited(&mut self, env_id: EnvId) -> Vec<Recovery> {
        let mut given_up = Vec::new();
        loop {
            let is_passed_on = self.is_passed_on(env_id);
            let recovery = self.recover(env_id);
            let goes_on = is_passed_on && matches!(recovery, Recovery::Redo(_));
            given_up.push(recovery);
            if !goes_on {
                return given_up;
            }
        }
    }

    /// Gives up an environment's newest snapshot.
    pub fn recover(&mut self, env_id: EnvId) -> Recovery {
        let env = &mut self.envs[env_id.0 as usize];
        env.doubters.clear();
        // Without this rollout the one before it is the newest again, and `expected` goes back with it.
        if let Some(Waiting { author, .. }) = env.waiting.pop_back() {
            return Recovery::Redo(author);
        }
        let cursor = env.taken();
        self.broken_off.insert(env_id);
        // The iteration stays: the environment's numbering goes on, only its episode is lost. The author is taken out,
        // so that nobody is blamed twice for one snapshot.
        cursor.snapshot.clear();
        cursor.begun_by = None;
        Recovery::FreshEpisode(cursor.author.take())
    }

    /// Drops what is too stale for a learner at `version` and returns how many rollouts that was.
    pub fn drop_stale(&mut self, version: PolicyVersion) -> u64 {
        let Schedule::Async { staleness_max } = self.schedule else { return 0 };
        let mut n_dropped = 0;
        for (id, env) in (0_u32..).zip(&mut self.envs) {
            while env.waiting.front().is_some_and(|Waiting { rollout, .. }| {
                Staleness::between(version, rollout.version) > Staleness(staleness_max)
            }) {
                // A dropped rollout is finished with, like a trained one. Only between updates: `commit` would pass one
                // that is under way as done.
                env.take();
                env.commit();
                self.broken_off.insert(EnvId(id));
                self.passed_over.insert(EnvId(id));
                n_dropped += 1;
            }
        }
        n_dropped
    }

    /// Returns the environments whose next rollout of a batch does not begin where the last one ended, once each: rollouts
    /// between the two were dropped, or a fresh episode begins.
    pub fn take_broken_off(&mut self) -> BTreeSet<EnvId> {
        std::mem::take(&mut self.broken_off)
    }

    /// Returns the environments that go on after a resume behind rollouts that were dropped, of which the last update that is done
    /// knew nothing.
    pub fn passed_over(&self) -> &BTreeSet<EnvId> {
        &self.passed_over
    }

    /// Takes the rollouts of the update that turns `version` into the next one, if they are all here, sorted by
    /// environment and iteration.
    pub fn take_batch(&mut self, version: PolicyVersion) -> Option<Vec<CheckedRollout>> {
        let mut rollouts = if self.schedule.is_deterministic() {
            // Not any waiting rollout, but the one that this update is named after: arrival order must reach no result.
            let is_ready = |env: &EnvQueue| {
                env.waiting.front().is_some_and(|first| first.rollout.iteration.0 == version.0)
            };
            // All or none: a rollout that is taken no longer waits, so a batch cannot be begun with what is there.
            if !self.envs.iter().all(is_ready) {
                return None;
            }
            self.envs.iter_mut().filter_map(EnvQueue::take).collect()
        } else {
            self.take_first_arrived()?
        };
        // Sums over a batch are not associative in floating point: one order, whatever arrived first.
        rollouts.sort_by_key(|rollout| (rollout.env_id, rollout.iteration));
        Some(rollouts)
    }

    fn take_first_arrived(&mut self) -> Option<Vec<CheckedRollout>> {
        let n_wanted = self.envs.len();
        if self.len() < n_wanted {
            return None;
        }
        let earliest = |envs: &mut Vec<EnvQueue>| {
            let waiting = envs.iter_mut().filter(|env| !env.waiting.is_empty());
            waiting.min_by_key(|env| env.waiting[0].arrival).and_then(EnvQueue::take)
        };
        (0..n_wanted).map(|_| earliest(&mut self.envs)).collect()
    }

    /// Notes that the batch taken last is trained.
    pub fn commit(&mut self) {
        self.envs.iter_mut().for_each(EnvQueue::commit);
        self.passed_over.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use leadtime_proto::{ActionSpec, EnvSpec, Incarnation, Rollout};

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

    fn queue(schedule: Schedule, n_envs: usize, waiting: &[(u32, u64)]) -> RolloutQueue {
        let mut queue = RolloutQueue::new(schedule, RolloutQueue::beginning(n_envs));
        for &(env_id, iteration) in waiting {
            queue.accept(author(iteration), rollout(env_id, iteration, 0));
        }
        queue
    }

    fn author(start: u64) -> SenderKey {
        (ActorId::new("a").unwrap(), Incarnation(start))
    }

    fn ids(batch: Option<Vec<CheckedRollout>>) -> Vec<(u32, u64)> {
        let rollouts = batch.unwrap_or_default();
        rollouts.iter().map(|rollout| (rollout.env_id.0, rollout.iteration.0)).collect()
    }

    #[test]
    fn an_update_takes_its_own_iteration_of_every_environment_in_their_order() {
        let mut queue = queue(Schedule::Lag(1), 2, &[(1, 0), (1, 1)]);
        assert!(queue.take_batch(PolicyVersion(0)).is_none(), "environment 0 is missing");
        queue.accept(author(1), rollout(0, 0, 0));
        assert_eq!(ids(queue.take_batch(PolicyVersion(0))), [(0, 0), (1, 0)]);
        assert!(queue.take_batch(PolicyVersion(1)).is_none());
        assert_eq!(queue.len(), 1);
    }

    #[test]
    fn a_move_goes_on_after_the_newest_rollout_and_a_resume_after_the_consumed_one() {
        let mut queue = queue(Schedule::Lag(1), 1, &[(0, 0), (0, 1)]);
        queue.take_batch(PolicyVersion(0)).unwrap();
        assert_eq!(queue.consumed()[0].iteration, Iteration(0), "the update is not done");
        queue.commit();
        let (moved, resumed) = (queue.newest(EnvId(0)), queue.consumed().remove(0));
        assert_eq!((moved.iteration, moved.snapshot), (Iteration(2), vec![0, 1]));
        assert_eq!((resumed.iteration, resumed.snapshot), (Iteration(1), vec![0, 0]));
        assert_eq!(queue.expected(EnvId(0)), Some(Iteration(2)));
        assert_eq!(queue.expected(EnvId(1)), None);
    }

    #[test]
    fn async_takes_the_first_to_arrive_even_twice_from_one_environment() {
        let mut queue = queue(Schedule::Async { staleness_max: 1 }, 2, &[(1, 0)]);
        assert!(queue.take_batch(PolicyVersion(0)).is_none());
        queue.accept(author(1), rollout(1, 1, 0));
        queue.accept(author(1), rollout(0, 0, 0));
        assert_eq!(ids(queue.take_batch(PolicyVersion(0))), [(1, 0), (1, 1)]);
        assert_eq!(queue.len(), 1);
    }

    #[test]
    fn async_drops_what_is_too_stale_and_is_full_at_twice_an_update() {
        let mut queue = queue(Schedule::Async { staleness_max: 1 }, 1, &[(0, 0)]);
        assert_eq!(queue.room(), Some(1));
        queue.accept(author(1), rollout(0, 1, 2));
        assert_eq!(queue.room(), Some(0));
        assert_eq!(queue.drop_stale(PolicyVersion(1)), 0);
        queue.take_broken_off();
        assert_eq!(queue.drop_stale(PolicyVersion(2)), 1);
        assert!(queue.take_broken_off().iter().eq([&EnvId(0)]), "the next one is no continuation");
        assert!(queue.take_broken_off().is_empty());
        assert_eq!(queue.consumed()[0].iteration, Iteration(1));
        assert_eq!(ids(queue.take_batch(PolicyVersion(2))), [(0, 1)]);
    }

    #[test]
    fn an_episode_that_others_went_on_with_is_given_up_as_a_whole() {
        let mut queue = queue(Schedule::Lag(4), 1, &[(0, 0)]);
        let (env_id, redo) = (EnvId(0), |start| Recovery::Redo(author(start)));
        let inherited =
            |queue: &RolloutQueue| [0, 1].map(|n| queue.is_inherited(env_id, &author(n)));
        assert_eq!((inherited(&queue), queue.is_passed_on(env_id)), ([false, true], false));
        for iteration in 1..3 {
            queue.accept(author(1), rollout(0, iteration, 0));
            assert_eq!((inherited(&queue), queue.is_passed_on(env_id)), ([true, true], true));
        }
        assert_eq!(queue.begun_by(env_id), Some(&author(0)));
        assert_eq!(queue.recover_inherited(env_id), [redo(1), redo(1), redo(0)]);
        assert_eq!(inherited(&queue), [false, false], "it begins anew");
        // What is trained is not made again.
        queue.accept(author(0), rollout(0, 0, 0));
        queue.take_batch(PolicyVersion(0)).unwrap();
        queue.accept(author(1), rollout(0, 1, 0));
        let fresh = Recovery::FreshEpisode(Some(author(0)));
        assert_eq!(queue.recover_inherited(env_id), [redo(1), fresh]);
        queue.accept(author(1), rollout(0, 1, 0));
        assert_eq!((inherited(&queue), queue.is_passed_on(env_id)), ([true, false], false));
    }

    #[test]
    fn a_snapshot_given_up_drops_its_rollout_or_begins_a_fresh_episode() {
        let mut queue = queue(Schedule::Lag(2), 1, &[(0, 0), (0, 1)]);
        let [a, b] = ["a", "b"].map(|name| ActorId::new(name).unwrap());
        for (n_doubters, actor) in [(1, &a), (2, &b)] {
            queue.doubt(EnvId(0), actor, None);
            assert_eq!(queue.doubters(EnvId(0)).len(), n_doubters);
        }
        assert_eq!(queue.recover(EnvId(0)), Recovery::Redo(author(1)));
        assert_eq!(queue.newest(EnvId(0)).snapshot, [0, 0]);
        queue.doubt(EnvId(0), &a, None);
        let doubters = queue.accept(author(1), rollout(0, 1, 0));
        assert!(doubters.keys().eq([&a]), "who doubted what another actor goes on from");
        for version in 0..2 {
            queue.take_batch(PolicyVersion(version)).unwrap();
            queue.commit();
        }
        let fresh = Recovery::FreshEpisode(Some(author(1)));
        assert!(queue.take_broken_off().iter().eq([&EnvId(0)]), "the first episode");
        assert!(queue.take_broken_off().is_empty(), "what is made again is a continuation");
        assert_eq!(queue.recover(EnvId(0)), fresh);
        assert!(queue.take_broken_off().iter().eq([&EnvId(0)]));
        let mut resumed = RolloutQueue::new(Schedule::Lag(2), queue.consumed());
        assert!(resumed.take_broken_off().iter().eq([&EnvId(0)]));
        assert_eq!(queue.consumed()[0].snapshot, Vec::<u8>::new());
        assert_eq!(queue.newest(EnvId(0)).iteration, Iteration(2));
    }
}
