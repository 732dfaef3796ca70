//! Members that the run waits for: which ones are reported, which give environments back, and when they may have some again.
//!
//! Time is counted in ticks of the learner's loop, so time in which the learner itself stood still (a suspended
//! machine, a loaded one) counts against no member. Whoever is slow is slow compared with the others: with one member,
//! or with all of them late, waits are reported and nothing is taken away. Which member steps an environment changes no
//! bit of the run, so a wrong guess here costs time and nothing else.
//!
//! Restoring takes time, with environments in Python several seconds each. As long as a member has not answered the order with
//! the snapshots, it is not late, up to [`MAX_RESTORE_TICKS`], which count from one rollout that it delivers to the next: whoever answers
//! and has the same environments given again, delivers nothing and would hold up the run for ever. More environments than it ever had
//! since then bring time of their own, for they come from a member that failed while this one restored.
//!
//! # Invariants
//!
//! * Every failure of a name doubles the time until it is trusted again, up to [`MAX_BACK_OFF`]; trust comes back in
//!   steps, one environment first, and a name that has all of it back is forgotten.

use std::collections::BTreeMap;

use leadtime_proto::{ActorId, Epoch};

/// Ticks that the run waits for a member before that is reported.
const REPORT_AFTER: u32 = 6;
/// Ticks between two reports of one wait.
const REPORT_EVERY: u32 = 60;
/// Ticks that a member may be behind the others before it loses its environments.
const TAKE_AFTER: u32 = 12;
/// Ticks that a member may take to restore a snapshot.
const RESTORE_TICKS: u32 = 16;
/// Ticks that it may take at most to restore all that it is given before it delivers something, what is added meanwhile apart.
const MAX_RESTORE_TICKS: u32 = 240;
/// How many times as long as the others a member may take, where that is more.
const PATIENCE: u32 = 3;
/// What an update is assumed to take before the first one, in ticks.
const FIRST_PERIOD: u32 = 10;
/// Ticks over which a member's speed is measured at least.
const WINDOW_TICKS: u32 = 40;
/// Updates over which it is measured at least.
const WINDOW_UPDATES: u32 = 4;
/// A member is too slow if the run waits for it alone in more than three of four ticks.
const SLOW: (u32, u32) = (3, 4);
/// Ticks until a member that failed for the first time is tried again.
pub(crate) const BACK_OFF: u64 = 20;
/// The longest time until a member is tried again, in ticks.
const MAX_BACK_OFF: u64 = 1_200;
/// The most names whose failures are remembered: a stranger chooses its own names.
const MAX_NAMES: usize = 1_024;

/// What a tick finds out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Lateness {
    /// The run has been waiting for an actor for this many ticks.
    Waiting { actor: ActorId, n_ticks: u32 },
    /// An actor is far behind the others: it may have fewer environments from now on.
    Behind(ActorId),
    /// An actor may have more environments again.
    Trusted,
}

/// What a member has been waited for.
#[derive(Clone, Debug, Default)]
struct Wait {
    n_held: usize,
    /// Ticks since it last delivered something, or was given something, in which the run waited for it.
    n_waited: u32,
    /// Those of them in which another member had done its part.
    n_late: u32,
    n_late_in_window: u32,
    /// Those in which it would have been late if it had not been restoring, as long as it has environments.
    n_excused: u32,
    /// How many of those it may have beyond [`MAX_RESTORE_TICKS`]: for environments that were added to those that it had.
    n_added: u32,
    /// The most environments with which it was given snapshots in that time, or had while it still restored; 0 if it was not. What
    /// it got without snapshots is not in it: that took no time, and will if it comes back with them.
    n_most: usize,
    has_delivered: bool,
    restoring: Option<Restoring>,
}

/// An order with snapshots that is not answered yet.
#[derive(Clone, Copy, Debug)]
struct Restoring {
    epoch: Epoch,
    /// In so many ticks more its member is not late.
    ticks_left: u32,
}

impl Wait {
    /// Returns whether the member is excused for a tick because it is restoring, and uses that tick up.
    fn excuse(&mut self) -> bool {
        let Some(restoring) = &mut self.restoring else { return false };
        let is_excused = restoring.ticks_left > 0;
        restoring.ticks_left = restoring.ticks_left.saturating_sub(1);
        is_excused
    }
}

/// What a name that has failed may have.
#[derive(Clone, Debug)]
struct Probation {
    n_failures: u32,
    max_envs: usize,
    raised_at: u64,
}

