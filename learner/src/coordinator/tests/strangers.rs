//! What a member on its own can do to a run and to the other members: anybody can be one.

use super::*;

#[test]
fn an_environment_that_is_reported_again_and_again_is_given_away_once() {
    let mut c = coordinator(3, Schedule::Lag(0), &["a", "b", "rogue"]);
    c.take_effects();
    let key = (actor("rogue"), Incarnation(1));
    c.cannot_restore(&key, Epoch(100), &[EnvId(2), EnvId(0), EnvId(2), EnvId(99), EnvId(2)]);
    let (mut n_told, mut n_given) = (0, 0);
    for effect in c.take_effects() {
        match effect {
            Effect::Event(RunEvent::SnapshotRefused { env_id: EnvId(2), .. }) => n_told += 1,
            Effect::Control { control: Control::Assign(assignment), .. } => {
                assignment.check().unwrap();
                n_given += assignment.envs.len();
            }
            Effect::Control { control, .. } => panic!("{control:?}"),
            Effect::Event(_) | Effect::Credit { .. } => {}
        }
    }
    assert_eq!((n_told, n_given), (1, 1));
}

#[test]
fn on_the_word_of_one_a_sender_is_trusted_less_and_not_cut_off() {
    let mut c = coordinator(2, Schedule::Lag(0), &["a", "s"]);
    send(&mut c, "a", 1, 100, &rollout(0, 0, 0));
    c.left(actor("a"), Incarnation(1));
    c.take_effects();
    cannot_restore(&mut c, "s", 0);
    let told = events(&mut c);
    let is_wary = |event: &RunEvent| matches!(event, RunEvent::Distrusted { actor, .. } if actor.as_str() == "a");
    assert!(told.iter().any(is_wary), "{told:?}");
    assert!(!told.iter().any(|event| matches!(event, RunEvent::CutOff { .. })), "{told:?}");
    assert_eq!(c.hello(&hello("a", 1, 2)), Ok(Sequence(2)));
    close_balanced(&mut c);
}
