//! Who steps which environment, and since which epoch.
//!
//! Environments move only when actors come, go or misbehave, as few as possible, and the result depends on
//! nothing but the members, what they had, and how much each may have: first everyone keeps their lowest environments
//! up to a fair share, then what is free goes, in ascending order, to those with room. A first assignment is therefore
//! contiguous. No environment waits because all members are limited: somebody has to step it.
//!
//! A rollout counts only if its epoch is not older than its sender's ownership ([`Ownership::since`]), so one
//! that was under way when its environment moved cannot be mistaken for one that was made after it came back.

use std::collections::BTreeMap;

use leadtime_proto::{ActorId, EnvId, Epoch, Incarnation};

use crate::books::SenderKey;

/// Who steps an environment, and the assignment that gave it to this start of an actor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Ownership {
    pub(crate) key: SenderKey,
    pub(crate) since: Epoch,
}

/// A new set of environments for one actor, which has to be sent to it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Reassignment {
    pub(crate) actor: ActorId,
    pub(crate) epoch: Epoch,
    pub(crate) given: Vec<EnvId>,
    /// Environments that it goes on with undisturbed.
    pub(crate) kept: Vec<EnvId>,
}

/// Who steps which environment at present, and the newest epoch.
#[derive(Clone, Debug)]
pub(crate) struct Assigner {
    /// The epoch of the newest assignment; every change opens the next one.
    pub(crate) epoch: Epoch,
    owners: Vec<Option<Ownership>>,
    /// Where the numbers of members that followed somebody else's assignment begin: of each for itself, for what one of them says
    /// must not concern the others. They are compared among those of one actor only.
    overruled: BTreeMap<ActorId, Epoch>,
}

impl Assigner {
    /// Starts without actors, after the epochs that a checkpoint knows of.
    pub(crate) fn new(n_envs: usize, epoch: Epoch) -> Self {
        Self { epoch, owners: vec![None; n_envs], overruled: BTreeMap::new() }
    }

    pub(crate) fn n_envs(&self) -> usize {
        self.owners.len()
    }

    /// Returns the number of an actor's next assignment: the run's next one, unless this actor needs a higher one.
    pub(crate) fn next_epoch(&mut self, actor: &ActorId) -> Epoch {
        self.epoch = self.epoch.next();
        let Some(own) = self.overruled.get_mut(actor) else { return self.epoch };
        *own = own.next().max(self.epoch);
        *own
    }

    /// Lets the numbers of this actor's assignments, and of nobody else's, begin above this one.
    pub(crate) fn count_on_from(&mut self, actor: &ActorId, epoch: Epoch) {
        if epoch > self.epoch {
            let own = self.overruled.entry(actor.clone()).or_default();
            *own = epoch.max(*own);
        }
    }

    /// Returns the owner of an environment; `None` also for one that the run does not have.
    pub(crate) fn owner(&self, env_id: EnvId) -> Option<&Ownership> {
        self.owners.get(env_id.0 as usize)?.as_ref()
    }

    /// Returns whether a start of an actor, following this assignment or a newer one, has an environment.
    pub(crate) fn owns(&self, actor: &SenderKey, epoch: Epoch, env_id: EnvId) -> bool {
        self.owner(env_id).is_some_and(|owner| owner.key == *actor && epoch >= owner.since)
    }

    /// Returns whether an environment waits for an actor.
    pub(crate) fn has_orphans(&self) -> bool {
        self.owners.iter().any(Option::is_none)
    }

    /// Takes everything from an actor and returns how many environments that was.
    pub(crate) fn release(&mut self, actor: &ActorId) -> usize {
        self.overruled.remove(actor);
        let released = self.held(actor);
        for env_id in &released {
            self.owners[env_id.0 as usize] = None;
        }
        released.len()
    }

    /// Gives an actor its own environments again, from their newest snapshots, under a new epoch.
    pub(crate) fn renew(&mut self, actor: &ActorId) -> Option<Reassignment> {
        let given = self.held(actor);
        (!given.is_empty()).then(|| self.change(actor.clone(), given))
    }

