//! What tests of several crates begin with: a small run, who takes part in it, and what is sent in it.

use crate::message::{Announcement, Hello, Welcome};
use crate::{
    ActionSpec, ActorId, EnvId, EnvSpec, Incarnation, Iteration, PolicySpec, PolicyVersion,
    Rollout, RunName, RunSpec, Schedule, Sequence, TaskSpec,
};

/// Describes a run whose environments show one number and offer two choices.
pub fn run_spec(domain: &str, n_steps: u32, schedule: Schedule) -> RunSpec {
    let actions = ActionSpec::discrete("a", 2);
    let env = EnvSpec { obs_dim: 1, actions, metrics: Vec::new() };
    RunSpec {
        seed: 1,
        task: TaskSpec { domain: domain.to_owned(), settings: "{}".to_owned() },
        policy: PolicySpec::dense(&env, &[8]),
        env,
        n_steps,
        schedule,
    }
}

/// Makes the hello of an actor that has sent nothing yet.
pub fn hello(actor: ActorId, incarnation: Incarnation) -> Hello {
    Hello {
        program: "test".to_owned(),
        actor,
        incarnation,
        cpu: "cpu".to_owned(),
        published: Sequence(0),
        first_unacknowledged: Sequence(1),
    }
}

/// Makes the welcome of such an actor.
pub fn welcome(run: RunName, spec: RunSpec, weights: Announcement) -> Welcome {
    Welcome { run, spec, window: 4, weights, resend_from: Sequence(1) }
}

/// Makes a rollout of one step in such a run.
pub fn rollout(env_id: EnvId, iteration: Iteration, version: PolicyVersion) -> Rollout {
    Rollout {
        env_id,
        iteration,
        version,
        n_steps: 1,
        observations: vec![0.0],
        next_observation: vec![0.0],
        masks: vec![u64::MAX],
        actions: vec![0],
        log_probs: vec![0.0],
        values: vec![0.0],
        rewards: vec![0.0],
        ..Rollout::default()
    }
}
