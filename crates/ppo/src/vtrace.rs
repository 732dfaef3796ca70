//! V-trace: value targets and advantages of a policy from steps that a slightly older policy acted.

use leadtime_numerics::elementary::exp;

use crate::gae::TrajectorySegment;

/// Value targets and advantages of one segment. Both `[T]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct VTrace {
    /// Targets of the critic.
    pub(crate) value_targets: Vec<f32>,
    /// Advantages, *without* the factor ρ of the policy gradient: PPO's ratio against the behaviour policy takes
    /// that factor's place, and both together would count it twice.
    pub(crate) advantages: Vec<f32>,
}

/// Computes V-trace targets with ρ and c truncated at 1, for values of the policy that is about to learn.
///
/// `δ_t = ρ_t (r_t + γ V(s_{t+1}) - V(s_t))`, `v_t = V(s_t) + δ_t + γ c_t (v_{t+1} - V(s_{t+1}))`, and the advantage is
/// `r_t + γ v_{t+1} - V(s_t)`. An episode's end cuts the recursion; its bootstrap stands for both `V` and `v`. With
/// behaviour and target policy equal these are n-step bootstrapped returns.
///
/// # Shapes
///
/// `log_rhos`: `[T]`, `log π(a_t|s_t) - log μ(a_t|s_t)`.
///
/// # Units
///
/// `log_rhos` in nats; `gamma` is a factor per step, 0 to 1.
///
/// # Source
///
/// Espeholt et al., *IMPALA*, ICML 2018 (arXiv:1802.01561), equation 1 and section 4.2.
pub(crate) fn vtrace(segment: &TrajectorySegment<'_>, log_rhos: &[f32], gamma: f32) -> VTrace {
    let n = segment.rewards.len();
    assert_eq!(segment.values.len(), n, "`values` must be [T]");
    assert_eq!(log_rhos.len(), n, "`log_rhos` must be [T]");
    let mut out = VTrace { value_targets: vec![0.0; n], advantages: vec![0.0; n] };
    // v_{t+1} - V(s_{t+1}), zero behind the rollout and behind an episode's end.
    let mut correction = 0.0;
    segment.backwards(|step, following, goes_on| {
        let rho = exp(log_rhos[step].min(0.0));
        let later = if goes_on { correction } else { 0.0 };
        let value = segment.values[step];
        let error = segment.rewards[step] + gamma * following - value;
        out.advantages[step] = error + gamma * later;
        correction = rho * error + gamma * rho * later;
        out.value_targets[step] = value + correction;
    });
    out
}

#[cfg(test)]
#[expect(clippy::unreadable_literal, reason = "golden numbers are as the script writes them")]
mod tests {
    use super::*;
    use crate::gae::{Cut, gae};
    include!("../golden/vtrace.rs");

    #[test]
    fn targets_equal_the_defining_sum() {
        // crates/ppo/golden/golden.py, `vtrace`: the sum of Espeholt et al., equation 1, written out in numpy, float64.
        let cuts = [Cut { step: 2, bootstrap: 0.0 }, Cut { step: 4, bootstrap: 1.5 }];
        let (rewards, values, next_value) = (&REWARDS, &VALUES, NEXT_VALUE);
        let segment = TrajectorySegment { rewards, values, next_value, cuts: &cuts };
        let out = vtrace(&segment, &LOG_RHOS, 0.97);
        for i in 0..7 {
            let (target, advantage) = (out.value_targets[i], out.advantages[i]);
            assert!((target - VALUE_TARGETS[i]).abs() < 1e-5, "{i}: {target}");
            let rho = LOG_RHOS[i].min(0.0).exp();
            assert!((rho * advantage - PG_ADVANTAGES[i]).abs() < 1e-5, "{i}: {advantage}");
        }
    }

    #[test]
    fn on_policy_the_targets_are_n_step_returns() {
        let cuts = [Cut { step: 1, bootstrap: 3.0 }];
        let (rewards, values) = ([1.0, -2.0, 0.5, 4.0], [0.3, 0.1, -0.7, 2.0]);
        let segment =
            TrajectorySegment { rewards: &rewards, values: &values, next_value: 5.0, cuts: &cuts };
        let out = vtrace(&segment, &[0.0; 4], 0.9);
        let mut advantages = [0.0; 4];
        gae(&segment, 0.9, 1.0, &mut advantages);
        for i in 0..4 {
            assert!((out.value_targets[i] - (advantages[i] + values[i])).abs() < 1e-6);
            assert!((out.advantages[i] - advantages[i]).abs() < 1e-6);
        }
    }
}