/// The members' lateness, and the failures of names.
#[derive(Clone, Debug, Default)]
pub(crate) struct Stragglers {
    is_deterministic: bool,
    n_envs: usize,
    now: u64,
    waits: BTreeMap<ActorId, Wait>,
    probations: BTreeMap<ActorId, Probation>,
    /// Ticks since an update was last begun.
    since_update: u32,
    /// Those of them in which some members had done their part and others had not.
    n_stalled: u32,
    /// Ticks that the previous update took, except those that one member caused.
    period: u32,
    window_ticks: u32,
    window_updates: u32,
}

impl Stragglers {
    pub(crate) fn new(n_envs: usize, is_deterministic: bool) -> Self {
        Self { is_deterministic, n_envs, period: FIRST_PERIOD, ..Self::default() }
    }

    /// Notes how many environments each member has; those whose number changed start anew.
    pub(crate) fn assigned(&mut self, held: &BTreeMap<ActorId, usize>) {
        self.waits.retain(|actor, _| held.contains_key(actor));
        for (actor, &n_held) in held {
            let wait = self.waits.entry(actor.clone()).or_default();
            // Another number means other work, so patience begins anew.
            if wait.n_held != n_held {
                let mut fresh = Wait { n_held, restoring: wait.restoring, ..Wait::default() };
                // Not the time to restore, which it would have again for every one that it is given.
                if n_held > 0 {
                    let Wait { n_excused, n_added, n_most, .. } = *wait;
                    fresh = Wait { n_excused, n_added, n_most, ..fresh };
                }
                *wait = fresh;
            }
        }
        self.start_window();
    }

    /// Notes that a member, which has `n_held` environments now, is given snapshots that it has to restore before it answers.
    pub(crate) fn restores(
        &mut self,
        actor: &ActorId,
        epoch: Epoch,
        n_snapshots: usize,
        n_held: usize,
    ) {
        let wait = self.waits.entry(actor.clone()).or_default();
        if wait.n_most > 0 {
            let n_added = restore_ticks(n_held.saturating_sub(wait.n_most));
            wait.n_added = wait.n_added.saturating_add(n_added);
        }
        wait.n_most = wait.n_most.max(n_held);
        // What it was given before comes first.
        let before = wait.restoring.map_or(0, |restoring| restoring.ticks_left);
        let n_left = MAX_RESTORE_TICKS.saturating_add(wait.n_added).saturating_sub(wait.n_excused);
        let ticks_left = restore_ticks(n_snapshots).saturating_add(before).min(n_left);
        wait.restoring = Some(Restoring { epoch, ticks_left });
    }

    /// Notes that a member has answered an order.
    pub(crate) fn restored(&mut self, actor: &ActorId, epoch: Epoch) {
        if let Some(wait) = self.waits.get_mut(actor)
            && wait.restoring.is_some_and(|restoring| restoring.epoch <= epoch)
        {
            wait.restoring = None;
        }
    }

    /// Returns whether a member has not answered an order with snapshots yet.
    pub(crate) fn is_restoring(&self, actor: &ActorId) -> bool {
        self.waits.get(actor).is_some_and(|wait| wait.restoring.is_some())
    }

    /// Notes that a member is gone, with all that it was to do.
    pub(crate) fn left(&mut self, actor: &ActorId) {
        self.waits.remove(actor);
    }

    /// Notes that a member delivered a rollout.
    pub(crate) fn delivered(&mut self, actor: &ActorId) {
        if let Some(wait) = self.waits.get_mut(actor) {
            (wait.n_waited, wait.n_late) = (0, 0);
            (wait.n_excused, wait.n_added) = (0, 0);
            // What was on its way when it was told to restore does not end that.
            wait.n_most = if wait.restoring.is_some() { wait.n_held } else { 0 };
            wait.has_delivered = true;
        }
    }

    /// Notes that an update begins.
    pub(crate) fn updating(&mut self) {
        let n_late = self.waits.values().map(|wait| wait.n_late).max().unwrap_or(0);
        // In `async` no update waits for one member alone: the longest lateness stands in for the stall.
        let n_late = if self.is_deterministic { self.n_stalled } else { n_late };
        self.period = self.since_update.saturating_sub(n_late);
        (self.since_update, self.n_stalled) = (0, 0);
        self.window_updates += 1;
    }

