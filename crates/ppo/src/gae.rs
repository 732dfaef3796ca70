//! Generalised advantage estimation: how much better an action was than the critic expected.
//!
//! [`TrajectorySegment`] is also what [`crate::vtrace`] reads.

/// Where an episode ends inside a rollout.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Cut {
    /// The episode's last step.
    pub(crate) step: usize,
    /// The value that stands for what would have come: 0 at a true end.
    pub(crate) bootstrap: f32,
}

/// Consecutive steps of one environment, over which advantages are computed.
///
/// # Shapes
///
/// T steps; `rewards` and `values`: `[T]`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TrajectorySegment<'a> {
    /// Rewards as the critic sees them (scaled, normalised).
    pub(crate) rewards: &'a [f32],
    /// Values of the observations acted on.
    pub(crate) values: &'a [f32],
    /// Value of the observation after the last step.
    pub(crate) next_value: f32,
    /// Episode ends in the order of their steps.
    pub(crate) cuts: &'a [Cut],
}

impl TrajectorySegment<'_> {
    /// Visits the steps from the last to the first with the value of what follows and whether the episode goes on.
    pub(crate) fn backwards(&self, mut visit: impl FnMut(usize, f32, bool)) {
        let mut cuts = self.cuts.iter().rev().peekable();
        let mut following = self.next_value;
        for step in (0..self.rewards.len()).rev() {
            match cuts.next_if(|cut| cut.step == step) {
                Some(cut) => visit(step, cut.bootstrap, false),
                None => visit(step, following, true),
            }
            following = self.values[step];
        }
    }
}

/// Computes advantages; the returns are advantages plus values.
///
/// `δ_t = r_t + γ V(s_{t+1}) - V(s_t)`, `A_t = δ_t + γ λ A_{t+1}`, where an episode's end cuts the second sum and
/// replaces `V(s_{t+1})` by the cut's bootstrap.
///
/// # Shapes
///
/// `advantages`: `[T]`.
///
/// # Units
///
/// `gamma` and `lambda` are factors per step, 0 to 1; rewards, values and advantages share one unit.
///
/// # Source
///
/// Schulman et al., *High-dimensional continuous control using generalized advantage estimation*, ICLR 2016,
/// equation 16.
pub(crate) fn gae(
    segment: &TrajectorySegment<'_>,
    gamma: f32,
    lambda: f32,
    advantages: &mut [f32],
) {
    assert_eq!(segment.rewards.len(), segment.values.len(), "`values` must be [T]");
    assert_eq!(segment.rewards.len(), advantages.len(), "`advantages` must be [T]");
    let mut later = 0.0;
    segment.backwards(|step, following, goes_on| {
        let delta = segment.rewards[step] + gamma * following - segment.values[step];
        later = if goes_on { delta + gamma * lambda * later } else { delta };
        advantages[step] = later;
    });
}

#[cfg(test)]
#[expect(clippy::unreadable_literal, reason = "golden numbers are as the script writes them")]
mod tests {
    use super::*;
    include!("../golden/gae.rs");

    #[test]
    fn advantages_equal_cleanrls() {
        // crates/ppo/golden/golden.py, `gae`: CleanRL's loop (ppo.py) in numpy, float32. Dones after steps 2 and 5.
        let cuts = [Cut { step: 2, bootstrap: 0.0 }, Cut { step: 5, bootstrap: 0.0 }];
        let (rewards, values, next_value) = (&REWARDS, &VALUES, NEXT_VALUE);
        let segment = TrajectorySegment { rewards, values, next_value, cuts: &cuts };
        let mut advantages = [f32::NAN; 8];
        gae(&segment, 0.99, 0.95, &mut advantages);
        for (i, (a, b)) in advantages.iter().zip(&ADVANTAGES).enumerate() {
            assert!((a - b).abs() < 1e-6, "{i}: {a} {b}");
        }
    }

    #[test]
    fn a_time_limit_bootstraps_and_a_true_end_does_not() {
        let run = |bootstrap| {
            let cuts = [Cut { step: 0, bootstrap }];
            let (rewards, values) = (&[1.0, 1.0], &[0.0, 0.0]);
            let segment = TrajectorySegment { rewards, values, next_value: 8.0, cuts: &cuts };
            let mut advantages = [0.0; 2];
            gae(&segment, 0.5, 1.0, &mut advantages);
            advantages
        };
        assert_eq!(run(0.0), [1.0, 5.0]);
        assert_eq!(run(4.0), [3.0, 5.0]);
    }
}
