//! Taking rollouts from the network into the event queue, with a limit on what each sender may have waiting there.
//!
//! ```text
//! share of a sender   `rollouts_per_actor` places, and an equal part of half of `max_queued_bytes`
//! common pool         the other half: a sender that needs more bytes than its share takes them from here
//! ```
//!
//! A sender within its share always finds room, whatever the others do: their excess is bounded by the pool, and nobody
//! can use another's share. A sender that finds no room is the one that wanted more than its share, so the refusal is its own.
//! The window is chosen so that an honest sender stays within its places; a stalled learner may still cost it bytes of
//! the pool, so having no room ([`RefusalCause::Overflow`]) is no offence: it is counted, and what was refused is sent
//! again.
//!
//! # Invariants
//!
//! * Nothing here waits, and nothing grows with what strangers send: names, places, bytes and counts have limits.
//! * Every refusal is either an event in the queue or part of [`RolloutIntake::take_uncounted`], never both.

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};

use leadtime_proto::receive::ROLLOUT;
use leadtime_proto::{ActorId, Header, Incarnation, Refusal, RefusalCause};
use zenoh::sample::Sample;

use crate::admitted::Admitted;
use crate::event::{LearnerEvent, Payload, QueuePermit, QueueUsage};
use crate::keys;
use crate::lock::lock;
use crate::proof::{Keyring, PeerKey, StartKey, TAG_PROOF_BYTES};
use crate::queue::{Class, EventQueue};
use crate::session::ListenSettings;
use crate::wire;

/// Places in the queue for refusals beside the rollouts' own.
const REFUSAL_PLACES: usize = 1_024;
/// The most pairs of name and cause that are counted apart; the rest is counted without a name.
const MAX_COUNTS: usize = 1_024;

/// Refused messages that are no events, by the name in their key and by cause.
pub type RefusalCounts = BTreeMap<(Option<ActorId>, RefusalCause), u64>;

/// The most starts of actors whose messages are dropped unread, the last ones. Those of others are read, and dropped by the
/// coordinator.
const MAX_CUT_OFF: usize = 1_024;

/// Admits messages from the network's callback to the event queue.
#[derive(Debug)]
pub(crate) struct RolloutIntake {
    pub(crate) keys: Keyring,
    pub(crate) admitted: Arc<Admitted>,
    pub(crate) events: EventQueue<LearnerEvent>,
    per_actor: usize,
    max_actors: usize,
    bytes_per_actor: usize,
    pool_bytes: usize,
    all: Arc<QueueUsage>,
    senders: Mutex<BTreeMap<Option<ActorId>, Arc<QueueUsage>>>,
    /// In the order in which they were cut off.
    cut_off: Mutex<VecDeque<(ActorId, Incarnation)>>,
    uncounted: Mutex<RefusalCounts>,
}

impl RolloutIntake {
    pub(crate) fn new(
        settings: &ListenSettings,
        own: StartKey,
    ) -> (Self, flume::Receiver<LearnerEvent>) {
        let per_actor = settings.rollouts_per_actor;
        let n_bulk = per_actor.saturating_mul(settings.max_actors) + REFUSAL_PLACES;
        let (events, receiver) = EventQueue::new(n_bulk);
        let half = settings.max_queued_bytes / 2;
        let intake = Self {
            keys: Keyring::new(own),
            admitted: Arc::default(),
            events,
            per_actor,
            max_actors: settings.max_actors,
            bytes_per_actor: half / settings.max_actors.max(1),
            pool_bytes: half,
            all: Arc::default(),
            senders: Mutex::default(),
            cut_off: Mutex::default(),
            uncounted: Mutex::default(),
        };
        (intake, receiver)
    }

    /// Takes a rollout message: checks it, gives it a place, or refuses it.
    pub(crate) fn rollout(&self, sample: &Sample) {
        let Some(actor) = keys::parse_rollouts(sample.key_expr()) else {
            return self.refuse(None, malformed_key());
        };
        // Whatever number its header has: nothing is proved, so nobody is blamed.
        let refuse = |actor: ActorId, refusal: Refusal| {
            self.refuse(Some(actor), Refusal { sender: None, ..refusal });
        };
        let (header, key) = match self.admit(&actor, sample) {
            Ok(admitted) => admitted,
            Err(refusal) => return refuse(actor, refusal),
        };
        let message = sample.payload().to_bytes();
        let body = match key.check(&header, &message) {
            Ok(body) => body,
            Err(refusal) => return refuse(actor, refusal),
        };
        if lock(&self.cut_off).contains(&(actor.clone(), header.incarnation)) {
            return self.count(Some(actor), RefusalCause::CutOff);
        }
        let Some(permit) = self.permit(Some(&actor), body.len()) else {
            return self.count(Some(actor), RefusalCause::Overflow);
        };
        // Copied on purpose: the network's buffer is shared with whatever arrived together with this message, so
        // keeping a small rollout could keep much more than the bytes that its sender is billed for.
        let payload = Payload::new(body.to_vec(), permit);
        let event = LearnerEvent::Rollout { actor, header, payload };
        if let Some(LearnerEvent::Rollout { actor, .. }) = self.events.offer(event, Class::Bulk) {
            self.count(Some(actor), RefusalCause::Overflow);
        }
    }