    /// Notes that an actor failed: it took no orders, delivered nothing, or was wrong about a snapshot. Returns whether
    /// that is news, and not the same failure noticed a second time.
    pub(crate) fn fail(&mut self, actor: &ActorId, max_envs: usize) -> bool {
        let known = self.probations.get(actor);
        // It may have none as it is: the same failure, found in another way.
        if known.is_some_and(|known| known.max_envs == 0) {
            return false;
        }
        let n_failures = known.map_or(1, |known| known.n_failures + 1);
        let raised_at = self.now + back_off(n_failures);
        let probation = Probation { n_failures, max_envs, raised_at };
        self.probations.insert(actor.clone(), probation);
        // Strangers can come under any number of names. The one that would be trusted soonest is forgotten first.
        if self.probations.len() > MAX_NAMES
            && let Some(next) = self.probations.iter().min_by_key(|(_, known)| known.raised_at)
        {
            let name = next.0.clone();
            self.probations.remove(&name);
        }
        true
    }

    /// Returns the most environments that an actor should have while others can take them.
    pub(crate) fn max_envs(&self, actor: &ActorId) -> usize {
        self.probations.get(actor).map_or(usize::MAX, |probation| probation.max_envs)
    }

    /// Takes in which members the next update lacks rollouts of, if the learner has nothing else to do.
    pub(crate) fn tick(&mut self, lacking: &BTreeMap<ActorId, usize>) -> Vec<Lateness> {
        self.now += 1;
        self.since_update += 1;
        self.window_ticks += 1;
        let mut findings = self.waiting(lacking);
        for (actor, max_envs) in self.behind() {
            if self.fail(&actor, max_envs) {
                findings.push(Lateness::Behind(actor));
            }
        }
        if self.raise() {
            findings.push(Lateness::Trusted);
        }
        findings
    }

    fn waiting(&mut self, lacking: &BTreeMap<ActorId, usize>) -> Vec<Lateness> {
        // In `async` everyone lacks something most of the time: there, a member that delivers is in time.
        let is_done = |actor: &ActorId, wait: &Wait| {
            if self.is_deterministic { !lacking.contains_key(actor) } else { wait.has_delivered }
        };
        // Only with somebody else in time is anyone late: a slow network or machine hits all of them.
        let is_in_time =
            self.waits.iter().any(|(actor, wait)| wait.n_held > 0 && is_done(actor, wait));
        self.n_stalled += u32::from(is_in_time && !lacking.is_empty());
        let report_after = REPORT_AFTER.max(PATIENCE * self.period);
        let mut findings = Vec::new();
        for (actor, wait) in &mut self.waits {
            wait.has_delivered = false;
            if !lacking.contains_key(actor) {
                continue;
            }
            wait.n_waited += 1;
            let is_excused = is_in_time && wait.excuse();
            wait.n_excused += u32::from(is_excused);
            let is_late = u32::from(is_in_time && !is_excused);
            wait.n_late += is_late;
            wait.n_late_in_window += is_late;
            let overdue = wait.n_waited.checked_sub(report_after);
            if overdue.is_some_and(|n_ticks| n_ticks.is_multiple_of(REPORT_EVERY)) {
                let (actor, n_ticks) = (actor.clone(), wait.n_waited);
                findings.push(Lateness::Waiting { actor, n_ticks });
            }
        }
        findings
    }

    /// Lists who is far behind the others, with the number of environments that it may keep.
    fn behind(&mut self) -> Vec<(ActorId, usize)> {
        let mut behind = Vec::new();
        for (actor, wait) in &self.waits {
            // The others' pace: that of the last update, or of this one as far as the member was not what it waited
            // for.
            let waited_for = wait.n_late + wait.n_excused;
            let others = self.period.max(self.since_update.saturating_sub(waited_for));
            if wait.n_late > TAKE_AFTER.max(PATIENCE * others) {
                behind.push((actor.clone(), 0));
            }
        }
        if self.window_ticks >= WINDOW_TICKS && self.window_updates >= WINDOW_UPDATES {
            let is_slow = |wait: &Wait| wait.n_late_in_window * SLOW.1 > self.window_ticks * SLOW.0;
            let slow = self.waits.iter().filter(|(_, wait)| is_slow(wait));
            // Half, and nothing for a member with one: it is slow but alive, so less work may be all it needs.
            behind.extend(slow.map(|(actor, wait)| (actor.clone(), wait.n_held / 2)));
            self.start_window();
        }
        behind
    }

    fn start_window(&mut self) {
        (self.window_ticks, self.window_updates) = (0, 0);
        self.waits.values_mut().for_each(|wait| wait.n_late_in_window = 0);
    }

