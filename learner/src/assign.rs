//! Who steps which environment, and since which epoch.
//!
//! Environments move only when actors come, go or misbehave, as few as possible, and the result depends on
//! nothing but the members and what they had: first everyone keeps their lowest environments up to a fair share,
//! then what is free goes, in ascending order, to those with room. A first assignment is therefore contiguous.
//!
//! A rollout counts only if its epoch is not older than its sender's ownership ([`Ownership::since`]), so one
//! that was under way when its environment moved cannot be mistaken for one that was made after it came back.

use std::collections::BTreeMap;

use leadtime_proto::{ActorId, EnvId, Epoch, Incarnation};

/// Who steps an environment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ownership {
    /// The actor.
    pub actor: ActorId,
    /// Its start.
    pub incarnation: Incarnation,
    /// The assignment that gave it the environment.
    pub since: Epoch,
}

/// What one actor must be told.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Change {
    /// The actor.
    pub actor: ActorId,
    /// The assignment's number.
    pub epoch: Epoch,
    /// Environments that it gets.
    pub given: Vec<EnvId>,
    /// Environments that it goes on with undisturbed.
    pub kept: Vec<EnvId>,
}

/// The present assignment.
#[derive(Clone, Debug)]
pub struct Assigner {
    epoch: Epoch,
    owners: Vec<Option<Ownership>>,
}

impl Assigner {
    /// Starts with nobody, after the epochs that a checkpoint knows of.
    pub fn new(n_envs: usize, epoch: Epoch) -> Self {
        Self { epoch, owners: vec![None; n_envs] }
    }

    /// Returns the newest epoch.
    pub fn epoch(&self) -> Epoch {
        self.epoch
    }

    /// Opens the next epoch.
    pub fn next_epoch(&mut self) -> Epoch {
        self.epoch = self.epoch.next();
        self.epoch
    }

    /// Returns the owner of an environment; `None` also for one that the run does not have.
    pub fn owner(&self, env_id: EnvId) -> Option<&Ownership> {
        self.owners.get(env_id.0 as usize)?.as_ref()
    }

    /// Tells whether an environment waits for an actor.
    pub fn has_orphans(&self) -> bool {
        self.owners.iter().any(Option::is_none)
    }

    /// Takes everything from an actor and returns how many environments that was.
    pub fn release(&mut self, actor: &ActorId) -> usize {
        let mut n_released = 0;
        for slot in &mut self.owners {
            if slot.as_ref().is_some_and(|owner| owner.actor == *actor) {
                *slot = None;
                n_released += 1;
            }
        }
        n_released
    }

    /// Gives an actor its own environments again, from their newest snapshots, under a new epoch.
    pub fn renew(&mut self, actor: &ActorId) -> Option<Change> {
        let given = self.held(actor);
        if given.is_empty() {
            return None;
        }
        let epoch = self.next_epoch();
        for env_id in &given {
            if let Some(owner) = &mut self.owners[env_id.0 as usize] {
                owner.since = epoch;
            }
        }
        Some(Change { actor: actor.clone(), epoch, given, kept: Vec::new() })
    }

    /// Shares the environments among the members and returns what has to be said to whom.
    pub fn rebalance(&mut self, members: &BTreeMap<ActorId, Incarnation>) -> Vec<Change> {
        if members.is_empty() {
            return Vec::new();
        }
        let quotas = self.quotas(members);
        let mut dropped: BTreeMap<&ActorId, bool> = BTreeMap::new();
        for (actor, &quota) in &quotas {
            let held = self.held(actor);
            for env_id in held.iter().skip(quota) {
                self.owners[env_id.0 as usize] = None;
            }
            dropped.insert(actor, held.len() > quota);
        }
        let mut changes = Vec::new();
        for (actor, &quota) in &quotas {
            let kept = self.held(actor);
            let free = self.free();
            let given: Vec<EnvId> = free.into_iter().take(quota - kept.len()).collect();
            if given.is_empty() && !dropped[actor] {
                continue;
            }
            let epoch = self.next_epoch();
            for env_id in &given {
                let owner =
                    Ownership { actor: actor.clone(), incarnation: members[actor], since: epoch };
                self.owners[env_id.0 as usize] = Some(owner);
            }
            changes.push(Change { actor: actor.clone(), epoch, given, kept });
        }
        changes
    }

