//! Learning, from environment to weights, without processes between: the update is right if a pole is balanced, and
//! memory is carried rightly if a cue is recalled.

use leadtime_actor::Worker;
use leadtime_policy::Policy;
use leadtime_policy::attention::PresentEntities;
use leadtime_ppo::{LearnerSettings, Mode, Trainer, UpdateReport};
use leadtime_proto::message::EnvAssignment;
use leadtime_proto::{Encoder, EnvId, Iteration, PolicySpec, Rollout, RunSpec, TaskSpec};
use leadtime_sims::Environment;

/// Trains on a task and returns, per finished episode, its return; and what the first update reported.
fn train(
    domain: &str,
    (encoder, hidden): (Encoder, &[usize]),
    settings: &LearnerSettings,
    run_seed: u64,
) -> (Vec<f64>, UpdateReport) {
    let network = |environment: &dyn Environment| {
        let dense = PolicySpec::dense(environment.spec(), hidden);
        PolicySpec { encoder, ..dense }
    };
    let (mut returns, mut first) = (Vec::new(), None);
    train_network(domain, network, settings, run_seed, |rollouts, _, report| {
        for end in rollouts.iter().flat_map(|rollout| &rollout.ends) {
            returns.push(end.summary.episode_return);
        }
        first.get_or_insert(report);
    });
    (returns, first.expect("there are updates"))
}

/// Trains the network that is made for the environment, and shows what each update was made from and what it made.
fn train_network(
    domain: &str,
    network: impl FnOnce(&dyn Environment) -> PolicySpec,
    settings: &LearnerSettings,
    run_seed: u64,
    mut updated: impl FnMut(&[Rollout], &Trainer, UpdateReport),
) {
    let task = TaskSpec { domain: domain.to_owned(), settings: r#"{"world": {}}"#.to_owned() };
    let registry = leadtime_worlds::builtin();
    let environment = registry.build(&task).expect("the task is built in");
    let (env, policy) = (environment.spec().clone(), network(&*environment));
    let mut trainer = Trainer::new(&policy, settings, run_seed).expect("sound settings");
    let mut worker = Worker::new(RunSpec {
        seed: run_seed,
        task: task.clone(),
        env: env.clone(),
        policy: policy.clone(),
        n_steps: settings.n_steps as u32,
        schedule: settings.schedule(),
    });
    for env_id in (0..settings.n_envs as u32).map(EnvId) {
        let start = EnvAssignment { env_id, iteration: Iteration(0), snapshot: Vec::new() };
        let environment = registry.build(&task).expect("the task is built in");
        worker.insert(environment, &start).expect("an empty snapshot is a fresh start");
    }
    for _ in 0..trainer.n_updates() {
        let mut acting = Policy::new(&policy, trainer.parameters()).expect("the weights fit");
        let rollouts = worker.collect(&mut acting, trainer.version(), &mut ());
        let check = |rollout: &Rollout| {
            rollout.clone().check(&env, settings.n_steps, policy.recurrent_dim()).expect("sound")
        };
        let checked: Vec<_> = rollouts.iter().map(check).collect();
        let report = trainer.update(&checked).expect("the update succeeds");
        updated(rollouts, &trainer, report);
    }
}

fn mean_of_last(returns: &[f64], n: usize) -> f64 {
    let last = &returns[returns.len().saturating_sub(n)..];
    last.iter().sum::<f64>() / last.len() as f64
}

#[test]
fn a_pole_is_balanced_with_every_seed() {
    let settings =
        LearnerSettings { total_steps: 60_000, learning_rate: 1e-3, ..LearnerSettings::default() };
    // A random policy holds it for about 22 steps, a perfect one for 500.
    for run_seed in [1, 2, 3] {
        let (returns, _) = train("cartpole", (Encoder::Identity, &[64, 64]), &settings, run_seed);
        let mean = mean_of_last(&returns, 20);
        assert!(mean > 200.0, "seed {run_seed}: {mean}");
    }
}

#[test]
fn a_cue_is_recalled_with_memory_and_guessed_without() {
    let settings = |mode| LearnerSettings {
        n_envs: 16,
        n_steps: 32,
        n_minibatches: 4,
        total_steps: 40_000,
        learning_rate: 2e-3,
        mode,
        ..LearnerSettings::default()
    };
    let lstm = Encoder::Lstm { projection: 16, state: 32 };
    // +1 for the right one of two cues, -1 for the wrong one.
    for (run_seed, mode) in [(1, Mode::Sync), (2, Mode::Lag), (3, Mode::Async)] {
        let mean =
            |network| mean_of_last(&train("cue_recall", network, &settings(mode), run_seed).0, 200);
        let recalled = mean((lstm, &[]));
        assert!(recalled > 0.95, "seed {run_seed}: {recalled}");
        let guessed = mean((Encoder::Identity, &[32]));
        assert!(guessed.abs() < 0.4, "seed {run_seed}: {guessed}");
    }
}

#[test]
fn actor_and_learner_agree_on_log_probabilities_to_the_bit() {
    // With one pass over one minibatch the weights are still those of the actor: every ratio is exactly 1.
    let settings = LearnerSettings {
        n_envs: 3,
        n_steps: 50,
        n_minibatches: 1,
        n_epochs: 1,
        total_steps: 150,
        ..LearnerSettings::default()
    };
    let lstm = Encoder::Lstm { projection: 8, state: 24 };
    for network in [(Encoder::Identity, &[32, 32][..]), (lstm, &[]), (lstm, &[16])] {
        let (_, report) = train("cue_recall", network, &settings, 1);
        assert_eq!((report.old_approx_kl, report.approx_kl), (0.0, 0.0), "{network:?}");
    }
}

#[test]
fn cars_stay_present_while_observations_are_normalised() {
    let settings = LearnerSettings {
        n_envs: 4,
        n_steps: 32,
        n_minibatches: 2,
        n_epochs: 1,
        total_steps: 4 * 4 * 32,
        ..LearnerSettings::default()
    };
    let attention = |environment: &dyn Environment| {
        environment.entity_history().expect("a road has entities").attention(16, 2)
    };
    let network = |environment: &dyn Environment| PolicySpec {
        encoder: Encoder::EgoAttention(attention(environment)),
        normalize_observations: true,
        ..PolicySpec::dense(environment.spec(), &[16])
    };
    let task = TaskSpec { domain: "highway".to_owned(), settings: "{}".to_owned() };
    let road = leadtime_worlds::builtin().build(&task).expect("the task is built in");
    let (attention, obs_dim) = (attention(&*road), road.spec().obs_dim);
    let (mut raw, mut normalized) = (PresentEntities::default(), PresentEntities::default());
    let (mut n_updates, mut n_others) = (0, 0);
    train_network("highway", network, &settings, 1, |rollouts, trainer, _| {
        let normalizer = trainer.parameters().normalizer().expect("it normalises").freeze();
        let rows = rollouts.iter().flat_map(|rollout| rollout.observations.chunks_exact(obs_dim));
        for row in rows {
            let mut seen = vec![f32::NAN; obs_dim];
            normalizer.apply(row, &mut seen);
            assert_ne!(seen, row);
            let n_numbers = attention.n_frames * attention.frame_dim();
            raw.list(&row[..n_numbers], &attention);
            normalized.list(&seen[..n_numbers], &attention);
            assert_eq!(normalized.frames, raw.frames);
            assert!(normalized.frames.iter().all(|frame| frame.ego));
            n_others += normalized.n_others();
        }
        n_updates += 1;
    });
    assert!(n_updates == 4 && n_others > 0, "{n_updates} updates, {n_others} other cars");
}
