//! How large the messages and files of a run become: what could never be sent or written is refused before it starts.
//!
//! A rollout over its limit would be sent, refused and sent again for ever; a checkpoint over its limit would end the
//! run at its first one. All sizes are upper bounds in bytes, a little above what the encoding makes of the numbers.

use anyhow::ensure;
use leadtime_learner::checkpoint::MAX_PAYLOAD_BYTES;
use leadtime_learner::{LearnerSettings, Mode};
use leadtime_policy::parameters::shapes;
use leadtime_proto::limits::{MAX_ROLLOUT_BYTES, MAX_SNAPSHOT_BYTES, MAX_WEIGHTS_BYTES};
use leadtime_proto::{EnvId, EnvSpec, PolicySpec};
use leadtime_sims::Environment;
use leadtime_sims::environment::EpisodeSeed;

/// Room for what has no length of its own: ids, counts, the lengths of arrays.
const FRAME_BYTES: usize = 256;
/// The same for the end of an episode.
const END_BYTES: usize = 64;
/// Room for a tensor's name, shape and place in a file of weights.
const TENSOR_BYTES: usize = 192;
/// How many times its size at the start a snapshot may reach: worlds remember contacts and histories.
const SNAPSHOT_GROWTH: usize = 2;
/// What the last training episodes and the books take in a checkpoint.
const RECORDS_BYTES: usize = 64 << 10;

/// Refuses settings under which a rollout, the weights or a checkpoint would be over their limit.
///
/// # Errors
///
/// One sentence with the key, the size and the limit.
pub fn check(
    environment: &mut dyn Environment,
    policy: &PolicySpec,
    learner: &LearnerSettings,
) -> anyhow::Result<()> {
    check_rollout(environment.spec(), policy, learner.n_steps)?;
    let weights = weights_bytes(policy);
    ensure!(
        weights <= MAX_WEIGHTS_BYTES,
        "`policy.hidden` and the encoder's widths make weights of up to {weights} bytes; allowed: at most \
         {MAX_WEIGHTS_BYTES} bytes"
    );
    check_checkpoint(snapshot_bytes(environment, policy), weights, learner)
}

fn check_rollout(env: &EnvSpec, policy: &PolicySpec, n_steps: usize) -> anyhow::Result<()> {
    let observation = 4 * env.obs_dim;
    // Per step: observation, mask, choices, log-probability, value, reward; and an episode may end in every step.
    let step = observation + 8 + env.actions.heads.len() + 12;
    let end = observation + 4 * env.metrics.len() + END_BYTES;
    let rest = observation + 4 * policy.recurrent_dim() + MAX_SNAPSHOT_BYTES + FRAME_BYTES;
    let bytes = n_steps * (step + end) + rest;
    let most = MAX_ROLLOUT_BYTES.saturating_sub(rest) / (step + end);
    ensure!(
        bytes <= MAX_ROLLOUT_BYTES,
        "`learner.n_steps` is {n_steps}, which makes rollouts of up to {bytes} bytes; allowed: at most \
         {MAX_ROLLOUT_BYTES} bytes, which is {most} steps of this task"
    );
    Ok(())
}

fn check_checkpoint(
    snapshot: usize,
    weights: usize,
    learner: &LearnerSettings,
) -> anyhow::Result<()> {
    let n_older = if learner.mode == Mode::Lag { learner.lag as usize } else { 0 };
    // The parameters with Adam's two moments, the best policy, and the versions that acting still needs.
    let networks = (3 + 1 + n_older) * weights;
    let n_envs = learner.n_envs;
    let environments = n_envs * (snapshot + FRAME_BYTES);
    let bytes = networks + environments + RECORDS_BYTES;
    ensure!(
        bytes <= MAX_PAYLOAD_BYTES,
        "a checkpoint would have up to {bytes} bytes: {networks} for the networks (`policy.hidden`, and {n_older} \
         older versions by `learner.lag`), {environments} for the environments (`learner.n_envs` is {n_envs}); \
         allowed: at most {MAX_PAYLOAD_BYTES} bytes"
    );
    Ok(())
}

fn weights_bytes(policy: &PolicySpec) -> usize {
    let tensor = |shape: &Vec<usize>| 4 * shape.iter().product::<usize>() + TENSOR_BYTES;
    let statistics = 2 * 8 * policy.obs_dim + 3 * TENSOR_BYTES;
    shapes(policy).values().map(tensor).sum::<usize>() + statistics
}

fn snapshot_bytes(environment: &mut dyn Environment, policy: &PolicySpec) -> usize {
    let mut observation = vec![0.0; environment.spec().obs_dim];
    environment.reset(EpisodeSeed { run_seed: 0, env_id: EnvId(0), episode: 0 }, &mut observation);
    let mut snapshot = Vec::new();
    environment.snapshot(&mut snapshot);
    SNAPSHOT_GROWTH * snapshot.len() + 4 * policy.recurrent_dim()
}
