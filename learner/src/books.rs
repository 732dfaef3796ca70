//! The books of a run: where every published rollout went.
//!
//! ```text
//! published - rolled_back = trained + dropped_stale + refused + superseded + unused_at_end
//! ```
//!
//! `published` is the sum, over every start of every actor, of the highest sequence that arrived in order; the
//! right-hand side is counted one rollout at a time where its fate is decided. The two sides share no counter,
//! so the identity can fail, and an [`Imbalance`] means that a rollout was lost or counted twice.
//!
//! What a killed learner had accepted after its last checkpoint is `rolled_back`: those rollouts are made and
//! counted again. What lies beyond a gap in an actor's sequences was not delivered; it is sent again.
//!
//! Books are part of every checkpoint, and anybody can be a member for a moment and send a rollout. So the sequences of a limited
//! number of starts are kept one by one; of those beyond that are gone, [`Books::fold`] keeps the sum.

use std::collections::BTreeMap;

use leadtime_proto::{ActorId, Incarnation, RefusalCause, Sequence};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// One start of one actor: sequences are counted per start.
pub type SenderKey = (ActorId, Incarnation);

/// The most starts of actors whose sequences are kept one by one, apart from those that may still send.
const MAX_STARTS: usize = 2_048;

/// The counters of a run, kept in its checkpoints.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Books {
    /// Rollouts that arrived in order, over all actors and their starts.
    pub published: u64,
    /// Rollouts that an update trained on.
    pub trained: u64,
    /// Rollouts that were too stale when their turn came (`async` only).
    pub dropped_stale: u64,
    /// Rollouts that broke a rule of the wire or of the run.
    pub refused: u64,
    /// Rollouts of an environment that had moved on, or to another actor.
    pub superseded: u64,
    /// Rollouts that were waiting when the run ended.
    pub unused_at_end: u64,
    /// Rollouts accepted after the checkpoint that a run was resumed from.
    pub rolled_back: u64,
    /// Copies of rollouts that had arrived before; not part of `published`.
    pub duplicates: u64,
    /// Steps that were simulated again: rolled back, superseded, or (at most) under way in an actor that left.
    pub steps_redone: u64,
    /// Refused messages by cause, those without a sequence included.
    pub refusals: BTreeMap<RefusalCause, u64>,
    sequences: BTreeMap<SenderKey, Sequence>,
}

/// The books do not balance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error(
    "the books do not balance: {published} rollouts published - {rolled_back} rolled back, but {accounted} \
     accounted for; please report this"
)]
pub struct Imbalance {
    /// Rollouts published, as the sum over the highest sequences in order.
    pub published: u64,
    /// Rollouts rolled back, because a killed learner lost them.
    pub rolled_back: u64,
    /// Rollouts whose fate is known.
    pub accounted: u64,
}

impl Books {
    /// Returns the highest sequence that one start of an actor delivered in order.
    pub fn sequence(&self, sender: &SenderKey) -> Sequence {
        self.sequences.get(sender).copied().unwrap_or_default()
    }

    /// Enters the next rollout of a sender.
    ///
    /// # Panics
    ///
    /// If the sequence is not the sender's next one: the caller checks the order.
    pub fn enter(&mut self, sender: &SenderKey, sequence: Sequence) {
        assert_eq!(sequence, self.sequence(sender).next(), "sequences are entered in order");
        self.sequences.insert(sender.clone(), sequence);
        self.published += 1;
    }

    /// Adds up the sequences of starts that are gone, if there are too many, those with the fewest rollouts first. `is_known` says
    /// which ones may still send; one that comes back all the same is a start that nobody has heard of.
    pub fn fold(&mut self, is_known: impl Fn(&SenderKey) -> bool) {
        if self.sequences.len() <= MAX_STARTS {
            return;
        }
        let departed = departed();
        let is_gone = |key: &SenderKey| *key != departed && !is_known(key);
        let gone = self.sequences.iter().filter(|(key, _)| is_gone(key));
        let mut gone: Vec<(Sequence, SenderKey)> =
            gone.map(|(key, &sequence)| (sequence, key.clone())).collect();
        gone.sort_unstable();
        // Half of them at once, so that this is seldom done.
        gone.truncate(self.sequences.len() - MAX_STARTS / 2);
        let mut n_rollouts = self.sequence(&departed).0;
        for (sequence, key) in gone {
            self.sequences.remove(&key);
            n_rollouts = n_rollouts.saturating_add(sequence.0);
        }
        if n_rollouts > 0 {
            self.sequences.insert(departed, Sequence(n_rollouts));
        }
    }

