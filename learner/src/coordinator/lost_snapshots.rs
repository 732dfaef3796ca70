//! What becomes of a snapshot that its environment's new actor cannot restore: others try, and then it is given up.

use std::collections::{BTreeMap, BTreeSet};

use leadtime_proto::{ActorId, EnvId, Epoch, RefusalCause};

use super::{Coordinator, RunStage};
use crate::books::SenderKey;
use crate::report::RunEvent;
use crate::rollout_queue::Recovery;
use crate::roster::Roster;
use crate::stragglers::Stragglers;

const DOUBTED: &str =
    "an actor cannot restore the state that it sent, and no other one was there to try";

impl Coordinator {
    /// Notes that an actor cannot restore the snapshots of some environments.
    ///
    /// The fault may be its own (another build, say), so an environment goes to one actor after the other. If none can
    /// restore it the snapshot is given up. Its sender is cut off if two actors say so, and trusted less on the word of one.
    pub fn cannot_restore(&mut self, key: &SenderKey, epoch: Epoch, envs: &[EnvId]) {
        if self.roster.is_member(key) {
            self.stragglers.restored(&key.0, epoch);
        }
        // Each once, and none of an assignment that is over: the answer is anybody's.
        let envs = envs.iter().copied();
        let envs: BTreeSet<EnvId> =
            envs.filter(|&env_id| self.assigner.owns(key, epoch, env_id)).collect();
        if self.stage == RunStage::Closing || envs.is_empty() {
            return;
        }
        let mut counts = self.assigner.counts(self.roster.members());
        let (mut moves, mut authors) = (Vec::new(), BTreeMap::new());
        for env_id in envs {
            let actor = key.0.clone();
            self.tell(RunEvent::SnapshotRefused { actor, env_id });
            // A member that may have no environments at present is not asked: its failure would prove nothing.
            let doubters = self.queue.doubt(env_id, &key.0);
            let n_doubters = doubters.len();
            let (roster, stragglers) = (&self.roster, &self.stragglers);
            let may_try = |other: &ActorId| {
                !doubters.contains(other) && max_envs(roster, stragglers, other) > 0
            };
            let others = counts.iter_mut().filter(|(other, _)| may_try(other));
            if let Some((other, n_held)) = others.min_by_key(|(_, n_held)| **n_held) {
                *n_held += 1;
                moves.push((env_id, (other.clone(), self.roster.members()[other])));
                continue;
            }
            moves.push((env_id, key.clone()));
            // Who reports its own snapshot has a fault, but no bad intentions, and may be the only actor.
            if let Some(author) = self.give_up_snapshot(env_id).filter(|author| author != key) {
                let most = authors.entry(author).or_insert((n_doubters, env_id));
                *most = (*most).max((n_doubters, env_id));
            }
        }
        let changes = self.assigner.hand_over(moves);
        self.assign_all(changes);
        for (author, (n_doubters, env_id)) in authors {
            self.blame(&author, n_doubters, env_id);
        }
    }

    /// Holds a snapshot that was given up against its sender.
    fn blame(&mut self, author: &SenderKey, n_doubters: usize, env_id: EnvId) {
        if n_doubters > 1 {
            let reason = format!(
                "nobody can restore the state that it sent of environment {env_id}: run the learner's build"
            );
            self.cut_off(author, reason);
        } else if self.stragglers.fail(&author.0, 0) {
            // The one who says so may be a stranger, or run another build.
            self.rebalance_due = true;
            self.tell(RunEvent::Distrusted { actor: author.0.clone(), reason: DOUBTED });
        }
    }

    /// Goes back to the previous snapshot, or to a fresh episode, and returns the sender of the snapshot that is given up.
    fn give_up_snapshot(&mut self, env_id: EnvId) -> Option<SenderKey> {
        self.tell(RunEvent::SnapshotLost { env_id });
        match self.queue.recover(env_id) {
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
        }
    }
}

/// Returns how many environments a member may have.
fn max_envs(roster: &Roster, stragglers: &Stragglers, actor: &ActorId) -> usize {
    if roster.has_answered(actor) { stragglers.max_envs(actor) } else { 0 }
}
