//! The versions of the weights that an actor has, and which one it should pull.

use std::collections::BTreeMap;
use std::sync::Arc;

use leadtime_policy::Parameters;
use leadtime_proto::{Iteration, PolicyVersion, Schedule};

/// What to ask the learner for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Pull {
    /// One version that a rollout has to be acted with.
    Version(PolicyVersion),
    /// Whatever is newest.
    Newest,
}

/// Weights by version.
#[derive(Debug)]
pub(crate) struct Shelf {
    schedule: Schedule,
    announced: PolicyVersion,
    versions: BTreeMap<PolicyVersion, Arc<Parameters>>,
}

impl Shelf {
    pub(crate) fn new(schedule: Schedule, announced: PolicyVersion) -> Self {
        Self { schedule, announced, versions: BTreeMap::new() }
    }

    /// Notes the newest version that there is.
    pub(crate) fn announce(&mut self, version: PolicyVersion) {
        self.announced = self.announced.max(version);
    }

    /// Keeps a version, and of the older ones only those that a rollout may still need.
    pub(crate) fn put(&mut self, version: PolicyVersion, parameters: Parameters) {
        self.announce(version);
        self.versions.insert(version, Arc::new(parameters));
        let oldest = self.schedule.oldest_needed(self.announced);
        if let Some((&newest, _)) = self.versions.last_key_value() {
            self.versions = self.versions.split_off(&oldest.min(newest));
        }
    }

    /// Returns the version to act a rollout with, if it is here.
    pub(crate) fn get(&self, iteration: Iteration) -> Option<(PolicyVersion, Arc<Parameters>)> {
        let found = match self.schedule.behavior_version(iteration) {
            Some(version) => self.versions.get_key_value(&version),
            None => self.versions.last_key_value(),
        };
        found.map(|(&version, parameters)| (version, Arc::clone(parameters)))
    }

    /// Returns what should be pulled now, given the rollout to be acted next.
    pub(crate) fn wanted(&self, next: Option<Iteration>) -> Option<Pull> {
        let newest = self.versions.last_key_value().map(|(&version, _)| version);
        let is_behind = newest.is_none_or(|newest| newest < self.announced);
        if !self.schedule.is_deterministic() {
            return is_behind.then_some(Pull::Newest);
        }
        let required = next.and_then(|iteration| self.schedule.behavior_version(iteration));
        let missing = required.filter(|v| *v <= self.announced && !self.versions.contains_key(v));
        missing.or(is_behind.then_some(self.announced)).map(Pull::Version)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use leadtime_proto::{ActionSpec, Encoder, HeadCredit, PolicySpec};

    fn parameters() -> Parameters {
        let spec = PolicySpec {
            obs_dim: 1,
            encoder: Encoder::Identity,
            hidden: vec![2],
            actions: ActionSpec::discrete("a", 2),
            head_credit: HeadCredit::All,
            logit_bias: Vec::new(),
            normalize_observations: false,
        };
        Parameters::initialize(&spec, 1).unwrap()
    }

    fn version(shelf: &Shelf, iteration: u64) -> Option<u64> {
        shelf.get(Iteration(iteration)).map(|(version, _)| version.0)
    }

    #[test]
    fn with_a_lag_the_older_version_is_pulled_first_and_kept_as_long_as_it_may_be_needed() {
        let mut shelf = Shelf::new(Schedule::Lag(1), PolicyVersion(5));
        assert_eq!(shelf.wanted(Some(Iteration(5))), Some(Pull::Version(PolicyVersion(4))));
        shelf.put(PolicyVersion(4), parameters());
        assert_eq!(shelf.wanted(Some(Iteration(5))), Some(Pull::Version(PolicyVersion(5))));
        shelf.put(PolicyVersion(5), parameters());
        assert_eq!((version(&shelf, 5), version(&shelf, 6)), (Some(4), Some(5)));
        assert_eq!(shelf.wanted(Some(Iteration(7))), None, "version 6 is not there yet");
        shelf.put(PolicyVersion(6), parameters());
        assert_eq!(version(&shelf, 5), None);
    }

    #[test]
    fn async_acts_with_the_newest_it_has() {
        let mut shelf = Shelf::new(Schedule::Async { staleness_max: 8 }, PolicyVersion(0));
        assert_eq!(shelf.wanted(None), Some(Pull::Newest));
        shelf.put(PolicyVersion(0), parameters());
        shelf.announce(PolicyVersion(3));
        assert_eq!(version(&shelf, 9), Some(0));
        assert_eq!(shelf.wanted(Some(Iteration(9))), Some(Pull::Newest));
        shelf.put(PolicyVersion(3), parameters());
        assert_eq!(shelf.wanted(Some(Iteration(9))), None);
    }
}
