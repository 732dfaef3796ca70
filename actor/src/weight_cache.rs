//! The versions of the weights that an actor has, and which ones it should pull.

use std::collections::BTreeMap;

use leadtime_proto::message::Announcement;
use leadtime_proto::{Iteration, PolicyVersion, Schedule};

/// Weights by version, beside the digests of those that the learner announced.
#[derive(Debug)]
pub(crate) struct WeightCache<W> {
    schedule: Schedule,
    announced: BTreeMap<PolicyVersion, [u8; 32]>,
    versions: BTreeMap<PolicyVersion, W>,
}

impl<W: Clone> WeightCache<W> {
    /// Starts without weights, under a learner that offers these.
    pub(crate) fn new(schedule: Schedule, news: &Announcement) -> Self {
        let announced = news.versions.iter().copied().collect();
        Self { schedule, announced, versions: BTreeMap::new() }
    }

    /// Returns the newest version that is here.
    pub(crate) fn newest_kept(&self) -> Option<PolicyVersion> {
        self.versions.last_key_value().map(|(&version, _)| version)
    }

    /// Notes which versions there are. Older news than the last are late and ignored.
    pub(crate) fn announce(&mut self, news: &Announcement) {
        if news.newest() >= self.newest_announced() {
            self.announced = news.versions.iter().copied().collect();
        }
    }

    /// Notes that a version could not be pulled for the rollout to be acted next. Returns whether this proves that its
    /// environment went on elsewhere: the learner neither announces nor keeps what it needs.
    pub(crate) fn failed(
        &mut self,
        version: PolicyVersion,
        not_kept: bool,
        next: Option<Iteration>,
    ) -> bool {
        let is_announced = self.announced.contains_key(&version);
        if not_kept && is_announced {
            // Newer versions are not believed either until they are announced again: otherwise one false
            // announcement of a distant version would hide all true ones.
            self.announced.split_off(&version);
        } else if !not_kept && !is_announced {
            // News that leave out a version which is kept are false.
            self.announced.clear();
        }
        not_kept && !is_announced && self.required(next) == Some(version)
    }

    /// Keeps a version, and of the older ones only those that a rollout may still need.
    pub(crate) fn put(&mut self, version: PolicyVersion, weights: W) {
        self.versions.insert(version, weights);
        let oldest = self.schedule.oldest_needed(self.newest_announced().max(version));
        if let Some((&newest, _)) = self.versions.last_key_value() {
            self.versions = self.versions.split_off(&oldest.min(newest));
        }
    }

    /// Returns the version to act a rollout with, if it is here.
    pub(crate) fn get(&self, iteration: Iteration) -> Option<(PolicyVersion, W)> {
        let found = match self.schedule.behavior_version(iteration) {
            Some(version) => self.versions.get_key_value(&version),
            None => self.versions.last_key_value(),
        };
        found.map(|(&version, weights)| (version, weights.clone()))
    }

    /// Returns what should be pulled next, given the rollout to be acted next and what is being pulled already, and the digest
    /// that it must have: what that rollout needs, and then what the rollouts after it will need. So over a slow line a
    /// version is on its way long before it is needed.
    ///
    /// A version that is needed but no longer announced is asked for all the same ([`Self::failed`] takes the answer): an
    /// announcement alone is no proof, because anyone can send one.
    pub(crate) fn wanted(
        &self,
        next: Option<Iteration>,
        is_coming: impl Fn(PolicyVersion) -> bool,
    ) -> Option<(PolicyVersion, [u8; 32])> {
        let is_missing =
            |version: PolicyVersion| !self.versions.contains_key(&version) && !is_coming(version);
        let required = self.required(next);
        if let Some(required) = required {
            let oldest = self.announced.first_key_value();
            let is_past = oldest.is_some_and(|(oldest, _)| required < *oldest);
            let announced = self.announced.get(&required).copied();
            let sha256 = announced.or(is_past.then_some([0; 32]));
            if let Some(sha256) = sha256.filter(|_| is_missing(required)) {
                return Some((required, sha256));
            }
            let mut later = self.announced.range(required..).skip_while(|(it, _)| **it == required);
            let later = later.find(|(version, _)| is_missing(**version));
            return later.map(|(&version, &sha256)| (version, sha256));
        }
        let newest_here = self.versions.last_key_value().map(|(version, _)| version);
        let newest = self.announced.last_key_value();
        let ahead = newest.filter(|(version, _)| newest_here.is_none_or(|here| here < *version));
        let ahead = ahead.filter(|(version, _)| is_missing(**version));
        ahead.map(|(&version, &sha256)| (version, sha256))
    }

    fn required(&self, next: Option<Iteration>) -> Option<PolicyVersion> {
        next.and_then(|iteration| self.schedule.behavior_version(iteration))
    }

