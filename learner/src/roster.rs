//! The actors that a learner knows: who is here, and how far each start of each actor has been heard.
//!
//! An actor is a **member** from the moment it has both said hello and shown its liveliness token, until the
//! token is gone. After that it has to say hello again: until it does, it looks for its learner and takes no orders,
//! whatever its token says. A **sender** is one start of an actor, member or not: its sequences, credit and refusals.
//!
//! # Invariants
//!
//! * A connected actor is never displaced by another process with the same name: two of them would do that to each
//!   other for ever.
//! * Hellos alone use up no memory: of senders that are no members a limited number is known, the last ones.

use std::collections::{BTreeMap, BTreeSet};

use leadtime_proto::limits::REFUSALS_BEFORE_CUT_OFF;
use leadtime_proto::{ActorId, Epoch, Incarnation, Iteration, RefusalCause, Sequence};

use crate::books::SenderKey;
use crate::builds::Build;

/// The most senders that are known at once, members apart.
const MAX_SENDERS: usize = 1_024;

/// A membership, in the order in which they began: what was ordered in an earlier one is void, though the start of the
/// actor be the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct MembershipNumber(u64);

/// One start of an actor, as far as this start of the learner knows it.
#[derive(Clone, Debug, Default)]
pub(crate) struct SenderState {
    /// Rollouts up to this one were made before it could have environments of this learner: superseded.
    pub(crate) made_before: Sequence,
    /// Rollouts up to this one were acknowledged to it before, as it says. They enter the books once it works for this learner: it
    /// says so to every learner of the run's name.
    pub(crate) acknowledged_before: Sequence,
    /// The highest sequence it may publish.
    pub(crate) limit: Sequence,
    /// It sent too many refused messages.
    pub(crate) cut_off: bool,
    /// The newest assignment that it was given.
    pub(crate) ordered: Epoch,
    /// What it made under assignments below this one is of environments that may have been taken from it since, up to this sequence.
    behind: (Epoch, Sequence),
    /// How often it followed another one since its last rollout that counted.
    pub(crate) n_astray: u32,
    /// Ticks in which it owed a rollout since then, since it became a member, or since it was given its environments again because
    /// it asked.
    pub(crate) n_idle_ticks: u64,
    /// It has said hello since it was last lost.
    has_greeted: bool,
    /// Its newest membership.
    membership: MembershipNumber,
    /// The newest membership in which it answered an order: somebody is behind its name.
    answered: MembershipNumber,
    /// What it computes with.
    build: Build,
    /// Position in the order of first hellos.
    number: u64,
    n_refused: u64,
    causes: BTreeMap<RefusalCause, u64>,
    /// The iteration and the staleness of its last rollout that counted.
    newest: Option<(Iteration, u64)>,
    /// Ticks since then, or since it became a member.
    n_quiet_ticks: u64,
}

/// What a refusal means for its sender.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RefusalOutcome {
    /// It is the first of its cause: worth a line in the log.
    pub(crate) first: bool,
    /// It was one too many.
    pub(crate) cut_off: bool,
}

impl SenderState {
    /// Counts a refusal against the sender.
    pub(crate) fn refuse(&mut self, cause: RefusalCause) -> RefusalOutcome {
        self.n_refused += 1;
        let cut_off = !self.cut_off && self.n_refused >= REFUSALS_BEFORE_CUT_OFF;
        self.cut_off |= cut_off;
        let n = self.causes.entry(cause).or_default();
        *n += 1;
        RefusalOutcome { first: *n == 1, cut_off }
    }

    /// Notes a rollout that counts.
    pub(crate) fn delivered(&mut self, iteration: Iteration, staleness: u64) {
        self.newest = Some((iteration, staleness));
        (self.n_quiet_ticks, self.n_idle_ticks, self.n_astray) = (0, 0, 0);
    }

    /// Notes that all that it makes from now on is made under this assignment or a later one. What it has published is within its limit.
    pub(crate) fn follows(&mut self, epoch: Epoch) {
        if epoch > self.behind.0 {
            self.behind = (epoch, self.limit);
        }
    }