    /// Enters a gap: rollouts of T steps, up to `through`, that a learner before this one accepted and lost.
    pub fn roll_back_through(&mut self, sender: &SenderKey, through: Sequence, n_steps: u64) {
        let lost = through.0.saturating_sub(self.sequence(sender).0);
        if lost > 0 {
            self.sequences.insert(sender.clone(), through);
            self.published = self.published.saturating_add(lost);
            self.roll_back(lost, n_steps);
        }
    }

    fn roll_back(&mut self, n_rollouts: u64, n_steps: u64) {
        self.rolled_back = self.rolled_back.saturating_add(n_rollouts);
        let redone = n_rollouts.saturating_mul(n_steps);
        self.steps_redone = self.steps_redone.saturating_add(redone);
    }

    /// Starts again from a checkpoint: what was waiting or in training then will be made again.
    pub fn resume(&mut self, waiting: u64, n_steps: u64) {
        self.roll_back(waiting, n_steps);
        self.unused_at_end = 0;
    }

    /// Counts a refused message; one with a sequence is also part of the identity.
    pub fn refuse(&mut self, cause: RefusalCause, sequenced: bool) {
        *self.refusals.entry(cause).or_default() += 1;
        self.refused += u64::from(sequenced);
    }

    /// Counts refused messages that were reported as a number.
    pub fn refuse_without_event(&mut self, cause: RefusalCause, n: u64) {
        *self.refusals.entry(cause).or_default() += n;
    }

    /// Returns whether a fresh episode took the place of one that nobody could restore: without it other numbers would have been trained on.
    pub fn has_fresh_episodes(&self) -> bool {
        self.refusals.contains_key(&RefusalCause::FreshEpisode)
    }

    /// Returns the counts by name, under which records, journals and pages have them. Of `refusals` see there.
    pub fn entries(&self) -> [(&'static str, u64); 9] {
        [
            ("published", self.published),
            ("trained", self.trained),
            ("dropped_stale", self.dropped_stale),
            ("refused", self.refused),
            ("superseded", self.superseded),
            ("unused_at_end", self.unused_at_end),
            ("rolled_back", self.rolled_back),
            ("duplicates", self.duplicates),
            ("steps_redone", self.steps_redone),
        ]
    }

    /// Returns how many rollouts have met their fate, those rolled back left out.
    pub fn accounted(&self) -> u64 {
        self.trained + self.dropped_stale + self.refused + self.superseded + self.unused_at_end
    }

    /// Checks the identity.
    ///
    /// # Errors
    ///
    /// [`Imbalance`] if the two sides of the identity differ, or `published` is not the sum over the senders'
    /// sequences.
    pub fn check(&self) -> Result<(), Imbalance> {
        let sent = self.sequences.values().fold(0, |n: u64, sequence| n.saturating_add(sequence.0));
        let accounted = self.accounted();
        let balanced = sent == self.published && sent == accounted.saturating_add(self.rolled_back);
        let error = Imbalance { published: sent, rolled_back: self.rolled_back, accounted };
        if balanced { Ok(()) } else { Err(error) }
    }
}

/// Returns the entry under which the rollouts of all folded starts are counted. Checkpoints know senders only, and no start has this
/// number, which would have to be the digest of its key.
fn departed() -> SenderKey {
    (ActorId::new("departed").expect("a short word"), Incarnation(0))
}

#[cfg(test)]
mod tests {
    use leadtime_ppo::checkpoints::RECORDS_BYTES;
    use leadtime_proto::codec;

    use super::*;

    fn sender(start: u64) -> SenderKey {
        (ActorId::new("a").unwrap(), Incarnation(start))
    }

