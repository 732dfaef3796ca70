//! What becomes of a snapshot from which its environment's new actor does not go on: others try, and then it is given up.
//!
//! ```text
//! an actor cannot restore it ──┬──▶ others try, one after the other ──┬──▶ one goes on: the fault was the first one's
//! what it makes is refused ────┘                                      └──▶ none does: the snapshot is given up
//! ```
//!
//! A state can be within all bounds and still lead to numbers that no rollout may hold, some steps later. An honest actor that is given
//! such a state makes what is refused, and cannot know. So a refusal that can follow from a state is not charged to an actor at once if
//! others had the episode before it. Nobody has to claim that: the learner gave the snapshot, and knows who sent it.
//!
//! # Invariants
//!
//! * On the word of one actor no other one is cut off: neither who sent a snapshot, nor who was refused for what it made from one.
//! * Every doubt moves an environment to an actor that has not doubted its snapshot, or gives the snapshot up; where all bits are to be
//!   the same, an accident of the last one is forgiven once. So it ends, at the latest in a fresh episode, and that is its actor's own.

use std::collections::{BTreeMap, BTreeSet};

use leadtime_proto::{
    ActorId, CheckedRollout, EnvId, Epoch, Header, Iteration, Refusal, RefusalCause,
};

use super::{Coordinator, RunStage};
use crate::books::SenderKey;
use crate::report::RunEvent;
use crate::rollout_queue::Recovery;
use crate::roster::Roster;
use crate::stragglers::Stragglers;

const WRONG_DOUBT: &str = "another actor went on from a state from which it could not";

/// Why an actor does not go on from a snapshot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SnapshotFault {
    /// It cannot restore it.
    Unreadable,
    /// What it made from it was refused.
    Misleading,
}

impl SnapshotFault {
    /// Says what is wrong with what somebody sent, as far as one actor knows.
    fn on_one_word(self) -> &'static str {
        match self {
            Self::Unreadable => {
                "an actor cannot restore the state that it sent, and no other one was there to try"
            }
            Self::Misleading => {
                "an actor was refused for what it made from the state that it sent, and no other one was there to try"
            }
        }
    }

    /// Says what is wrong with what somebody sent.
    fn told(self, env_id: EnvId) -> String {
        let state = format!("the state that it sent of environment {env_id}");
        match self {
            Self::Unreadable => format!("nobody can restore {state}: run the learner's build"),
            Self::Misleading => format!("others were refused for what they made from {state}"),
        }
    }
}

impl Coordinator {
    /// Notes that an actor cannot restore the snapshots of some environments.
    ///
    /// The fault may be its own (another build, say), so an environment goes to one actor after the other. If none can
    /// restore it the snapshot is given up. Its sender is cut off if two actors say so, and trusted less on the word of one.
    pub fn cannot_restore(&mut self, key: &SenderKey, epoch: Epoch, envs: &[EnvId]) {
        if self.roster.is_member(key) {
            self.note_followed(key, epoch);
        }
        // Each once, and none of an assignment that is over: the answer is anybody's.
        let envs = envs.iter().copied();
        let envs: BTreeSet<EnvId> =
            envs.filter(|&env_id| self.assigner.owns(key, epoch, env_id)).collect();
        if self.stage == RunStage::Closing {
            return;
        }
        for &env_id in &envs {
            self.tell(RunEvent::SnapshotRefused { actor: key.0.clone(), env_id });
            self.queue.doubt(env_id, &key.0, None);
        }
        self.pass_on(key, envs, SnapshotFault::Unreadable);
    }

    /// Refuses a rollout that could be decoded.
    pub(super) fn refuse_read(
        &mut self,
        key: &SenderKey,
        header: &Header,
        env_id: EnvId,
        iteration: Iteration,
        refusal: Refusal,
    ) {
        let is_owned = self.assigner.owns(key, header.epoch, env_id);
        let is_due = self.doubts_due.get(key).is_some_and(|envs| envs.contains(&env_id))
            && self.queue.doubters(env_id).contains_key(&key.0);
        let is_next = is_owned && !is_due && self.queue.expected(env_id) == Some(iteration);
        let sender = self.roster.sender(key);
        let is_behind = sender.is_some_and(|it| it.is_behind(header.epoch, header.sequence));
        // Its sender went on with what had been taken from it before it could know that.
        let is_void = if is_owned { is_due } else { is_behind };
        let may_be_inherited = refusal.cause.may_be_inherited();
        if may_be_inherited && is_next && self.queue.is_inherited(env_id, key) {
            self.doubt(key, env_id, refusal);
        } else if may_be_inherited && is_void {
            self.supersede();
        } else {
            self.refuse(key, refusal, true);
        }
    }

    /// Counts a refused rollout that is not charged to its sender, as long as it is not known whose fault it is.
    fn doubt(&mut self, key: &SenderKey, env_id: EnvId, refusal: Refusal) {
        self.books.refuse(refusal.cause, true);
        let begun_by = self.queue.begun_by(env_id).map(|(actor, _)| actor.clone());
        let (actor, reason) = (key.0.clone(), refusal.text.to_string());
        self.tell(RunEvent::InheritedRefused { actor, env_id, begun_by, reason });
        self.queue.doubt(env_id, &key.0, Some(refusal.of(key.1)));
        self.doubts_due.entry(key.clone()).or_default().insert(env_id);
    }

    /// Gives away the environments whose owners were refused for what they made from others' snapshots: all at once, because every
    /// order has to be answered.
    pub(super) fn settle_doubts(&mut self) {
        if self.stage == RunStage::Closing {
            return;
        }
        for (key, mut envs) in std::mem::take(&mut self.doubts_due) {
            // It may have lost one meanwhile, or gone on with it after all.
            envs.retain(|&env_id| {
                let owner = self.assigner.owner(env_id);
                owner.is_some_and(|owner| owner.key == key)
                    && self.queue.doubters(env_id).contains_key(&key.0)
            });
            self.pass_on(&key, envs, SnapshotFault::Misleading);
        }
    }