    fn newest_announced(&self) -> PolicyVersion {
        self.announced.last_key_value().map_or(PolicyVersion(0), |(&version, _)| version)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use leadtime_proto::Incarnation;

    fn news(versions: std::ops::RangeInclusive<u64>) -> Announcement {
        let versions = versions.map(|version| (PolicyVersion(version), [version as u8; 32]));
        Announcement { learner: Incarnation(1), versions: versions.collect() }
    }

    fn version(cache: &WeightCache<()>, iteration: u64) -> Option<u64> {
        cache.get(Iteration(iteration)).map(|(version, ())| version.0)
    }

    fn wanted(cache: &WeightCache<()>, next: Option<u64>) -> Option<u64> {
        let (version, sha256) = cache.wanted(next.map(Iteration), |_| false)?;
        let is_announced = cache.announced.contains_key(&version);
        assert_eq!(sha256, [version.0 as u8 * u8::from(is_announced); 32]);
        Some(version.0)
    }

    #[test]
    fn with_a_lag_the_older_version_is_pulled_first_and_kept_as_long_as_it_may_be_needed() {
        let mut cache = WeightCache::new(Schedule::Lag(1), &news(4..=5));
        assert_eq!(wanted(&cache, Some(5)), Some(4));
        cache.put(PolicyVersion(4), ());
        assert_eq!(wanted(&cache, Some(5)), Some(5));
        cache.put(PolicyVersion(5), ());
        assert_eq!((version(&cache, 5), version(&cache, 6)), (Some(4), Some(5)));
        assert_eq!(wanted(&cache, Some(7)), None, "version 6 is not there yet");
        cache.put(PolicyVersion(6), ());
        assert_eq!(version(&cache, 5), None);
    }

    #[test]
    fn the_next_version_is_pulled_while_the_one_needed_now_is_on_its_way() {
        let cache: WeightCache<()> = WeightCache::new(Schedule::Lag(3), &news(4..=8));
        let mut coming = Vec::new();
        while let Some((version, _)) =
            cache.wanted(Some(Iteration(9)), |version| coming.contains(&version.0))
        {
            coming.push(version.0);
        }
        assert_eq!(coming, [6, 7, 8], "the rollout of iteration 9 needs version 6");
    }

    #[test]
    fn async_acts_with_the_newest_it_has() {
        let mut cache = WeightCache::new(Schedule::Async { staleness_max: 8 }, &news(0..=0));
        assert_eq!(wanted(&cache, None), Some(0));
        cache.put(PolicyVersion(0), ());
        cache.announce(&news(1..=3));
        assert_eq!(version(&cache, 9), Some(0));
        assert_eq!(wanted(&cache, Some(9)), Some(3));
        cache.put(PolicyVersion(3), ());
        assert_eq!(wanted(&cache, Some(9)), None);
    }

    #[test]
    fn a_false_announcement_is_forgotten_when_its_version_cannot_be_pulled() {
        let mut cache = WeightCache::new(Schedule::Lag(0), &news(3..=4));
        cache.put(PolicyVersion(4), ());
        cache.announce(&news(4..=200));
        assert_eq!(wanted(&cache, Some(4)), Some(5));
        cache.announce(&news(4..=5));
        let third = cache.wanted(Some(Iteration(4)), |version| version.0 < 7);
        assert_eq!(third.unwrap().0, PolicyVersion(7), "true news are older, and not heard");
        assert!(!cache.failed(PolicyVersion(7), true, Some(Iteration(4))));
        assert_eq!(wanted(&cache, Some(5)), Some(5), "and what is left of the false ones is tried");
        assert!(!cache.failed(PolicyVersion(5), false, Some(Iteration(5))));
        // News that leave out what is needed are no proof that it is gone: it is asked for.
        cache.announce(&news(220..=230));
        assert_eq!(wanted(&cache, Some(5)), Some(5));
        assert!(!cache.failed(PolicyVersion(5), false, Some(Iteration(5))));
        cache.announce(&news(4..=5));
        assert_eq!(wanted(&cache, Some(5)), Some(5));
    }

    #[test]
    fn an_actor_that_needs_a_version_neither_announced_nor_kept_is_behind() {
        let mut cache = WeightCache::new(Schedule::Lag(1), &news(4..=5));
        assert_eq!(wanted(&cache, Some(4)), Some(3));
        assert!(cache.failed(PolicyVersion(3), true, Some(Iteration(4))));
        assert_eq!(wanted(&cache, Some(5)), Some(4));
        cache.announce(&news(5..=6));
        assert!(!cache.failed(PolicyVersion(4), true, Some(Iteration(9))), "not what comes next");
    }
}