    /// Gives an actor its own environments again, even if it has none, under an epoch above the one that somebody else
    /// gave it.
    pub(crate) fn overrule(&mut self, actor: &ActorId, told: Epoch) -> Reassignment {
        self.count_on_from(actor, told);
        self.change(actor.clone(), self.held(actor))
    }

    /// Gives environments to the actors named with them, from their newest snapshots. Returns what has to be sent to
    /// each actor that gets or loses some, by name.
    pub(crate) fn hand_over(&mut self, moves: Vec<(EnvId, SenderKey)>) -> Vec<Reassignment> {
        let mut concerned: BTreeMap<ActorId, Vec<EnvId>> = BTreeMap::new();
        for (env_id, key) in moves {
            // An actor that loses an environment gets an assignment too, or it would keep stepping it.
            if let Some(from) = self.owner(env_id) {
                concerned.entry(from.key.0.clone()).or_default();
            }
            concerned.entry(key.0.clone()).or_default().push(env_id);
            // A place-holder: `change` below sets the epoch of those that are given.
            self.owners[env_id.0 as usize] = Some(Ownership { key, since: self.epoch });
        }
        let change = |(actor, given)| self.change(actor, given);
        concerned.into_iter().map(change).collect()
    }

    /// Begins an epoch for an actor that was given these of its environments.
    fn change(&mut self, actor: ActorId, given: Vec<EnvId>) -> Reassignment {
        let epoch = self.next_epoch(&actor);
        let mut kept = self.held(&actor);
        kept.retain(|env_id| !given.contains(env_id));
        for env_id in &given {
            if let Some(owner) = &mut self.owners[env_id.0 as usize] {
                owner.since = epoch;
            }
        }
        Reassignment { actor, epoch, given, kept }
    }

    /// Shares the environments among the members, each of whom should have at most `max_envs`. Returns what has to be
    /// sent to whom.
    pub(crate) fn rebalance(
        &mut self,
        members: &BTreeMap<ActorId, Incarnation>,
        max_envs: impl Fn(&ActorId) -> usize,
    ) -> Vec<Reassignment> {
        let quotas = self.quotas(members, max_envs);
        // All surplus is taken back before any is given out: otherwise an actor could only get what its predecessors
        // gave up.
        let mut dropped: BTreeMap<&ActorId, bool> = BTreeMap::new();
        for (actor, &quota) in &quotas {
            let held = self.held(actor);
            // Lowest first, so that the same members and holdings always lead to the same assignment.
            for env_id in held.iter().skip(quota) {
                self.owners[env_id.0 as usize] = None;
            }
            dropped.insert(actor, held.len() > quota);
        }
        let mut changes = Vec::new();
        for (actor, &quota) in &quotas {
            let mut given = self.env_ids(|owner| owner.is_none());
            given.truncate(quota - self.held(actor).len());
            let owner = Ownership { key: (actor.clone(), members[actor]), since: self.epoch };
            for env_id in &given {
                self.owners[env_id.0 as usize] = Some(owner.clone());
            }
            if !given.is_empty() || dropped[actor] {
                changes.push(self.change(actor.clone(), given));
            }
        }
        changes
    }

    /// Fair shares, as equal as the limits allow; the larger ones go to those who hold most.
    fn quotas(
        &self,
        members: &BTreeMap<ActorId, Incarnation>,
        max_envs: impl Fn(&ActorId) -> usize,
    ) -> BTreeMap<ActorId, usize> {
        let mut order: Vec<&ActorId> = members.keys().collect();
        // A stable sort: among equals the order is that of their names, which no process's timing decides.
        order.sort_by_key(|actor| std::cmp::Reverse(self.held(actor).len()));
        let mut quotas: Vec<(&ActorId, usize, usize)> =
            order.into_iter().map(|actor| (actor, max_envs(actor), 0)).collect();
        // Without members nobody takes anything, and the loop would not end.
        let mut n_left = if quotas.is_empty() { 0 } else { self.owners.len() };
        while n_left > 0 {
            // Limits that leave environments over do not hold: first those of members that may have some.
            let has_room = quotas.iter().any(|(_, limit, quota)| quota < limit);
            let is_trusted = quotas.iter().any(|(_, limit, _)| *limit > 0);
            for (_, limit, quota) in &mut quotas {
                let takes = if has_room { *quota < *limit } else { *limit > 0 || !is_trusted };
                let n_taken = usize::from(takes && n_left > 0);
                *quota += n_taken;
                n_left -= n_taken;
            }
        }
        quotas.into_iter().map(|(actor, _, quota)| (actor.clone(), quota)).collect()
    }