    /// Returns whether a rollout may have been made before its sender could know which environments it has now.
    pub(crate) fn is_behind(&self, epoch: Epoch, sequence: Sequence) -> bool {
        let (followed, made_through) = self.behind;
        if followed < self.ordered {
            epoch < self.ordered // It has not answered yet; if it never does, it is given up.
        } else {
            epoch < followed && sequence <= made_through
        }
    }

    /// Returns whether it has answered an order of its newest membership.
    fn has_answered(&self) -> bool {
        self.answered == self.membership
    }

    /// Returns whether it has answered an order of any membership. What it made before that is of no use here, because nobody
    /// gets environments earlier.
    pub(crate) fn was_heard(&self) -> bool {
        self.answered != MembershipNumber::default()
    }

    pub(crate) fn has_been_member(&self) -> bool {
        self.membership != MembershipNumber::default()
    }

    /// Returns its refused messages by cause.
    pub(crate) fn causes(&self) -> &BTreeMap<RefusalCause, u64> {
        &self.causes
    }

    /// Returns the iteration and the staleness of its last rollout, and how many ticks ago it came.
    pub(crate) fn newest(&self) -> (Option<(Iteration, u64)>, u64) {
        (self.newest, self.n_quiet_ticks)
    }
}

/// Everyone a learner knows.
#[derive(Clone, Debug, Default)]
pub(crate) struct Roster {
    senders: BTreeMap<SenderKey, SenderState>,
    members: BTreeMap<ActorId, Incarnation>,
    /// Tokens seen; a member is a known sender with a token.
    present: BTreeSet<SenderKey>,
    n_greeted: u64,
    n_memberships: u64,
    /// How many members have answered an order.
    n_answering: usize,
}

impl Roster {
    /// Returns whether a sender has said hello to this start of the learner, and is not forgotten.
    pub(crate) fn knows(&self, key: &SenderKey) -> bool {
        self.senders.contains_key(key)
    }

    /// Returns a sender that has said hello to this start of the learner.
    pub(crate) fn sender(&mut self, key: &SenderKey) -> Option<&mut SenderState> {
        self.senders.get_mut(key)
    }

    /// Notes a hello; `published` is how far the actor has got.
    pub(crate) fn greet(&mut self, key: &SenderKey, published: Sequence, build: Build) {
        if let Some(known) = self.senders.get_mut(key) {
            known.has_greeted = true;
            // Its earlier hello may be one that was answered too late, or a copy that somebody kept for a new learner.
            if !known.was_heard() {
                known.made_before = known.made_before.max(published);
            }
            return;
        }
        self.n_greeted += 1;
        let sender = SenderState {
            made_before: published,
            has_greeted: true,
            build,
            number: self.n_greeted,
            ..SenderState::default()
        };
        self.senders.insert(key.clone(), sender);
        self.forget_one(key);
    }

    /// Forgets the oldest sender that is not a member, if there are too many: first one that
    /// was not cut off.
    fn forget_one(&mut self, newest: &SenderKey) {
        if self.senders.len() <= MAX_SENDERS + self.members.len() {
            return;
        }
        let is_guest = |key: &SenderKey| key != newest && !self.is_member(key);
        let guests = self.senders.iter().filter(|(key, _)| is_guest(key));
        let oldest = guests.min_by_key(|(_, sender)| (sender.cut_off, sender.number));
        if let Some(key) = oldest.map(|(key, _)| key.clone()) {
            self.senders.remove(&key);
        }
    }

    /// Returns whether a member has this name in another start.
    pub(crate) fn is_taken(&self, key: &SenderKey) -> bool {
        self.members.get(&key.0).is_some_and(|&start| start != key.1)
    }

    /// Notes a token, as often as it is reported.
    pub(crate) fn appear(&mut self, key: &SenderKey) {
        self.present.insert(key.clone());
    }