    fn entered(n: u64) -> Books {
        let mut books = Books::default();
        (1..=n).for_each(|sequence| books.enter(&sender(1), Sequence(sequence)));
        books
    }

    #[test]
    fn every_fate_balances_and_each_missing_one_does_not() {
        let mut books = entered(5);
        (books.trained, books.dropped_stale, books.superseded, books.unused_at_end) = (1, 1, 1, 1);
        books.refuse(RefusalCause::Checksum, true);
        books.refuse(RefusalCause::Oversize, false);
        assert_eq!(books.refusals[&RefusalCause::Oversize], 1, "without a sequence, so no fate");
        assert_eq!(books.check(), Ok(()));
        for forget in [
            |b: &mut Books| b.trained = 0,
            |b: &mut Books| b.dropped_stale = 0,
            |b: &mut Books| b.superseded = 0,
            |b: &mut Books| b.unused_at_end = 0,
            |b: &mut Books| b.refused = 0,
            |b: &mut Books| b.rolled_back = 1,
            |b: &mut Books| b.published = 4,
        ] {
            let mut broken = books.clone();
            forget(&mut broken);
            assert!(broken.check().is_err());
        }
    }

    #[test]
    fn a_gap_after_a_resume_is_rolled_back_once_and_two_starts_of_one_actor_count_apart() {
        let mut books = entered(3);
        books.trained = 3;
        books.roll_back_through(&sender(1), Sequence(10), 4);
        books.roll_back_through(&sender(1), Sequence(10), 4);
        assert_eq!((books.published, books.rolled_back, books.steps_redone), (10, 7, 28));
        assert_eq!(books.check(), Ok(()));
        for (start, sequence) in [(1, 11), (2, 1)] {
            books.enter(&sender(start), Sequence(sequence));
            assert!(books.check().is_err(), "its fate is not known yet");
            books.trained += 1;
            assert_eq!(books.check(), Ok(()));
        }
    }

    #[test]
    fn starts_that_are_gone_take_no_room_and_stay_in_the_sum() {
        let mut books = entered(3);
        books.superseded = 3;
        // Names as long as they may be.
        let name = ActorId::new("x".repeat(48)).unwrap();
        for start in 2..100_000 {
            let sender = (name.clone(), Incarnation(u64::MAX - start));
            books.enter(&sender, Sequence(1));
            books.superseded += 1;
            books.fold(|known| *known == sender);
            assert_eq!(books.sequence(&sender), Sequence(1));
        }
        assert_eq!((books.published, books.check()), (100_001, Ok(())));
        assert_eq!(books.sequence(&self::sender(1)), Sequence(3), "who sent most goes last");
        assert!(books.sequences.len() <= MAX_STARTS);
        assert!(codec::encode(&books).unwrap().len() < RECORDS_BYTES);
        // One that is known stays, whatever it sent.
        books.fold(|_| true);
        let n_known = books.sequences.len();
        (0..MAX_STARTS as u64).for_each(|start| books.enter(&sender(start + 9), Sequence(1)));
        books.fold(|_| true);
        assert_eq!(books.sequences.len(), n_known + MAX_STARTS);
    }

    #[test]
    fn counts_end_at_the_largest_number_and_do_not_wrap() {
        let mut books = Books::default();
        books.roll_back_through(&sender(1), Sequence(u64::MAX), u64::MAX);
        books.roll_back_through(&sender(2), Sequence(9), u64::MAX);
        books.resume(7, u64::MAX);
        assert_eq!((books.published, books.steps_redone), (u64::MAX, u64::MAX));
        assert_eq!(books.check(), Ok(()));
    }

    #[test]
    fn rollouts_waiting_at_a_checkpoint_are_rolled_back_at_the_resume() {
        let mut books = entered(3);
        books.trained = 1;
        books.unused_at_end = 2;
        assert_eq!(books.check(), Ok(()));
        books.resume(2, 8);
        assert_eq!(books.check(), Ok(()));
        assert_eq!((books.unused_at_end, books.rolled_back, books.steps_redone), (0, 2, 16));
    }
}
