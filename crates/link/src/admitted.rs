//! Which start of which actor a learner takes rollouts from.

use std::collections::BTreeMap;
use std::sync::Mutex;

use leadtime_proto::{ActorId, Incarnation};

use crate::lock::lock;

/// The starts of actors that were made welcome and are still there: only theirs are the places of their names.
#[derive(Debug, Default)]
pub(crate) struct Admitted(Mutex<BTreeMap<ActorId, Incarnation>>);

impl Admitted {
    /// Admits a start of an actor instead of any earlier one.
    pub(crate) fn insert(&self, actor: ActorId, start: Incarnation) {
        lock(&self.0).insert(actor, start);
    }

    /// Forgets a start that is gone.
    pub(crate) fn remove(&self, actor: &ActorId, start: Incarnation) {
        let mut admitted = lock(&self.0);
        if admitted.get(actor) == Some(&start) {
            admitted.remove(actor);
        }
    }

    /// Tells whether this start is the one that was admitted last.
    pub(crate) fn contains(&self, actor: &ActorId, start: Incarnation) -> bool {
        lock(&self.0).get(actor) == Some(&start)
    }
}
