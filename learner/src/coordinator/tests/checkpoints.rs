//! What of a coordinator goes into a checkpoint, with a trainer's state.

use leadtime_ppo::{LearnerSettings, Mode, Trainer, TrainerState};

use super::*;
use crate::resume::{Checkpoint, TrainingRecord};

/// Returns what a checkpoint holds of a trainer.
fn saved(coordinator: &Coordinator, trainer: &Trainer) -> TrainerState {
    let (state, record) = (trainer.state().unwrap(), TrainingRecord::default());
    Checkpoint::of(coordinator, state, [0; 32], Vec::new(), record).trainer
}

#[test]
fn an_update_that_is_made_again_after_a_resume_knows_what_was_dropped_before_it() {
    let mut c = coordinator(1, Schedule::Async { staleness_max: 0 }, &["a"]);
    let settings = LearnerSettings {
        n_envs: 1,
        n_steps: 1,
        n_minibatches: 1,
        total_steps: 4,
        mode: Mode::Async,
        normalize_rewards: true,
        ..LearnerSettings::default()
    };
    let mut trainer = Trainer::new(&c.settings.spec.policy, &settings, 1).unwrap();
    send(&mut c, "a", 1, 1, &rollout(0, 0, 0));
    trainer.update(&c.next_batch().unwrap()).unwrap();
    c.take_broken_off();
    c.trained(PolicyVersion(1));
    c.take_effects();
    let before = trainer.state().unwrap();
    assert_eq!(saved(&c, &trainer), before);
    // The first one is of an older version.
    send(&mut c, "a", 2, 1, &rollout(0, 1, 0));
    send(&mut c, "a", 3, 1, &rollout(0, 2, 1));
    let batch = c.next_batch().unwrap();
    let broken_off = c.take_broken_off();
    assert_eq!((c.books().dropped_stale, c.places()[0].iteration), (1, Iteration(2)));
    let during = saved(&c, &trainer);
    assert_ne!(during, before);
    for env_id in broken_off {
        trainer.forget_episode(env_id);
    }
    assert_eq!(during, trainer.state().unwrap(), "as the update under way begins");
    trainer.update(&batch).unwrap();
    c.trained(PolicyVersion(2));
    assert_eq!(saved(&c, &trainer), trainer.state().unwrap());
}
