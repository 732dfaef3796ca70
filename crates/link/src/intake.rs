//! Taking rollouts from the network into the event queue: who may have how much waiting there.
//!
//! A sender that keeps to its window always finds room. One that does not is refused and counted, and cannot keep the
//! others out: each has its own share of places, and all together have a limit in bytes.

use std::collections::BTreeMap;
use std::ops::Deref;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use leadtime_proto::receive::ROLLOUT;
use leadtime_proto::{ActorId, Header, Incarnation, Refusal, RefusalCause};
use zenoh::sample::Sample;

use crate::keys;
use crate::learner::LearnerEvent;
use crate::queue::{Class, EventQueue};
use crate::session::ListenSettings;
use crate::wire;

/// Places in the queue for refusals beside the rollouts' own.
const REFUSAL_PLACES: usize = 1_024;

/// One place (and some bytes) in the event queue, given back when dropped.
#[derive(Debug, Default)]
pub struct Place {
    of_actor: Option<Arc<AtomicUsize>>,
    of_bytes: Option<(Arc<AtomicUsize>, usize)>,
}

impl Drop for Place {
    fn drop(&mut self) {
        if let Some(n_queued) = &self.of_actor {
            n_queued.fetch_sub(1, Ordering::Relaxed);
        }
        if let Some((n_bytes, len)) = &self.of_bytes {
            n_bytes.fetch_sub(*len, Ordering::Relaxed);
        }
    }
}

/// The body of a rollout message: bytes that count against their sender's share until dropped.
#[derive(Debug)]
pub struct Payload {
    bytes: Vec<u8>,
    _place: Place,
}

impl Deref for Payload {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.bytes
    }
}

impl From<Vec<u8>> for Payload {
    fn from(bytes: Vec<u8>) -> Self {
        Self { bytes, _place: Place::default() }
    }
}

#[derive(Debug, Default)]
struct Sender {
    n_queued: Arc<AtomicUsize>,
    cut_off: Option<Incarnation>,
}

/// What stands between the network's callback and the event queue.
#[derive(Debug)]
pub(crate) struct Intake {
    events: EventQueue<LearnerEvent>,
    per_actor: usize,
    max_actors: usize,
    max_bytes: usize,
    n_bytes: Arc<AtomicUsize>,
    senders: Mutex<BTreeMap<Option<ActorId>, Sender>>,
    refusals: Mutex<BTreeMap<RefusalCause, u64>>,
}

impl Intake {
    pub(crate) fn new(settings: &ListenSettings) -> (Self, flume::Receiver<LearnerEvent>) {
        let per_actor = settings.rollouts_per_actor;
        let n_bulk = per_actor.saturating_mul(settings.max_actors) + REFUSAL_PLACES;
        let (events, receiver) = EventQueue::new(n_bulk);
        let intake = Self {
            events,
            per_actor,
            max_actors: settings.max_actors,
            max_bytes: settings.max_queued_bytes,
            n_bytes: Arc::default(),
            senders: Mutex::default(),
            refusals: Mutex::default(),
        };
        (intake, receiver)
    }

    /// Takes a rollout message: checks it, gives it a place, or refuses it.
    pub(crate) fn rollout(&self, sample: &Sample) {
        let Some(actor) = keys::parse_rollouts(sample.key_expr()) else {
            return self.refuse(None, None, Refusal::Key);
        };
        let checked = wire::inspect(sample.attachment(), Some(sample.payload()), ROLLOUT);
        let header = match checked {
            Ok(header) => header,
            Err(refusal) => return self.refuse(Some(actor), None, refusal),
        };
        if self.is_cut_off(&actor, header.incarnation) {
            return self.count(RefusalCause::CutOff);
        }
        let Some(place) = self.place(Some(&actor), sample.payload().len()) else {
            return self.refuse(Some(actor), Some(header), Refusal::Overflow);
        };
        let payload = Payload { bytes: sample.payload().to_bytes().into_owned(), _place: place };
        let event = LearnerEvent::Rollout { actor, header, payload };
        if self.events.offer(event, Class::Bulk).is_err() {
            self.count(RefusalCause::Overflow);
        }
    }

    /// Offers an event that is neither a rollout nor a refusal; gives it back if there is no room.
    pub(crate) fn offer(&self, event: LearnerEvent, class: Class) -> Option<LearnerEvent> {
        self.events.offer(event, class).err().map(|overflow| overflow.0)
    }

