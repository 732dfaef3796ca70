//! Which of a run's policies is the best, by episodes that training never sees.
//!
//! At versions that are spread evenly over the run, the last one included, the policy plays held-out episodes: the same ones
//! every time, so that two policies are compared episode by episode.
//!
//! # The rule
//!
//! The best policy is the newest that was evaluated, unless the highest rated one was better by more than
//! [`ERRORS_AHEAD`] standard errors of the difference. So noise between equally good policies does not choose an old one,
//! and a policy that training has spoilt is not chosen.
//!
//! Everything here is a function of weights, versions and episodes, never of time: a run that was killed and resumed has the
//! same best policy as an undisturbed one.

use std::collections::VecDeque;

use leadtime_ppo::checkpoints::MAX_WAITING;
use leadtime_proto::PolicyVersion;
use serde::{Deserialize, Serialize};

use crate::episodes::EpisodeMeans;
use crate::held_out::{HeldOutEpisode, HeldOutMeans, lead, means, score};
use crate::report::RatedPolicy;

/// The largest share of the run's steps that all evaluations play together.
const SHARE_OF_STEPS: f64 = 0.03;
/// Episodes of an evaluation even where they are more than that share.
const FEWEST_EPISODES: u64 = 20;
/// By how many standard errors of the difference an earlier policy must be ahead to be chosen. More than 1: being ahead in a
/// single episode is exactly one error.
const ERRORS_AHEAD: f64 = 1.1;

/// Which versions are evaluated, and on how many episodes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EvaluationPlan {
    pub(crate) n_evaluations: u64,
    pub(crate) max_episodes: u64,
    /// The mean score at which the run ends.
    pub(crate) stop_at: Option<f64>,
    /// What decides the episodes.
    pub(crate) episodes: [u8; 32],
    /// Updates of the whole run.
    pub(crate) n_updates: u64,
    /// Steps of the whole run.
    pub(crate) n_steps: u64,
}

impl EvaluationPlan {
    /// Returns whether a version is evaluated: they are spread evenly over the run, and the last one is among them.
    pub(crate) fn is_due(&self, version: PolicyVersion) -> bool {
        let n_passed = |version: u64| {
            u128::from(version) * u128::from(self.n_evaluations) / u128::from(self.n_updates.max(1))
        };
        version.0 > 0 && n_passed(version.0) > n_passed(version.0 - 1)
    }

    /// Returns how many policies may wait: where one of them can be the last, nothing is trained after it before that is known.
    fn max_waiting(&self) -> usize {
        if self.stop_at.is_some() { 1 } else { MAX_WAITING }
    }

    /// Returns how many episodes an evaluation has that follows these training episodes.
    fn n_episodes(&self, training: &EpisodeMeans) -> u64 {
        let Some(length) = training.length else { return FEWEST_EPISODES.min(self.max_episodes) };
        let n_steps = SHARE_OF_STEPS * self.n_steps as f64 / self.n_evaluations as f64;
        let affordable = (n_steps / length.max(1.0)) as u64;
        affordable.max(FEWEST_EPISODES).min(self.max_episodes)
    }
}

/// A policy that waits to be evaluated.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct WaitingPolicy {
    pub(crate) policy: RatedPolicy,
    pub(crate) n_episodes: u64,
}

/// An evaluated policy with its score in every episode.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct ScoredPolicy {
    policy: RatedPolicy,
    scores: Vec<f32>,
}

/// The evaluations of a run so far, and what they say.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct HeldOutRecord {
    waiting: VecDeque<WaitingPolicy>,
    /// What decided the episodes of all that follows.
    episodes: [u8; 32],
    history: Vec<HeldOutMeans>,
    /// The highest rated policy; of equals the newest.
    highest: Option<ScoredPolicy>,
    /// The newest one, where that is another.
    newest: Option<ScoredPolicy>,
}

impl HeldOutRecord {
    /// Queues a policy; there must be room.
    pub(crate) fn queue(
        &mut self,
        plan: &EvaluationPlan,
        policy: RatedPolicy,
        training: &EpisodeMeans,
    ) {
        self.keep_comparable(plan);
        self.waiting.push_back(WaitingPolicy { policy, n_episodes: plan.n_episodes(training) });
    }

    /// Forgets results on other episodes than the plan's: a resumed run may be evaluated in another world.
    fn keep_comparable(&mut self, plan: &EvaluationPlan) {
        if self.episodes != plan.episodes {
            let waiting = std::mem::take(&mut self.waiting);
            *self = Self { waiting, episodes: plan.episodes, ..Self::default() };
        }
    }

