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

#[test]
fn starts_that_come_for_one_rollout_do_not_stay_in_the_books() {
    let mut c = coordinator(1, Schedule::Lag(0), &["a"]);
    send(&mut c, "a", 1, 100, &rollout(9, 0, 0));
    let n_starts = 3_000;
    for i in 0..n_starts {
        let name = format!("s{i:047}");
        join(&mut c, &name);
        send(&mut c, &name, 1, 100, &rollout(9, 0, 0));
        c.left(actor(&name), Incarnation(1));
        c.take_effects();
    }
    let n_bytes = codec::encode(c.books()).unwrap().len();
    assert!(n_bytes < 120_000, "{n_bytes}: some fifty for each start that is kept");
    send(&mut c, "a", 2, 100, &rollout(9, 0, 0));
    let books = close_balanced(&mut c);
    assert_eq!((books.refused, books.published), (n_starts + 2, n_starts + 2));
}

#[test]
fn the_number_of_an_assignment_that_one_member_names_is_its_own() {
    let mut c = coordinator(2, Schedule::Lag(0), &["a", "rogue"]);
    c.take_effects();
    let highest = limits::MAX_HEARD_EPOCH;
    send_under(&mut c, "rogue", 1, highest, &rollout(1, 0, 0));
    let (to, again) = assignments(&mut c).remove(0);
    assert_eq!((to, again.epoch), (actor("rogue"), Epoch(highest + 1)), "or it would not follow");
    assert!(c.epoch() < Epoch(1_000));
    c.left(actor("rogue"), Incarnation(1));
    let (to, taken) = assignments(&mut c).remove(0);
    assert_eq!(to, actor("a"));
    assert!(taken.epoch < Epoch(1_000), "{}", taken.epoch);
    // The same start of it comes back, and follows nothing lower.
    join(&mut c, "rogue");
    c.left(actor("a"), Incarnation(1));
    let (_, again) = assignments(&mut c).remove(0);
    assert_eq!((again.epoch, again.envs.len()), (Epoch(highest + 2), 2));
    assert!(c.epoch() < Epoch(1_000));
}

#[test]
fn an_actor_that_takes_long_to_restore_keeps_its_environments_as_long_as_it_has_not_answered() {
    let mut c = coordinator(8, Schedule::Lag(0), &[]);
    c.settings.actors_min = 2;
    let mut places = RolloutQueue::beginning(8);
    for place in &mut places {
        place.snapshot = vec![1];
    }
    c.queue = RolloutQueue::new(Schedule::Lag(0), places);
    join(&mut c, "quick");
    join(&mut c, "slow");
    let told = assignments(&mut c);
    let follow = |c: &mut Coordinator, index: usize| {
        let (name, assignment): &(ActorId, Assignment) = &told[index];
        let key = (name.clone(), Incarnation(1));
        let membership = c.roster.membership(&key).unwrap();
        c.followed(&key, membership, assignment.epoch);
    };
    follow(&mut c, 0);
    for env in 0..4 {
        send(&mut c, "quick", u64::from(env) + 1, 100, &rollout(env, 0, 0));
    }
    // Before the first update a member is late after 15 s.
    let n_taken = |c: &mut Coordinator, n_ticks: u64| {
        (0..n_ticks).for_each(|_| c.tick());
        assignments(c).len()
    };
    assert_eq!(n_taken(&mut c, 60), 0);
    c.hello(&hello("slow", 0, 1)).unwrap();
    assert!(assignments(&mut c).is_empty(), "it has not lost them, it restores them");
    follow(&mut c, 1);
    assert_eq!(n_taken(&mut c, 20), 0);
    assert_eq!(n_taken(&mut c, 40), 2, "it is mute");
}