    /// Makes a sender a member if it may be one and is not yet. Returns what it computes with if it is one now.
    pub(crate) fn admit(&mut self, key: &SenderKey) -> Option<Build> {
        let sender = self.senders.get_mut(key)?;
        let is_welcome = sender.has_greeted && !sender.cut_off;
        let is_free = !self.members.contains_key(&key.0) && self.present.contains(key);
        (is_welcome && is_free).then(|| {
            self.n_memberships += 1;
            sender.membership = MembershipNumber(self.n_memberships);
            (sender.n_quiet_ticks, sender.n_idle_ticks) = (0, 0);
            self.members.insert(key.0.clone(), key.1);
            sender.build.clone()
        })
    }

    /// Notes that a token is gone. Returns whether a member was lost by it.
    pub(crate) fn vanish(&mut self, key: &SenderKey) -> bool {
        self.present.remove(key);
        self.expel(key)
    }

    /// Ends a membership: there is none before the next hello. Returns whether there was one.
    pub(crate) fn expel(&mut self, key: &SenderKey) -> bool {
        let was_member = self.is_member(key);
        if let Some(sender) = self.senders.get_mut(key) {
            sender.has_greeted = false;
            if was_member {
                sender.follows(sender.ordered.next());
            }
        }
        if was_member {
            self.n_answering -= usize::from(self.has_answered(&key.0));
            self.members.remove(&key.0);
        }
        was_member
    }

    /// Returns the number of a member's membership.
    pub(crate) fn membership(&self, key: &SenderKey) -> Option<MembershipNumber> {
        let sender = self.senders.get(key).filter(|_| self.is_member(key));
        sender.map(|sender| sender.membership)
    }

    /// Returns whether this start of an actor is a member.
    pub(crate) fn is_member(&self, key: &SenderKey) -> bool {
        self.members.get(&key.0) == Some(&key.1)
    }

    /// Notes that a member has answered an order. Returns whether it is the first answer of its membership.
    pub(crate) fn answer(&mut self, key: &SenderKey) -> bool {
        if !self.is_member(key) {
            return false;
        }
        let Some(sender) = self.senders.get_mut(key) else { return false };
        let is_first = !sender.has_answered();
        sender.answered = sender.membership;
        self.n_answering += usize::from(is_first);
        is_first
    }

    /// Returns whether a member of this name has answered an order.
    pub(crate) fn has_answered(&self, actor: &ActorId) -> bool {
        let key = self.members.get(actor).map(|&start| (actor.clone(), start));
        key.and_then(|key| self.senders.get(&key)).is_some_and(SenderState::has_answered)
    }

    /// Returns the members that have, with their present starts.
    pub(crate) fn answering(&self) -> BTreeMap<ActorId, Incarnation> {
        let answering = self.members.iter().filter(|(actor, _)| self.has_answered(actor));
        answering.map(|(actor, &start)| (actor.clone(), start)).collect()
    }

    /// Counts them.
    pub(crate) fn n_answering(&self) -> usize {
        self.n_answering
    }

    /// Notes that a tick has passed, in which these members owed a rollout.
    pub(crate) fn tick(&mut self, owing: &BTreeSet<ActorId>) {
        for (actor, &incarnation) in &self.members {
            if let Some(sender) = self.senders.get_mut(&(actor.clone(), incarnation)) {
                sender.n_quiet_ticks += 1;
                sender.n_idle_ticks += u64::from(owing.contains(actor));
            }
        }
    }

    /// Returns the members with what is known of their present starts.
    pub(crate) fn member_senders(&self) -> impl Iterator<Item = (SenderKey, &SenderState)> {
        self.members.iter().filter_map(|(actor, &incarnation)| {
            let key = (actor.clone(), incarnation);
            let state = self.senders.get(&key)?;
            Some((key, state))
        })
    }