    /// Gives environments of which an actor doubts the snapshots to others, or gives the snapshots up.
    fn pass_on(&mut self, key: &SenderKey, envs: BTreeSet<EnvId>, fault: SnapshotFault) {
        if envs.is_empty() {
            return;
        }
        let mut counts = self.assigner.counts(self.roster.members());
        let (mut moves, mut authors) = (Vec::new(), BTreeMap::new());
        for env_id in envs {
            // A member that may have no environments at present is not asked: its failure would prove nothing.
            let doubters = self.queue.doubters(env_id);
            let n_doubters = doubters.len();
            let is_first = doubters.get(&key.0).is_some_and(|refusals| refusals.len() == 1);
            let (roster, stragglers) = (&self.roster, &self.stragglers);
            let may_try = |other: &ActorId| {
                !doubters.contains_key(other) && max_envs(roster, stragglers, other) > 0
            };
            let others = counts.iter_mut().filter(|(other, _)| may_try(other));
            // Rather one that has nothing to do with what is wrong there.
            let best =
                others.min_by_key(|(other, n_held)| (self.queue.had(env_id, other), **n_held));
            if let Some((other, n_held)) = best {
                *n_held += 1;
                moves.push((env_id, (other.clone(), self.roster.members()[other])));
                continue;
            }
            moves.push((env_id, key.clone()));
            // What it made may have been an accident: where all bits are to be the same, the last one tries twice.
            let is_repeatable = self.settings.spec.schedule.is_deterministic();
            if fault == SnapshotFault::Misleading && is_first && is_repeatable {
                continue;
            }
            // An actor that reports its own snapshot has a fault, but no bad intentions, and may be the only actor.
            let author = self.give_up_snapshot(env_id, fault);
            if let Some(author) = author.filter(|author| author != key) {
                let most = authors.entry(author).or_insert((n_doubters, env_id));
                *most = (*most).max((n_doubters, env_id));
            }
        }
        let changes = self.assigner.hand_over(moves);
        self.assign_all(changes);
        for (author, (n_doubters, env_id)) in authors {
            self.blame(&author, fault, n_doubters, env_id);
        }
    }

    /// Holds a snapshot that was given up against its sender.
    fn blame(
        &mut self,
        author: &SenderKey,
        fault: SnapshotFault,
        n_doubters: usize,
        env_id: EnvId,
    ) {
        if n_doubters > 1 {
            self.cut_off(author, fault.told(env_id));
        } else if self.stragglers.fail(&author.0, 0) {
            // The one who says so may be a stranger, or run another build.
            self.rebalance_due = true;
            let (actor, reason) = (author.0.clone(), fault.on_one_word());
            self.tell(RunEvent::Distrusted { actor, reason });
        }
    }

    /// Goes back to an earlier snapshot, or to a fresh episode, and returns the sender of the snapshot that is given up, if it is known
    /// to be at fault.
    fn give_up_snapshot(&mut self, env_id: EnvId, fault: SnapshotFault) -> Option<SenderKey> {
        self.tell(RunEvent::SnapshotLost { env_id });
        let (is_known, recoveries) = match fault {
            SnapshotFault::Unreadable => (true, vec![self.queue.recover(env_id)]),
            // It cannot be told whose state misleads where somebody else went on with the episode.
            SnapshotFault::Misleading => {
                (!self.queue.is_passed_on(env_id), self.queue.recover_inherited(env_id))
            }
        };
        let mut author = None;
        for recovery in recoveries {
            author = match recovery {
                Recovery::Redo(author) => {
                    // The rollout had been accepted. Counting it as refused is what keeps the books balanced.
                    self.books.refuse(RefusalCause::Snapshot, true);
                    self.books.steps_redone += u64::from(self.settings.spec.n_steps);
                    Some(author)
                }
                Recovery::FreshEpisode(author) => {
                    self.books.refuse(RefusalCause::FreshEpisode, false);
                    author
                }
            };
        }
        author.filter(|_| is_known)
    }

    /// Takes in a rollout that counts: that others did not go on from the snapshot that it began with was a fault of their own.
    pub(super) fn accept(&mut self, key: &SenderKey, rollout: CheckedRollout) {
        // In `async` another policy acts, so the same state may show what is wrong with it later, at the end of its episode at the latest.
        let is_repeatable = self.settings.spec.schedule.is_deterministic();
        let shows_all = is_repeatable || !rollout.ends.is_empty();
        // An actor that has made up a state could wait until somebody is refused for it, and send what looks sound.
        let is_impartial = self.queue.is_impartial(rollout.env_id, &key.0);
        for (actor, refusals) in self.queue.accept(key.clone(), rollout) {
            let is_own = actor == key.0;
            if !is_own && (shows_all || refusals.is_empty()) {
                self.stragglers.fail(&actor, 0);
                self.rebalance_due = true;
                let (actor, reason) = (actor.clone(), WRONG_DOUBT);
                self.tell(RunEvent::Distrusted { actor, reason });
            }
            let is_proof = is_own || (shows_all && is_impartial);
            for refusal in refusals.into_iter().filter(|_| is_proof) {
                if let Some(start) = refusal.sender {
                    self.charge(&(actor.clone(), start), refusal);
                }
            }
        }
    }
}

/// Returns how many environments a member may have.
fn max_envs(roster: &Roster, stragglers: &Stragglers, actor: &ActorId) -> usize {
    if roster.has_answered(actor) { stragglers.max_envs(actor) } else { 0 }
}