    /// Counts a refusal and tells of it, as long as its sender has few untold.
    pub(crate) fn refuse(&self, actor: Option<ActorId>, header: Option<Header>, refusal: Refusal) {
        self.count(refusal.cause());
        if let Some(place) = self.place(actor.as_ref(), 0) {
            let event = LearnerEvent::Refused { actor, header, refusal, place };
            self.events.offer_or_drop(event, Class::Bulk);
        }
    }

    pub(crate) fn count(&self, cause: RefusalCause) {
        *lock(&self.refusals).entry(cause).or_default() += 1;
    }

    pub(crate) fn refusals(&self) -> BTreeMap<RefusalCause, u64> {
        lock(&self.refusals).clone()
    }

    pub(crate) fn n_lost(&self) -> u64 {
        self.events.n_lost()
    }

    /// Takes nothing more from this start of the actor.
    pub(crate) fn cut_off(&self, actor: &ActorId, incarnation: Incarnation) {
        lock(&self.senders).entry(Some(actor.clone())).or_default().cut_off = Some(incarnation);
    }

    fn is_cut_off(&self, actor: &ActorId, incarnation: Incarnation) -> bool {
        let senders = lock(&self.senders);
        let known = senders.get(&Some(actor.clone()));
        known.is_some_and(|sender| sender.cut_off == Some(incarnation))
    }

    /// Reserves a place for a message of `len` bytes. Nobody's messages share one allowance.
    fn place(&self, actor: Option<&ActorId>, len: usize) -> Option<Place> {
        let mut senders = lock(&self.senders);
        let actor = actor.cloned();
        if !senders.contains_key(&actor) && senders.len() > self.max_actors {
            senders.retain(|_, sender| {
                sender.cut_off.is_some() || sender.n_queued.load(Ordering::Relaxed) > 0
            });
            if senders.len() > self.max_actors {
                return None;
            }
        }
        let n_queued = &senders.entry(actor).or_default().n_queued;
        let full = n_queued.load(Ordering::Relaxed) >= self.per_actor
            || self.n_bytes.load(Ordering::Relaxed).saturating_add(len) > self.max_bytes;
        if full {
            return None;
        }
        // Only callbacks add, and they hold the lock; others only give back.
        n_queued.fetch_add(1, Ordering::Relaxed);
        self.n_bytes.fetch_add(len, Ordering::Relaxed);
        Some(Place {
            of_actor: Some(Arc::clone(n_queued)),
            of_bytes: Some((Arc::clone(&self.n_bytes), len)),
        })
    }
}

/// Locks; what these locks guard is consistent after every single operation, so a panic elsewhere does no harm.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn intake(per_actor: usize, max_actors: usize) -> Intake {
        let settings = ListenSettings {
            rollouts_per_actor: per_actor,
            max_actors,
            max_queued_bytes: 100,
            ..ListenSettings::new(Vec::new())
        };
        Intake::new(&settings).0
    }

    fn actor(id: &str) -> ActorId {
        ActorId::new(id).unwrap()
    }

    #[test]
    fn a_greedy_sender_leaves_the_others_their_places() {
        let intake = intake(2, 4);
        let greedy = [intake.place(Some(&actor("g")), 1), intake.place(Some(&actor("g")), 1)];
        assert!(greedy.iter().all(Option::is_some));
        assert!(intake.place(Some(&actor("g")), 1).is_none());
        assert!(intake.place(Some(&actor("h")), 1).is_some());
        drop(greedy);
        assert!(intake.place(Some(&actor("g")), 1).is_some());
    }

    #[test]
    fn waiting_bytes_have_a_limit_over_all_senders() {
        let intake = intake(8, 4);
        let first = intake.place(Some(&actor("a")), 60);
        assert!(intake.place(Some(&actor("b")), 60).is_none());
        drop(first);
        assert!(intake.place(Some(&actor("b")), 60).is_some());
    }

    #[test]
    fn invented_senders_do_not_use_up_memory() {
        let intake = intake(1, 2);
        let held: Vec<_> =
            (0..10).map(|i| intake.place(Some(&actor(&format!("a{i}"))), 0)).collect();
        assert_eq!(held.iter().filter(|place| place.is_some()).count(), 3);
        drop(held);
        assert!(intake.place(Some(&actor("late")), 0).is_some());
    }

    #[test]
    fn refusals_are_counted_even_when_nobody_listens() {
        let intake = intake(1, 2);
        for _ in 0..5 {
            intake.refuse(Some(actor("a")), None, Refusal::Checksum);
        }
        assert_eq!(intake.refusals(), BTreeMap::from([(RefusalCause::Checksum, 5)]));
    }
}