    /// Checks that a rollout says to come from the welcome start of the actor in its key, before a byte of it is touched.
    /// Returns its header, and the key that it has to be proved with.
    fn admit(&self, actor: &ActorId, sample: &Sample) -> Result<(Header, Arc<PeerKey>), Refusal> {
        let expected = wire::with_proof(ROLLOUT, TAG_PROOF_BYTES);
        let header = wire::inspect(sample.attachment(), Some(sample.payload()), expected)?;
        let Some(key) = self.admitted.key(actor, header.incarnation) else {
            let text = "rollout of an actor that is not welcome here (yet)";
            return Err(Refusal::new(RefusalCause::Stranger, text));
        };
        Ok((header, key))
    }

    /// Reports a refusal as an event as long as its sender has room for one, and counts it otherwise.
    pub(crate) fn refuse(&self, actor: Option<ActorId>, refusal: Refusal) {
        // A sender that cannot be named has no share of its own: otherwise a stranger could use up the share of any name.
        let of = actor.as_ref().filter(|_| refusal.sender.is_some());
        let cause = refusal.cause;
        let Some(permit) = self.permit(of, 0) else { return self.count(actor, cause) };
        let event = LearnerEvent::Refused { actor, refusal, permit };
        if let Some(LearnerEvent::Refused { actor, .. }) = self.events.offer(event, Class::Bulk) {
            self.count(actor, cause);
        }
    }

    /// Counts a refusal that is no event.
    pub(crate) fn count(&self, actor: Option<ActorId>, cause: RefusalCause) {
        let mut counts = lock(&self.uncounted);
        let key = (actor, cause);
        let has_room = counts.len() < MAX_COUNTS || counts.contains_key(&key);
        let key = if has_room { key } else { (None, cause) };
        *counts.entry(key).or_default() += 1;
    }

    /// Returns the refusals that were no events since the last call.
    pub(crate) fn take_uncounted(&self) -> RefusalCounts {
        std::mem::take(&mut lock(&self.uncounted))
    }

    /// Returns the bytes of rollouts that wait, by the name in their keys.
    pub(crate) fn queued_bytes(&self) -> BTreeMap<ActorId, usize> {
        let senders = lock(&self.senders);
        let named = senders.iter().filter_map(|(actor, usage)| {
            Some((actor.clone()?, usage.n_bytes.load(Ordering::Relaxed)))
        });
        named.filter(|(_, n_bytes)| *n_bytes > 0).collect()
    }

    /// Returns how many bytes wait in the queue, all senders' together.
    pub(crate) fn n_queued_bytes(&self) -> usize {
        self.all.n_bytes.load(Ordering::Relaxed)
    }

    /// Takes nothing more from this start of the actor.
    pub(crate) fn cut_off(&self, actor: &ActorId, incarnation: Incarnation) {
        let mut cut_off = lock(&self.cut_off);
        cut_off.push_back((actor.clone(), incarnation));
        if cut_off.len() > MAX_CUT_OFF {
            cut_off.pop_front();
        }
    }

    /// Takes room for a message of `len` bytes. Nobody's messages share one allowance.
    fn permit(&self, actor: Option<&ActorId>, len: usize) -> Option<QueuePermit> {
        let mut senders = lock(&self.senders);
        let actor = actor.cloned();
        if !senders.contains_key(&actor) && senders.len() > self.max_actors {
            senders.retain(|_, usage| usage.n_messages.load(Ordering::Relaxed) > 0);
            if senders.len() > self.max_actors {
                return None;
            }
        }
        let usage = senders.entry(actor).or_default();
        let load = |n: &std::sync::atomic::AtomicUsize| n.load(Ordering::Relaxed);
        let fits = |used: usize, limit: usize| used.saturating_add(len) <= limit;
        let in_share = fits(load(&usage.n_bytes), self.bytes_per_actor);
        let has_bytes = in_share || fits(load(&self.all.n_bytes), self.pool_bytes);
        // Only callbacks take, and they hold the lock; others only give back.
        (load(&usage.n_messages) < self.per_actor && has_bytes)
            .then(|| QueuePermit::take(usage, &self.all, len))
    }
}