    /// Returns whether as many policies wait as may.
    pub(crate) fn is_full(&self, plan: &EvaluationPlan) -> bool {
        self.waiting.len() >= plan.max_waiting()
    }

    /// Returns how the newest policy did, if it is as good as the plan asks for: the run ends with it. An earlier one that was
    /// as good counts no more: it was not asked for then.
    pub(crate) fn reached(
        &self,
        plan: &EvaluationPlan,
        newest: PolicyVersion,
    ) -> Option<HeldOutMeans> {
        let mark = plan.stop_at.filter(|_| self.episodes == plan.episodes)?;
        self.of(newest).filter(|means| means.score() >= mark)
    }

    /// Returns the policy to be evaluated next.
    pub(crate) fn next(&self) -> Option<&WaitingPolicy> {
        self.waiting.front()
    }

    /// Takes in what the policy that was next did in the plan's episodes; without episodes it is passed over.
    pub(crate) fn take_in(&mut self, plan: &EvaluationPlan, episodes: &[HeldOutEpisode]) {
        // It may have been queued under another plan, before the run was resumed.
        self.keep_comparable(plan);
        let Some(WaitingPolicy { mut policy, .. }) = self.waiting.pop_front() else { return };
        let Some(found) = means(policy.version, episodes) else { return };
        self.history.push(found);
        policy.held_out = Some(found);
        let scores = episodes.iter().map(|episode| score(episode) as f32).collect();
        let scored = ScoredPolicy { policy, scores };
        // The highest one, or a newer one that is behind it.
        let is_behind = self.highest.as_ref().is_some_and(|highest| {
            lead(&highest.scores, &scored.scores).is_some_and(|lead| lead.mean > 0.0)
        });
        if is_behind {
            self.newest = Some(scored);
        } else {
            (self.highest, self.newest) = (Some(scored), None);
        }
    }

    /// Returns the best policy by the rule at the head of this file; `None` before the first evaluation.
    pub(crate) fn best(&self) -> Option<&RatedPolicy> {
        let highest = self.highest.as_ref()?;
        let Some(newest) = &self.newest else { return Some(&highest.policy) };
        let lead = lead(&highest.scores, &newest.scores);
        let is_ahead = lead.is_some_and(|lead| lead.mean > ERRORS_AHEAD * lead.error);
        Some(if is_ahead { &highest.policy } else { &newest.policy })
    }

    /// Returns how a version did, if it was evaluated.
    pub(crate) fn of(&self, version: PolicyVersion) -> Option<HeldOutMeans> {
        self.history.iter().rev().find(|means| means.version == version).copied()
    }