    /// Fair shares that differ by at most one; the larger ones go to those who hold most.
    fn quotas(&self, members: &BTreeMap<ActorId, Incarnation>) -> BTreeMap<ActorId, usize> {
        let (share, extra) = (self.owners.len() / members.len(), self.owners.len() % members.len());
        let mut order: Vec<&ActorId> = members.keys().collect();
        order.sort_by_key(|actor| std::cmp::Reverse(self.held(actor).len()));
        let quota =
            |(rank, actor): (usize, &ActorId)| (actor.clone(), share + usize::from(rank < extra));
        order.into_iter().enumerate().map(quota).collect()
    }

    fn held(&self, actor: &ActorId) -> Vec<EnvId> {
        self.env_ids(|owner| owner.is_some_and(|owner| owner.actor == *actor))
    }

    fn free(&self) -> Vec<EnvId> {
        self.env_ids(|owner| owner.is_none())
    }

    fn env_ids(&self, wanted: impl Fn(Option<&Ownership>) -> bool) -> Vec<EnvId> {
        (0_u32..)
            .zip(&self.owners)
            .filter(|(_, owner)| wanted(owner.as_ref()))
            .map(|(id, _)| EnvId(id))
            .collect()
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
        names
            .iter()
            .map(|name| assigner.held(&id(name)).iter().map(|env| env.0).collect())
            .collect()
    }

    #[test]
    fn a_first_assignment_is_contiguous_and_balanced() {
        let mut assigner = Assigner::new(5, Epoch(0));
        let changes = assigner.rebalance(&members(&["a", "b"]));
        assert_eq!(sets(&assigner, &["a", "b"]), [vec![0, 1, 2], vec![3, 4]]);
        assert_eq!(changes.len(), 2);
        assert!(changes.iter().all(|change| change.kept.is_empty()));
    }

    #[test]
    fn a_joiner_gets_its_share_and_the_others_keep_theirs() {
        let mut assigner = Assigner::new(4, Epoch(0));
        assigner.rebalance(&members(&["a"]));
        let changes = assigner.rebalance(&members(&["a", "b"]));
        assert_eq!(sets(&assigner, &["a", "b"]), [vec![0, 1], vec![2, 3]]);
        let (a, b) = (&changes[0], &changes[1]);
        assert_eq!((a.given.len(), a.kept.len()), (0, 2));
        assert_eq!((b.given.len(), b.kept.len()), (2, 0));
        assert_eq!(assigner.owner(EnvId(0)).unwrap().since, Epoch(1), "kept: its ownership is old");
        assert_eq!(assigner.owner(EnvId(2)).unwrap().since, b.epoch);
    }

    #[test]
    fn who_is_not_touched_hears_nothing() {
        let mut assigner = Assigner::new(4, Epoch(0));
        assigner.rebalance(&members(&["a", "b"]));
        assert!(assigner.rebalance(&members(&["a", "b"])).is_empty());
    }

    #[test]
    fn the_envs_of_one_who_left_go_to_the_others() {
        let mut assigner = Assigner::new(6, Epoch(0));
        assigner.rebalance(&members(&["a", "b", "c"]));
        assert_eq!(assigner.release(&id("b")), 2);
        assert!(assigner.has_orphans());
        assigner.rebalance(&members(&["a", "c"]));
        assert_eq!(sets(&assigner, &["a", "c"]), [vec![0, 1, 2], vec![3, 4, 5]]);
        assert!(!assigner.has_orphans());
    }

    #[test]
    fn with_nobody_left_the_environments_wait() {
        let mut assigner = Assigner::new(2, Epoch(7));
        assigner.rebalance(&members(&["a"]));
        assigner.release(&id("a"));
        assert!(assigner.rebalance(&members(&[])).is_empty());
        assert!(assigner.has_orphans());
        assert_eq!(assigner.rebalance(&members(&["b"]))[0].epoch, Epoch(9));
    }

    #[test]
    fn renewing_moves_nothing_but_makes_older_rollouts_void() {
        let mut assigner = Assigner::new(2, Epoch(0));
        assigner.rebalance(&members(&["a"]));
        let change = assigner.renew(&id("a")).unwrap();
        assert_eq!(change.given, [EnvId(0), EnvId(1)]);
        assert_eq!(assigner.owner(EnvId(1)).unwrap().since, change.epoch);
        assert!(assigner.renew(&id("b")).is_none());
    }

    #[test]
    fn more_actors_than_environments_leave_some_idle() {
        let mut assigner = Assigner::new(1, Epoch(0));
        let changes = assigner.rebalance(&members(&["a", "b", "c"]));
        assert_eq!(changes.len(), 1);
        assert!(!assigner.has_orphans());
    }
}