    /// Returns how many environments each member has.
    pub(crate) fn counts(
        &self,
        members: &BTreeMap<ActorId, Incarnation>,
    ) -> BTreeMap<ActorId, usize> {
        members.keys().map(|actor| (actor.clone(), self.held(actor).len())).collect()
    }

    /// Counts the environments of an actor, and returns the newest assignment that gave it one.
    pub(crate) fn holding(&self, actor: &ActorId) -> (usize, Epoch) {
        let own = self.owners.iter().flatten().filter(|owner| owner.key.0 == *actor);
        own.fold((0, Epoch(0)), |(n, newest), owner| (n + 1, newest.max(owner.since)))
    }

    fn held(&self, actor: &ActorId) -> Vec<EnvId> {
        self.env_ids(|owner| owner.is_some_and(|owner| owner.key.0 == *actor))
    }

    fn env_ids(&self, wanted: impl Fn(Option<&Ownership>) -> bool) -> Vec<EnvId> {
        let owners = (0_u32..).zip(&self.owners);
        owners.filter(|(_, owner)| wanted(owner.as_ref())).map(|(id, _)| EnvId(id)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn id(name: &str) -> ActorId {
        ActorId::new(name).unwrap()
    }

    fn members(names: &[&str]) -> BTreeMap<ActorId, Incarnation> {
        names.iter().map(|name| (id(name), Incarnation(1))).collect()
    }

    fn sets(assigner: &Assigner, names: &[&str]) -> Vec<Vec<u32>> {
        let set = |name: &&str| assigner.held(&id(name)).iter().map(|env| env.0).collect();
        names.iter().map(set).collect()
    }

    /// Shares among members without limits.
    fn share(assigner: &mut Assigner, names: &[&str]) -> Vec<Reassignment> {
        assigner.rebalance(&members(names), |_| usize::MAX)
    }

    #[test]
    fn a_first_assignment_is_contiguous_and_balanced() {
        let mut assigner = Assigner::new(5, Epoch(0));
        let changes = share(&mut assigner, &["a", "b"]);
        assert_eq!(sets(&assigner, &["a", "b"]), [vec![0, 1, 2], vec![3, 4]]);
        assert_eq!(changes.len(), 2);
        assert!(changes.iter().all(|change| change.kept.is_empty()));
        let mut one = Assigner::new(1, Epoch(0));
        assert_eq!(share(&mut one, &["a", "b", "c"]).len(), 1, "more actors than environments");
        assert!(!one.has_orphans());
    }

    #[test]
    fn a_joiner_gets_its_share_and_the_others_keep_theirs() {
        let mut assigner = Assigner::new(4, Epoch(0));
        share(&mut assigner, &["a"]);
        let changes = share(&mut assigner, &["a", "b"]);
        assert_eq!(sets(&assigner, &["a", "b"]), [vec![0, 1], vec![2, 3]]);
        let (a, b) = (&changes[0], &changes[1]);
        assert_eq!((a.given.len(), a.kept.len()), (0, 2));
        assert_eq!((b.given.len(), b.kept.len()), (2, 0));
        assert_eq!(assigner.owner(EnvId(0)).unwrap().since, Epoch(1), "kept: its ownership is old");
        assert_eq!(assigner.owner(EnvId(2)).unwrap().since, b.epoch);
        assert!(share(&mut assigner, &["a", "b"]).is_empty(), "who is not touched hears nothing");
    }

    #[test]
    fn the_envs_of_one_who_left_go_to_the_others() {
        let mut assigner = Assigner::new(6, Epoch(0));
        share(&mut assigner, &["a", "b", "c"]);
        assert_eq!(assigner.release(&id("b")), 2);
        assert!(assigner.has_orphans());
        share(&mut assigner, &["a", "c"]);
        assert_eq!(sets(&assigner, &["a", "c"]), [vec![0, 1, 2], vec![3, 4, 5]]);
        assert!(!assigner.has_orphans());
    }

    #[test]
    fn with_nobody_left_the_environments_wait() {
        let mut assigner = Assigner::new(2, Epoch(7));
        share(&mut assigner, &["a"]);
        assigner.release(&id("a"));
        assert!(share(&mut assigner, &[]).is_empty());
        assert!(assigner.has_orphans());
        assert_eq!(share(&mut assigner, &["b"])[0].epoch, Epoch(9));
    }

    #[test]
    fn renewing_moves_nothing_but_makes_older_rollouts_void() {
        let mut assigner = Assigner::new(2, Epoch(0));
        share(&mut assigner, &["a"]);
        let change = assigner.renew(&id("a")).unwrap();
        assert_eq!(change.given, [EnvId(0), EnvId(1)]);
        assert_eq!(assigner.owner(EnvId(1)).unwrap().since, change.epoch);
        assert!(assigner.renew(&id("b")).is_none());
        assert_eq!(assigner.overrule(&id("b"), Epoch(70)).epoch, Epoch(71), "though it has none");
        let change = assigner.overrule(&id("a"), Epoch(3));
        assert_eq!((change.epoch, change.given.len()), (Epoch(4), 2), "b's number is b's alone");
        assert_eq!(assigner.overrule(&id("b"), Epoch(9)).epoch, Epoch(72), "it never falls");
        assigner.release(&id("b"));
        assert_eq!(assigner.overrule(&id("b"), Epoch(9)).epoch, Epoch(10), "another start of it");
    }

    #[test]
    fn limits_hold_as_long_as_somebody_else_can_take_what_they_leave_over() {
        let mut assigner = Assigner::new(6, Epoch(0));
        let limit = |limits: &[(&str, usize)]| {
            let limits: BTreeMap<ActorId, usize> =
                limits.iter().map(|&(name, limit)| (id(name), limit)).collect();
            move |actor: &ActorId| limits.get(actor).copied().unwrap_or(usize::MAX)
        };
        let all = members(&["a", "b", "c"]);
        for (limits, expected) in [
            (&[("a", 1), ("b", 0)][..], [1, 0, 5]),
            (&[("a", 2), ("b", 0), ("c", 2)], [3, 0, 3]),
            (&[("a", 0), ("b", 0), ("c", 0)], [2, 2, 2]),
        ] {
            assigner.rebalance(&all, limit(limits));
            assert_eq!(assigner.counts(&all).into_values().collect::<Vec<_>>(), expected);
        }
    }

    #[test]
    fn environments_move_without_the_others() {
        let mut assigner = Assigner::new(4, Epoch(0));
        share(&mut assigner, &["a", "b"]);
        let moved = |env_id: u32, to: &str| (EnvId(env_id), (id(to), Incarnation(1)));
        let changes = assigner.hand_over(vec![moved(0, "b"), moved(2, "b")]);
        assert_eq!(sets(&assigner, &["a", "b"]), [vec![1], vec![0, 2, 3]]);
        let said = |change: &Reassignment| {
            let ids = |envs: &[EnvId]| envs.iter().map(|env_id| env_id.0).collect::<Vec<_>>();
            (change.actor.to_string(), ids(&change.given), ids(&change.kept))
        };
        let said: Vec<_> = changes.iter().map(said).collect();
        assert_eq!(said, [("a".into(), vec![], vec![1]), ("b".into(), vec![0, 2], vec![3])]);
        for env_id in [0, 2] {
            assert_eq!(assigner.owner(EnvId(env_id)).unwrap().since, changes[1].epoch);
        }
        assert!(assigner.owner(EnvId(3)).unwrap().since < changes[0].epoch);
    }
}
