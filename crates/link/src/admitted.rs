//! Which start of which actor a learner takes rollouts from, and the key that it shares with it.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex};

use leadtime_proto::{ActorId, Incarnation};

use crate::lock::lock;
use crate::proof::PeerKey;

/// The most starts that are admitted and were never credited or ordered about: anybody can say hello under many names.
const MAX_GUESTS: usize = 1_024;

/// The starts of actors that were made welcome and are still there: only theirs are the places of their names.
#[derive(Debug, Default)]
pub(crate) struct Admitted(Mutex<Admissions>);

#[derive(Debug, Default)]
struct Admissions {
    by_name: BTreeMap<ActorId, Admission>,
    /// Who was admitted, in this order; some may have become members, or be gone.
    guests: VecDeque<(ActorId, Incarnation)>,
}

#[derive(Debug)]
struct Admission {
    key: Arc<PeerKey>,
    /// The learner counts on it, so hellos of others do not push it out.
    is_member: bool,
}

impl Admitted {
    /// Admits the start that has this key instead of any earlier one of the actor.
    pub(crate) fn insert(&self, actor: ActorId, key: Arc<PeerKey>) {
        let mut all = lock(&self.0);
        let start = key.peer;
        if all.of(&actor, start).is_some() {
            return;
        }
        all.guests.push_back((actor.clone(), start));
        all.by_name.insert(actor, Admission { key, is_member: false });
        if all.guests.len() > MAX_GUESTS
            && let Some((actor, start)) = all.guests.pop_front()
            && all.of(&actor, start).is_some_and(|admission| !admission.is_member)
        {
            all.by_name.remove(&actor);
        }
    }

    /// Forgets a start that is gone.
    pub(crate) fn remove(&self, actor: &ActorId, start: Incarnation) {
        let mut all = lock(&self.0);
        if all.of(actor, start).is_some() {
            all.by_name.remove(actor);
        }
    }

    /// Returns the key of this start, if it is the one that was admitted last.
    pub(crate) fn key(&self, actor: &ActorId, start: Incarnation) -> Option<Arc<PeerKey>> {
        lock(&self.0).of(actor, start).map(|admission| Arc::clone(&admission.key))
    }

    /// Does the same for what a learner tells its members.
    pub(crate) fn member_key(&self, actor: &ActorId, start: Incarnation) -> Option<Arc<PeerKey>> {
        let mut all = lock(&self.0);
        let admission = all.of(actor, start)?;
        admission.is_member = true;
        Some(Arc::clone(&admission.key))
    }
}

impl Admissions {
    fn of(&mut self, actor: &ActorId, start: Incarnation) -> Option<&mut Admission> {
        self.by_name.get_mut(actor).filter(|admission| admission.key.peer == start)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::proof::StartKey;

    #[test]
    fn hellos_under_many_names_use_up_no_memory_and_push_out_no_member() {
        let (learner, admitted) = (StartKey::numbered(1), Admitted::default());
        let actor = |n: usize| ActorId::new(format!("a{n}")).unwrap();
        let key = Arc::new(PeerKey::shared(&learner, &StartKey::numbered(2)));
        let start = key.peer;
        admitted.insert(actor(0), Arc::clone(&key));
        assert!(admitted.member_key(&actor(0), start).is_some());
        for n in 1..=3 * MAX_GUESTS {
            admitted.insert(actor(n), Arc::clone(&key));
            assert!(admitted.key(&actor(n), start).is_some(), "the newest is in");
        }
        assert!(admitted.key(&actor(0), start).is_some(), "the member");
        assert!(admitted.key(&actor(1), start).is_none());
        let all = lock(&admitted.0);
        assert!(all.by_name.len() <= MAX_GUESTS + 1 && all.guests.len() <= MAX_GUESTS);
    }

    #[test]
    fn the_latest_start_of_each_name_is_admitted_until_it_is_gone() {
        let (learner, admitted) = (StartKey::numbered(1), Admitted::default());
        let actor = ActorId::new("a").unwrap();
        let [first, second] =
            [2, 3].map(|n| Arc::new(PeerKey::shared(&learner, &StartKey::numbered(n))));
        admitted.insert(actor.clone(), Arc::clone(&first));
        admitted.insert(actor.clone(), Arc::clone(&second));
        assert!(admitted.key(&actor, first.peer).is_none());
        admitted.remove(&actor, first.peer);
        assert!(admitted.member_key(&actor, second.peer).is_some());
        admitted.remove(&actor, second.peer);
        assert!(admitted.key(&actor, second.peer).is_none());
    }
}
