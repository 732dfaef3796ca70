//! Rollouts of random observations for policies of the shapes that are trained.

use leadtime_numerics::Pcg64;
use leadtime_policy::{ActionDistribution, Parameters, Policy};
use leadtime_proto::{CheckedRollout, EnvId, EnvSpec, Mask, PolicySpec, PolicyVersion, Rollout};

#[path = "../../../policy/benches/shapes/mod.rs"]
mod shapes;

pub(crate) use shapes::{attentive, plain, recurrent};

/// Acts on random observations; the first policy of a run, so that its update's first ratios are one.
pub(crate) fn rollout(
    spec: &PolicySpec,
    parameters: &Parameters,
    env_id: u32,
    n_steps: usize,
) -> CheckedRollout {
    let mut policy = Policy::new(spec, parameters).expect("the parameters fit");
    let distribution = ActionDistribution::new(&spec.actions, spec.head_credit);
    let mut generator = Pcg64::seed_from_u64(3 + u64::from(env_id));
    let mut draws =
        |n: usize| -> Vec<f32> { (0..n).map(|_| generator.uniform(-1.0, 1.0) as f32).collect() };
    let (observations, rewards) = (draws(n_steps * spec.obs_dim), draws(n_steps));
    let next_observation = draws(spec.obs_dim);
    let n_choices = spec.actions.n_choices();
    let (mut logits, mut values) = (vec![0.0; n_steps * n_choices], vec![0.0; n_steps]);
    let recurrent = vec![0.0; policy.recurrent_dim()];
    let mut state = recurrent.clone();
    let stride = if state.is_empty() { n_steps } else { 1 };
    for first in (0..n_steps).step_by(stride) {
        policy.evaluate(
            &observations[first * spec.obs_dim..][..stride * spec.obs_dim],
            &mut state,
            &mut logits[first * n_choices..][..stride * n_choices],
            &mut values[first..][..stride],
        );
    }
    let mut actions = vec![0; n_steps * 4];
    let rows = logits.chunks_exact(n_choices).zip(actions.chunks_exact_mut(4));
    let log_probs = rows
        .map(|(logits, action)| distribution.sample(logits, Mask::ALL, &mut generator, action))
        .collect();
    let rollout = Rollout {
        env_id: EnvId(env_id),
        version: PolicyVersion(0),
        n_steps: n_steps as u32,
        observations,
        next_observation,
        masks: vec![u64::MAX; n_steps],
        actions,
        log_probs,
        values,
        rewards,
        recurrent,
        snapshot: vec![0],
        ..Rollout::default()
    };
    let env = EnvSpec { obs_dim: spec.obs_dim, actions: spec.actions.clone(), metrics: Vec::new() };
    let n_recurrent = policy.recurrent_dim();
    rollout.check(&env, n_steps, n_recurrent).expect("the rollout fits its own trainer")
}