    /// Gives trust back where it is due. Returns whether anybody got some.
    fn raise(&mut self) -> bool {
        let (now, n_envs, waits) = (self.now, self.n_envs, &self.waits);
        let mut raised = false;
        self.probations.retain(|actor, probation| {
            // A member that still owes an answer would get no further order.
            let is_restoring = waits.get(actor).is_some_and(|wait| wait.restoring.is_some());
            if probation.raised_at <= now && !is_restoring {
                raised = true;
                probation.max_envs = (2 * probation.max_envs).max(1);
                probation.raised_at = now + back_off(probation.n_failures);
            }
            // With as many as there are environments there is no limit any more, and the name is forgotten.
            probation.max_envs < n_envs
        });
        raised
    }
}

/// Returns how long a member may take to restore so many snapshots, in ticks.
fn restore_ticks(n_snapshots: usize) -> u32 {
    let n_snapshots = u32::try_from(n_snapshots).unwrap_or(u32::MAX);
    n_snapshots.saturating_mul(RESTORE_TICKS).min(MAX_RESTORE_TICKS)
}

fn back_off(n_failures: u32) -> u64 {
    // The cap keeps the shift below from overflowing; `MAX_BACK_OFF` is reached long before.
    let doublings = n_failures.saturating_sub(1).min(16);
    (BACK_OFF << doublings).min(MAX_BACK_OFF)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn id(name: &str) -> ActorId {
        ActorId::new(name).unwrap()
    }

    fn counts(counts: &[(&str, usize)]) -> BTreeMap<ActorId, usize> {
        counts.iter().map(|&(name, n)| (id(name), n)).collect()
    }

    fn stragglers(held: &[(&str, usize)]) -> Stragglers {
        let mut stragglers = Stragglers::new(8, true);
        stragglers.assigned(&counts(held));
        stragglers.updating();
        stragglers
    }

    /// Ticks until somebody is behind, at most `limit`.
    fn ticks(
        stragglers: &mut Stragglers,
        limit: u32,
        mut lacking: impl FnMut(u32, &mut Stragglers) -> BTreeMap<ActorId, usize>,
    ) -> Option<(u32, ActorId)> {
        (1..=limit).find_map(|tick| {
            let lacking = lacking(tick, stragglers);
            stragglers.tick(&lacking).into_iter().find_map(|finding| match finding {
                Lateness::Behind(actor) => Some((tick, actor)),
                _ => None,
            })
        })
    }

    #[test]
    fn a_mute_member_is_reported_and_then_loses_everything() {
        let mut s = stragglers(&[("a", 4), ("mute", 4)]);
        let lacking = counts(&[("mute", 4)]);
        for _ in 1..REPORT_AFTER {
            assert_eq!(s.tick(&lacking), []);
        }
        let report = Lateness::Waiting { actor: id("mute"), n_ticks: REPORT_AFTER };
        assert_eq!(s.tick(&lacking), [report]);
        let found = ticks(&mut s, 100, |_, _| lacking.clone());
        assert_eq!(found, Some((TAKE_AFTER + 1 - REPORT_AFTER, id("mute"))));
        assert_eq!((s.max_envs(&id("mute")), s.max_envs(&id("a"))), (0, usize::MAX));
    }

    #[test]
    fn a_member_that_restores_is_late_only_after_the_time_that_its_snapshots_may_take() {
        let lacking = counts(&[("slow", 4)]);
        let restoring = |n_snapshots| {
            let mut s = stragglers(&[("a", 4), ("slow", 4)]);
            s.restores(&id("slow"), Epoch(3), n_snapshots, n_snapshots);
            s
        };
        for (n_snapshots, n_ticks) in [(4, 4 * RESTORE_TICKS), (4_000, MAX_RESTORE_TICKS)] {
            let found = ticks(&mut restoring(n_snapshots), 1_000, |_, _| lacking.clone());
            assert_eq!(found, Some((n_ticks + TAKE_AFTER + 1, id("slow"))));
        }
        // What it is given meanwhile adds to that.
        let mut s = restoring(4);
        s.restores(&id("slow"), Epoch(4), 1, 5);
        let found = ticks(&mut s, 1_000, |_, _| lacking.clone());
        assert_eq!(found, Some((5 * RESTORE_TICKS + TAKE_AFTER + 1, id("slow"))));
        // Once it has answered, it is compared with the others again.
        let mut s = restoring(4);
        let found = ticks(&mut s, 1_000, |tick, s| {
            if tick == 20 {
                s.restored(&id("slow"), Epoch(2));
                assert!(s.is_restoring(&id("slow")), "an earlier order");
                s.restored(&id("slow"), Epoch(3));
            }
            lacking.clone()
        });
        assert_eq!(found, Some((19 + TAKE_AFTER + 1, id("slow"))));
        // And who does not answer gets nothing more.
        let mut s = restoring(1);
        assert!(ticks(&mut s, 1_000, |_, _| lacking.clone()).is_some());
        s.assigned(&counts(&[("a", 8), ("slow", 0)]));
        assert!((0..1_000).all(|_| s.tick(&BTreeMap::new()).is_empty()));
        s.restored(&id("slow"), Epoch(3));
        assert_eq!(s.tick(&BTreeMap::new()), [Lateness::Trusted]);
    }

    #[test]
    fn a_member_that_answers_and_delivers_nothing_has_its_time_to_restore_once() {
        let lacking = counts(&[("slow", 4)]);
        let most = MAX_RESTORE_TICKS + TAKE_AFTER + 1;
        let again = |s: &mut Stragglers, epoch: u32, n_held: usize| {
            s.restored(&id("slow"), Epoch(u64::from(epoch)));
            s.restores(&id("slow"), Epoch(u64::from(epoch) + 1), 20, n_held);
        };
        let mut s = stragglers(&[("a", 4), ("slow", 4)]);
        again(&mut s, 0, 4);
        let found = ticks(&mut s, 1_000, |tick, s| {
            if tick.is_multiple_of(200) {
                again(s, tick, 4);
            }
            lacking.clone()
        });
        assert_eq!(found, Some((most, id("slow"))));
        // One that is added brings its own, and none if it is taken away and comes back, until something is delivered.
        let mut s = stragglers(&[("a", 4), ("slow", 4)]);
        again(&mut s, 0, 4);
        let found = ticks(&mut s, 1_000, |tick, s| {
            let n_held = match tick {
                200 | 220 => 5,
                210 => 4,
                _ => return lacking.clone(),
            };
            s.assigned(&counts(&[("a", 8 - n_held), ("slow", n_held)]));
            again(s, tick, n_held);
            lacking.clone()
        });
        assert_eq!(found, Some((most + RESTORE_TICKS, id("slow"))));
        s.assigned(&counts(&[("a", 8), ("slow", 0)]));
        s.assigned(&counts(&[("a", 4), ("slow", 4)]));
        let mut delivered = stragglers(&[("a", 4), ("slow", 4)]);
        again(&mut delivered, 0, 4);
        assert_eq!(ticks(&mut delivered, 200, |_, _| lacking.clone()), None);
        delivered.delivered(&id("slow"));
        for mut s in [s, delivered] {
            again(&mut s, 200, 4);
            assert_eq!(ticks(&mut s, MAX_RESTORE_TICKS, |_, _| lacking.clone()), None);
        }
    }

    #[test]
    fn what_another_ones_failure_adds_to_a_member_that_restored_all_its_time_brings_time() {
        let lacking = counts(&[("slow", 15)]);
        for has_one_on_its_way in [false, true] {
            let mut s = stragglers(&[("a", 10), ("b", 5), ("slow", 15)]);
            s.restores(&id("slow"), Epoch(1), 15, 15);
            if has_one_on_its_way {
                s.delivered(&id("slow"));
            }
            assert_eq!(ticks(&mut s, MAX_RESTORE_TICKS, |_, _| lacking.clone()), None);
            s.restored(&id("slow"), Epoch(1));
            s.restores(&id("slow"), Epoch(2), 5, 20);
            s.assigned(&counts(&[("a", 10), ("slow", 20)]));
            let found = ticks(&mut s, 1_000, |_, _| lacking.clone());
            assert_eq!(found, Some((5 * RESTORE_TICKS + TAKE_AFTER + 1, id("slow"))));
        }
    }

    #[test]
    fn what_came_without_a_snapshot_brings_time_when_it_comes_back_with_one() {
        let lacking = counts(&[("slow", 15)]);
        let mut s = stragglers(&[("a", 15), ("slow", 15)]);
        s.restores(&id("slow"), Epoch(1), 15, 15);
        assert_eq!(ticks(&mut s, MAX_RESTORE_TICKS, |_, _| lacking.clone()), None);
        s.restored(&id("slow"), Epoch(1));
        // Five that have just begun come, another one steps them for a while, and they come back.
        for n_held in [20, 15] {
            s.assigned(&counts(&[("a", 30 - n_held), ("slow", n_held)]));
        }
        s.restores(&id("slow"), Epoch(4), 5, 20);
        s.assigned(&counts(&[("a", 10), ("slow", 20)]));
        let found = ticks(&mut s, 1_000, |_, _| lacking.clone());
        assert_eq!(found, Some((5 * RESTORE_TICKS + TAKE_AFTER + 1, id("slow"))));
    }

    #[test]
    fn an_actor_alone_or_late_with_all_others_or_in_turns_keeps_its_environments() {
        for held in [&[("a", 8)][..], &[("a", 4), ("b", 4)]] {
            let mut s = stragglers(held);
            assert_eq!(ticks(&mut s, 1_000, |_, _| counts(held)), None);
        }
        let mut s = stragglers(&[("a", 4), ("b", 4)]);
        let found = ticks(&mut s, 1_000, |tick, s| {
            s.updating();
            s.delivered(&id("a"));
            s.delivered(&id("b"));
            counts(&[(if tick % 2 == 0 { "a" } else { "b" }, 4)])
        });
        assert_eq!(found, None);
    }

    #[test]
    fn where_updates_take_long_a_member_may_be_late_by_as_much() {
        let mut s = stragglers(&[("a", 4), ("b", 4)]);
        let found = ticks(&mut s, 1_000, |tick, _| match tick {
            0..100 => counts(&[("a", 4), ("b", 4)]),
            _ => counts(&[("b", 4)]),
        });
        assert_eq!(found, Some((397, id("b"))), "a needed 99 ticks, b has not come after 4 * 99");
    }

    #[test]
    fn a_slow_member_keeps_half_and_then_nothing_and_is_trusted_again_step_by_step() {
        let mut s = stragglers(&[("a", 6), ("slow", 2)]);
        // It needs four ticks where the others need none: never mute, always waited for.
        let pace = |tick: u32, s: &mut Stragglers| {
            if tick.is_multiple_of(5) {
                s.delivered(&id("slow"));
                s.updating();
                return BTreeMap::new();
            }
            counts(&[("slow", 1)])
        };
        assert_eq!(ticks(&mut s, 100, pace), Some((WINDOW_TICKS, id("slow"))));
        assert_eq!(s.max_envs(&id("slow")), 1);
        s.assigned(&counts(&[("a", 7), ("slow", 1)]));
        let found = ticks(&mut s, 100, pace);
        assert_eq!((found.unwrap().1, s.max_envs(&id("slow"))), (id("slow"), 0));
        s.assigned(&counts(&[("a", 8), ("slow", 0)]));
        let mut trusted = Vec::new();
        for tick in 0..1_000_u32 {
            if s.tick(&BTreeMap::new()) == [Lateness::Trusted] {
                trusted.push((tick, s.max_envs(&id("slow"))));
            }
        }
        assert_eq!(trusted.iter().map(|(_, n)| *n).collect::<Vec<_>>(), [1, 2, 4, usize::MAX]);
        assert!(trusted.windows(2).all(|two| two[1].0 - two[0].0 == 2 * BACK_OFF as u32));
    }

    #[test]
    fn only_an_actor_that_delivers_nothing_is_behind_in_async() {
        let mut s = Stragglers::new(8, false);
        s.assigned(&counts(&[("a", 4), ("mute", 4)]));
        s.updating();
        let found = ticks(&mut s, 100, |_, s| {
            s.delivered(&id("a"));
            counts(&[("a", 2), ("mute", 4)])
        });
        assert_eq!(found, Some((TAKE_AFTER + 1, id("mute"))));
    }

    #[test]
    fn a_name_that_fails_again_and_again_waits_longer_and_longer() {
        let mut s = stragglers(&[("a", 8)]);
        let mut waited = Vec::new();
        for _ in 0..10 {
            s.fail(&id("ghost"), 0);
            s.fail(&id("ghost"), 0);
            let until =
                (1..=2 * MAX_BACK_OFF).find(|_| s.tick(&BTreeMap::new()) == [Lateness::Trusted]);
            waited.push(until.unwrap());
        }
        assert_eq!(waited[..3], [BACK_OFF, 2 * BACK_OFF, 4 * BACK_OFF]);
        assert_eq!(waited.last(), Some(&MAX_BACK_OFF));
        for i in 0..2 * MAX_NAMES {
            s.fail(&id(&format!("g{i}")), 0);
        }
        assert_eq!(s.probations.len(), MAX_NAMES);
    }
}