    pub(crate) fn members(&self) -> &BTreeMap<ActorId, Incarnation> {
        &self.members
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(start: u64) -> SenderKey {
        (ActorId::new("a").unwrap(), Incarnation(start))
    }

    fn greet(roster: &mut Roster, start: u64) {
        roster.greet(&key(start), Sequence(start), Build::default());
    }

    #[test]
    fn a_member_has_said_hello_and_is_alive() {
        let mut roster = Roster::default();
        roster.appear(&key(1));
        assert!(roster.admit(&key(1)).is_none(), "alive, but it has not said hello");
        greet(&mut roster, 1);
        assert!(roster.admit(&key(1)).is_some());
        assert!(roster.admit(&key(1)).is_none(), "it is one already");
        assert!(roster.vanish(&key(1)));
        assert!(roster.members().is_empty());
        roster.appear(&key(1));
        assert!(roster.admit(&key(1)).is_none(), "back from a network cut, but it takes no orders");
        assert_eq!(roster.membership(&key(1)), None);
        roster.greet(&key(1), Sequence(9), Build::default());
        assert!(roster.admit(&key(1)).is_some());
        assert_eq!(roster.membership(&key(1)), Some(MembershipNumber(2)));
        assert_eq!(roster.sender(&key(1)).unwrap().made_before, Sequence(9));
        assert!(roster.answer(&key(1)) && !roster.answer(&key(1)));
        roster.greet(&key(1), Sequence(20), Build::default());
        let made_before = roster.sender(&key(1)).unwrap().made_before;
        assert_eq!(made_before, Sequence(9), "the others may be of this learner's environments");
    }

    #[test]
    fn only_members_that_answer_are_counted() {
        let mut roster = Roster::default();
        greet(&mut roster, 1);
        assert!(!roster.answer(&key(1)), "no member yet");
        roster.appear(&key(1));
        for _ in 0..2 {
            assert!(roster.admit(&key(1)).is_some());
            assert_eq!(roster.n_answering(), 0, "it is asked anew");
            assert!(roster.answer(&key(1)));
            assert_eq!(roster.n_answering(), 1);
            assert!(roster.expel(&key(1)) && !roster.expel(&key(1)));
            assert_eq!(roster.n_answering(), 0);
            greet(&mut roster, 1);
        }
    }

    #[test]
    fn the_first_of_two_starts_stays_until_it_is_gone() {
        let mut roster = Roster::default();
        for start in [1, 2] {
            greet(&mut roster, start);
            roster.appear(&key(start));
        }
        assert!(roster.admit(&key(1)).is_some());
        assert!(roster.is_taken(&key(2)) && !roster.is_taken(&key(1)));
        assert!(roster.admit(&key(2)).is_none());
        assert!(roster.vanish(&key(1)));
        assert!(roster.admit(&key(2)).is_some());
        assert!(!roster.vanish(&key(1)), "the end of the older start does not end the newer");
        assert_eq!(roster.members()[&key(2).0], Incarnation(2));
    }

    #[test]
    fn hellos_of_strangers_use_up_no_memory_and_push_out_no_member() {
        let mut roster = Roster::default();
        greet(&mut roster, 1);
        roster.appear(&key(1));
        assert!(roster.admit(&key(1)).is_some());
        greet(&mut roster, 2);
        roster.sender(&key(2)).unwrap().cut_off = true;
        for start in 3..3 * MAX_SENDERS as u64 {
            greet(&mut roster, start);
            assert!(roster.sender(&key(start)).is_some());
        }
        assert_eq!(roster.senders.len(), MAX_SENDERS + 1);
        assert!(roster.sender(&key(1)).is_some(), "the member");
        assert!(roster.sender(&key(2)).is_some_and(|sender| sender.cut_off));
        assert!(roster.sender(&key(3)).is_none());
    }

    #[test]
    fn too_many_refusals_end_a_membership_for_good() {
        let mut roster = Roster::default();
        greet(&mut roster, 1);
        let sender = roster.sender(&key(1)).unwrap();
        for n in 0..=REFUSALS_BEFORE_CUT_OFF {
            let RefusalOutcome { first, cut_off } = sender.refuse(RefusalCause::NonFinite);
            assert_eq!((first, cut_off), (n == 0, n == 15));
        }
        roster.appear(&key(1));
        assert!(roster.admit(&key(1)).is_none());
    }
}