    /// Returns every evaluation, the oldest first.
    pub(crate) fn history(&self) -> &[HeldOutMeans] {
        &self.history
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAN: EvaluationPlan = EvaluationPlan {
        n_evaluations: 8,
        max_episodes: 200,
        stop_at: None,
        episodes: [1; 32],
        n_updates: 781,
        n_steps: 1_600_000,
    };

    fn episodes(successes: &[u8]) -> Vec<HeldOutEpisode> {
        let episode = |&success: &u8| HeldOutEpisode {
            total_reward: 10.0 * f64::from(success),
            length: 5,
            success: Some(success.into()),
        };
        successes.iter().map(episode).collect()
    }

    /// Ten in which so many succeed, the last ones first.
    fn ten(n_successes: usize) -> Vec<HeldOutEpisode> {
        episodes(&std::array::from_fn::<u8, 10, _>(|i| u8::from(i >= 10 - n_successes)))
    }

    fn rated(all: &[Vec<HeldOutEpisode>]) -> HeldOutRecord {
        let mut record = HeldOutRecord::default();
        for (version, played) in (1..).zip(all) {
            record.queue(&PLAN, policy(version), &EpisodeMeans::default());
            record.take_in(&PLAN, played);
        }
        record
    }

    fn policy(version: u64) -> RatedPolicy {
        let weights = vec![version as u8].into();
        RatedPolicy { version: PolicyVersion(version), score: None, held_out: None, weights }
    }

    #[test]
    fn policies_of_other_episodes_are_not_compared() {
        let mut record = rated(&[ten(9)]);
        let other = EvaluationPlan { episodes: [2; 32], ..PLAN };
        record.queue(&other, policy(2), &EpisodeMeans::default());
        assert_eq!((record.best().is_none(), record.history().len()), (true, 0));
        record.take_in(&other, &ten(3));
        assert_eq!(record.best().unwrap().version, PolicyVersion(2));
    }

    #[test]
    fn a_policy_that_waited_while_the_episodes_changed_is_compared_with_later_ones_only() {
        let mut record = rated(&[ten(9)]);
        record.queue(&PLAN, policy(2), &EpisodeMeans::default());
        let other = EvaluationPlan { episodes: [2; 32], ..PLAN };
        record.take_in(&other, &ten(3));
        let found = |record: &HeldOutRecord| {
            (record.best().unwrap().version, record.history().len(), record.next().is_some())
        };
        assert_eq!(found(&record), (PolicyVersion(2), 1, false));
        record.queue(&other, policy(3), &EpisodeMeans::default());
        assert_eq!(found(&record), (PolicyVersion(2), 1, true), "its result is one of the plan's");
    }

    fn best(all: &[Vec<HeldOutEpisode>]) -> u64 {
        rated(all).best().unwrap().version.0
    }

    #[test]
    fn a_run_ends_with_the_first_policy_that_is_good_enough() {
        let plan = EvaluationPlan { stop_at: Some(0.8), ..PLAN };
        let record = rated(&[ten(7), ten(8), ten(9)]);
        let reached = |plan: &EvaluationPlan, version: u64| {
            record.reached(plan, PolicyVersion(version)).map(|means| means.success)
        };
        assert_eq!((reached(&plan, 1), reached(&plan, 2)), (None, Some(Some(0.8))));
        assert_eq!((reached(&PLAN, 2), reached(&plan, 4)), (None, None), "nobody asked; unknown");
        let other = EvaluationPlan { episodes: [2; 32], ..plan };
        assert_eq!(reached(&other, 2), None, "in other episodes");
        let waiting = record.next().is_some();
        assert!(!waiting && !record.is_full(&plan));
    }

    #[test]
    fn nothing_is_trained_after_a_policy_that_may_be_the_last() {
        let plan = EvaluationPlan { stop_at: Some(0.8), ..PLAN };
        let mut record = HeldOutRecord::default();
        for (version, full) in [(1, [false, true]), (2, [true, true])] {
            let (version, score) = (PolicyVersion(version), None);
            let policy = RatedPolicy { version, score, held_out: None, weights: vec![].into() };
            record.queue(&plan, policy, &EpisodeMeans::default());
            assert_eq!([record.is_full(&PLAN), record.is_full(&plan)], full);
        }
    }

    #[test]
    fn versions_are_spread_evenly_and_the_last_one_is_among_them() {
        let due = |plan: EvaluationPlan| -> Vec<u64> {
            (0..=plan.n_updates).filter(|&version| plan.is_due(PolicyVersion(version))).collect()
        };
        assert_eq!(due(PLAN), [98, 196, 293, 391, 489, 586, 684, 781]);
        assert_eq!(due(EvaluationPlan { n_updates: 3, ..PLAN }), [1, 2, 3]);
        assert_eq!(due(EvaluationPlan { n_evaluations: 1, ..PLAN }), [781]);
    }

    #[test]
    fn an_evaluation_takes_a_small_share_of_the_runs_steps() {
        let n_episodes = |length: Option<f64>, plan: EvaluationPlan| {
            plan.n_episodes(&EpisodeMeans { length, ..EpisodeMeans::default() })
        };
        assert_eq!(n_episodes(Some(100.0), PLAN), 60);
        assert_eq!(n_episodes(Some(1.0), PLAN), 200);
        assert_eq!(n_episodes(Some(500.0), PLAN), 20);
        assert_eq!(n_episodes(None, PLAN), 20);
        assert_eq!(n_episodes(None, EvaluationPlan { max_episodes: 4, ..PLAN }), 4);
    }

    #[test]
    fn the_newest_policy_is_the_best_unless_an_earlier_one_was_clearly_better() {
        assert_eq!(best(&[ten(5), ten(8), ten(8)]), 3, "equals");
        // One episode of ten: the standard error of the difference is as large as the difference.
        assert_eq!(best(&[ten(5), ten(9), ten(8)]), 3, "within the error");
        assert_eq!(best(&[ten(5), ten(9), ten(4)]), 2, "training has spoilt it");
        assert_eq!(best(&[ten(5), ten(9), ten(4), ten(9)]), 4, "and mended it");
        // Each is within the error of the one before, and far from the highest.
        assert_eq!(best(&[ten(9), ten(8), ten(7), ten(6)]), 1, "a slow decline");
        assert!(HeldOutRecord::default().best().is_none());
    }

    #[test]
    fn a_policy_whose_evaluation_failed_is_passed_over() {
        let record = rated(&[ten(5), Vec::new()]);
        assert_eq!((record.best().unwrap().version, record.history().len()), (PolicyVersion(1), 1));
        assert!(record.next().is_none());
    }
}
