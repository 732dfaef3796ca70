//! Who waits for whom: how far acting may run ahead of learning.
//!
//! | schedule | rollout `r` of an environment is acted by | update `i` trains on | same seed, same bits |
//! |---|---|---|---|
//! | `Lag(0)`, called *sync* | version `r` | iteration `i` of every environment | yes |
//! | `Lag(k)` | version `max(0, r - k)` | iteration `i` of every environment | yes |
//! | `Async` | the newest version the actor has | the first rollouts to arrive | no |

use serde::{Deserialize, Serialize};

use crate::{Iteration, PolicyVersion};

/// The order between acting and learning.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Schedule {
    /// Deterministic: acting runs at most this many updates ahead of learning; 0 is *sync*.
    Lag(u64),
    /// Elastic: train on what arrives; rollouts staler than `staleness_max` versions are dropped.
    Async {
        /// The largest staleness, in versions, at which a rollout is still used.
        staleness_max: u64,
    },
}

impl Schedule {
    /// Returns the version that must act an environment's rollout, or `None` where any will do.
    pub fn behavior_version(self, iteration: Iteration) -> Option<PolicyVersion> {
        match self {
            Self::Lag(lag) => Some(PolicyVersion(iteration.0.saturating_sub(lag))),
            Self::Async { .. } => None,
        }
    }

    /// Returns the oldest version that an actor may still ask for when the learner is at `current`.
    pub fn oldest_needed(self, current: PolicyVersion) -> PolicyVersion {
        match self {
            Self::Lag(lag) => PolicyVersion(current.0.saturating_sub(lag)),
            Self::Async { .. } => current,
        }
    }

    /// Returns whether equal seeds give equal weights, whatever the number and timing of actors.
    pub fn is_deterministic(self) -> bool {
        matches!(self, Self::Lag(_))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lag_one_acts_two_rollouts_with_the_first_version() {
        let schedule = Schedule::Lag(1);
        let versions: Vec<u64> =
            (0..4).map(|r| schedule.behavior_version(Iteration(r)).unwrap().0).collect();
        assert_eq!(versions, [0, 0, 1, 2]);
        assert_eq!(schedule.oldest_needed(PolicyVersion(5)), PolicyVersion(4));
    }
}