/// What is wrong with a message on a key that names no actor.
pub(crate) fn malformed_key() -> Refusal {
    Refusal::new(RefusalCause::Key, "message arrived on a malformed key")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn intake(
        per_actor: usize,
        max_actors: usize,
    ) -> (RolloutIntake, flume::Receiver<LearnerEvent>) {
        let settings = ListenSettings {
            rollouts_per_actor: per_actor,
            max_actors,
            max_queued_bytes: 200,
            ..ListenSettings::new(Vec::new())
        };
        RolloutIntake::new(&settings, StartKey::numbered(1))
    }

    fn actor(id: &str) -> ActorId {
        ActorId::new(id).unwrap()
    }

    fn damaged(sender: Option<u64>) -> Refusal {
        let sender = sender.map(Incarnation);
        Refusal { sender, ..Refusal::new(RefusalCause::Checksum, "damaged") }
    }

    #[test]
    fn a_greedy_sender_leaves_the_others_their_places() {
        let (intake, _events) = intake(2, 4);
        let permit = |id: &str| intake.permit(Some(&actor(id)), 1);
        let greedy = [permit("g"), permit("g")];
        assert!(greedy.iter().all(Option::is_some));
        assert!(permit("g").is_none() && permit("h").is_some());
        drop(greedy);
        assert!(permit("g").is_some());
    }

    #[test]
    fn using_up_the_pool_takes_no_reserved_share() {
        // A share is 25 bytes, the pool 100.
        let (intake, _events) = intake(64, 4);
        let permit = |id: &str, n_bytes| intake.permit(Some(&actor(id)), n_bytes);
        let first = permit("a", 60).unwrap();
        assert!(permit("b", 60).is_none(), "neither in its share nor the pool");
        let more = permit("a", 40).unwrap();
        assert!(permit("a", 1).is_none(), "the greedy one is refused");
        let share = |id| (0..5).map(move |_| permit(id, 5).expect("its share"));
        let held: Vec<QueuePermit> = ["b", "c", "d"].into_iter().flat_map(share).collect();
        assert!(permit("b", 1).is_none());
        drop((first, more, held));
        assert!(permit("b", 60).is_some());
    }

    #[test]
    fn invented_senders_do_not_use_up_memory() {
        let (intake, _events) = intake(1, 2);
        let held: Vec<_> =
            (0..10).map(|i| intake.permit(Some(&actor(&format!("a{i}"))), 0)).collect();
        assert_eq!(held.iter().filter(|permit| permit.is_some()).count(), 3);
        drop(held);
        assert!(intake.permit(Some(&actor("late")), 0).is_some());
        for i in 0..2 * MAX_COUNTS {
            intake.count(Some(actor(&format!("a{i}"))), RefusalCause::Overflow);
        }
        for i in 0..2 * MAX_CUT_OFF {
            intake.cut_off(&actor(&format!("a{i}")), Incarnation(1));
        }
        assert_eq!(lock(&intake.cut_off).len(), MAX_CUT_OFF);
        assert!(intake.permit(Some(&actor("later")), 0).is_some(), "they take no places");
        let counts = intake.take_uncounted();
        assert!(counts.len() <= MAX_COUNTS + 1);
        assert_eq!(counts.values().sum::<u64>(), 2 * MAX_COUNTS as u64);
    }

    #[test]
    fn every_refusal_is_an_event_or_a_number() {
        let (intake, events) = intake(2, 4);
        for _ in 0..5 {
            intake.refuse(Some(actor("a")), damaged(Some(1)));
        }
        intake.count(Some(actor("a")), RefusalCause::Overflow);
        let told = events.try_iter().filter(|event| {
            matches!(event, LearnerEvent::Refused { refusal, .. } if refusal.sender == Some(Incarnation(1)))
        });
        assert_eq!(told.count(), 2);
        let numbers = [(RefusalCause::Overflow, 1), (RefusalCause::Checksum, 3)];
        let numbers = numbers.map(|(cause, n)| ((Some(actor("a")), cause), n));
        assert_eq!(intake.take_uncounted(), RefusalCounts::from(numbers));
        assert!(intake.take_uncounted().is_empty(), "each is reported once");
    }

    #[test]
    fn a_sender_without_a_name_uses_up_nobodys_share() {
        let (intake, events) = intake(2, 4);
        for _ in 0..5 {
            intake.refuse(Some(actor("a")), damaged(None));
        }
        assert_eq!(events.len(), 2);
        assert!(intake.permit(Some(&actor("a")), 1).is_some());
    }
}
