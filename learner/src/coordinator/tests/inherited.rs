//! What an actor makes of an episode that others had before it, and is refused.

use leadtime_proto::{EpisodeEnd, EpisodeSummary};

use super::*;

/// A rollout that is refused for what it holds.
fn nan(env_id: u32, iteration: u64) -> Rollout {
    let mut rollout = rollout(env_id, iteration, 0);
    rollout.rewards[0] = f32::NAN;
    rollout
}

/// A rollout in which an episode ends, and another one begins.
fn with_end(rollout: Rollout) -> Rollout {
    let summary =
        EpisodeSummary { episode: 0, episode_return: 0.0, length: 1, metrics: Vec::new() };
    let (final_observation, final_value) = (vec![0.0], 0.0);
    let end = EpisodeEnd { step: 0, truncated: true, final_observation, final_value, summary };
    Rollout { ends: vec![end], ..rollout }
}

/// A run whose environments go on from a checkpoint, with these actors.
fn resumed(n_envs: usize, schedule: Schedule, names: &[&str]) -> Coordinator {
    let mut c = coordinator(n_envs, schedule, &[]);
    (c.settings.actors_min, c.settings.window) = (names.len(), 64);
    let mut places = RolloutQueue::beginning(n_envs);
    for place in &mut places {
        place.snapshot = vec![1];
    }
    c.queue = RolloutQueue::new(schedule, places);
    for name in names {
        join(&mut c, name);
    }
    c.take_effects();
    c
}

/// A run with these actors whose environments go on from what another one sent, which is gone.
fn left_behind(n_envs: u32, schedule: Schedule, names: &[&str]) -> Coordinator {
    let mut c = coordinator(n_envs as usize, schedule, &[]);
    c.settings.window = 64;
    join(&mut c, "x");
    for env in 0..n_envs {
        send(&mut c, "x", u64::from(env) + 1, 100, &rollout(env, 0, 0));
    }
    for name in names {
        join(&mut c, name);
    }
    c.left(actor("x"), Incarnation(1));
    c.take_effects();
    c
}

/// Returns how many refusals are held against a member.
fn charged(coordinator: &Coordinator, name: &str) -> u64 {
    let entries = coordinator.roster_entries();
    let entry = entries.into_iter().find(|entry| entry.id.as_str() == name);
    entry.unwrap().refused.into_values().sum()
}

/// Takes who is given what: environment, iteration and length of the snapshot.
fn given(coordinator: &mut Coordinator) -> Vec<(String, u32, u64, usize)> {
    let told = assignments(coordinator).into_iter();
    let places = told.flat_map(|(to, assignment)| {
        let place = move |env: EnvAssignment| {
            (to.to_string(), env.env_id.0, env.iteration.0, env.snapshot.len())
        };
        assignment.envs.into_iter().map(place)
    });
    places.collect()
}

fn place(name: &str, env_id: u32, iteration: u64, n_bytes: usize) -> (String, u32, u64, usize) {
    (name.to_owned(), env_id, iteration, n_bytes)
}

fn cut_off(effects: &[Effect]) -> Vec<&str> {
    let names = effects.iter().filter_map(|effect| match effect {
        Effect::Event(RunEvent::CutOff { actor, .. }) => Some(actor.as_str()),
        _ => None,
    });
    names.collect()
}

#[test]
fn a_state_that_leads_others_to_what_is_refused_is_given_up_and_its_sender_cut_off() {
    let mut c = coordinator(3, Schedule::Lag(1), &["a", "b", "rogue"]);
    send(&mut c, "rogue", 1, 100, &rollout(2, 0, 0));
    c.left(actor("rogue"), Incarnation(1));
    assert!(given(&mut c).contains(&place("a", 2, 1, 1)));
    send(&mut c, "a", 1, 100, &nan(2, 1));
    // Made before it could know.
    send(&mut c, "a", 2, 100, &nan(2, 2));
    assert_eq!(given(&mut c), [place("b", 2, 1, 1)], "the same state");
    send_under(&mut c, "a", 3, 0, &nan(2, 3));
    assert!(c.take_effects().is_empty());
    send(&mut c, "b", 1, 100, &nan(2, 1));
    assert_eq!(given(&mut c), [place("b", 2, 1, 1)], "the last one tries twice");
    send(&mut c, "b", 2, 100, &nan(2, 1));
    let effects = c.take_effects();
    assert_eq!(cut_off(&effects), ["rogue"]);
    assert_eq!(c.hello(&hello("rogue", 1, 2)), Err(HelloRefusal::CutOff));
    assert_eq!((charged(&c, "a"), charged(&c, "b")), (0, 0));
    for (name, sequence, env) in [("a", 4, 0), ("b", 3, 1), ("b", 4, 2)] {
        send(&mut c, name, sequence, 100, &rollout(env, 0, 0));
    }
    assert_eq!(c.next_batch().unwrap().len(), 3);
    c.trained(PolicyVersion(1));
    let books = close_balanced(&mut c);
    let counted = [RefusalCause::NonFinite, RefusalCause::Snapshot].map(|it| books.refusals[&it]);
    assert_eq!((counted, books.superseded), ([3, 1], 2));
    assert!(!books.has_fresh_episodes(), "the same is made again");
}

#[test]
fn who_is_refused_where_another_one_goes_on_is_charged_and_cut_off_in_the_end() {
    let n_lies = limits::REFUSALS_BEFORE_CUT_OFF as u32;
    let n_envs = 2 * n_lies;
    let mut c = left_behind(n_envs, Schedule::Lag(1), &["honest", "liar"]);
    for (sequence, env) in (1..).zip(n_lies..n_envs) {
        send(&mut c, "liar", sequence, 100, &nan(env, 1));
    }
    let given = given(&mut c);
    assert!(given.iter().all(|(to, ..)| to == "honest"), "{given:?}");
    assert_eq!((given.len(), charged(&c, "liar")), (n_lies as usize, 0));
    for (sequence, env) in (1..).zip(0..n_envs) {
        assert_eq!(c.n_actors(), 2, "environment {env}");
        send(&mut c, "honest", sequence, 100, &rollout(env, 1, 0));
    }
    assert_eq!(cut_off(&c.take_effects()), ["liar"]);
    assert_eq!((c.n_actors(), charged(&c, "honest")), (1, 0));
    assert_eq!(c.next_batch().unwrap().len(), n_envs as usize);
    c.trained(PolicyVersion(1));
    let books = close_balanced(&mut c);
    assert_eq!(books.refused, u64::from(n_lies));
    assert!(!books.has_fresh_episodes(), "what it said changes no bit");
}

#[test]
fn many_environments_are_given_away_in_one_order() {
    let mut c = resumed(8, Schedule::Lag(0), &["a", "b"]);
    for (sequence, env) in (1..).zip(0..4) {
        send(&mut c, "a", sequence, 100, &nan(env, 0));
    }
    let told = assignments(&mut c);
    let told: Vec<(&str, usize)> =
        told.iter().map(|(to, it)| (to.as_str(), it.envs.len())).collect();
    assert_eq!(told, [("a", 0), ("b", 4)]);
}

#[test]
fn an_episode_that_an_actor_began_is_its_own() {
    let mut c = resumed(2, Schedule::Lag(9), &["a", "b"]);
    send(&mut c, "a", 1, 100, &rollout(0, 0, 0));
    send(&mut c, "b", 1, 100, &with_end(rollout(1, 0, 0)));
    for (name, env, sequence, n_charged) in [("a", 0, 2, 0), ("b", 1, 2, 1)] {
        send(&mut c, name, sequence, 100, &nan(env, 1));
        assert_eq!(charged(&c, name), n_charged, "{name}");
    }
    // The one goes to somebody else, and the other is given anew to the one that made it.
    assert_eq!(given(&mut c), [place("b", 1, 1, 1), place("b", 0, 1, 1)]);
    // What another one went on with is not its own any more.
    c.left(actor("b"), Incarnation(1));
    c.take_effects();
    send(&mut c, "a", 3, 100, &nan(1, 1));
    assert_eq!(charged(&c, "a"), 0);
}

#[test]
fn an_episode_that_others_went_on_with_is_given_up_as_a_whole_and_nobody_is_blamed() {
    let mut c = coordinator(3, Schedule::Lag(2), &["a", "b", "rogue"]);
    send(&mut c, "rogue", 1, 100, &rollout(2, 0, 0));
    c.left(actor("rogue"), Incarnation(1));
    c.take_effects();
    // It shows late what is wrong, say at the end of the episode.
    send(&mut c, "a", 1, 100, &rollout(2, 1, 0));
    send(&mut c, "a", 2, 100, &nan(2, 2));
    assert_eq!(given(&mut c), [place("b", 2, 2, 1)]);
    send(&mut c, "b", 1, 100, &nan(2, 2));
    c.take_effects();
    send(&mut c, "b", 2, 100, &nan(2, 2));
    let effects = c.take_effects();
    let is_blame = |effect: &&Effect| matches!(effect, Effect::Event(RunEvent::Distrusted { .. }));
    assert_eq!((cut_off(&effects).len(), effects.iter().filter(is_blame).count()), (0, 0));
    assert_eq!(c.queue.newest(EnvId(2)).iteration, Iteration(0));
    assert_eq!((charged(&c, "a"), charged(&c, "b")), (0, 0));
    let books = close_balanced(&mut c);
    let counted = [RefusalCause::NonFinite, RefusalCause::Snapshot].map(|it| books.refusals[&it]);
    assert_eq!(counted, [3, 2]);
}

#[test]
fn an_actor_on_its_own_tries_twice_and_then_begins_anew() {
    let mut c = resumed(1, Schedule::Lag(0), &["a"]);
    send(&mut c, "a", 1, 100, &nan(0, 0));
    assert_eq!(given(&mut c), [place("a", 0, 0, 1)]);
    send(&mut c, "a", 2, 100, &nan(0, 0));
    assert_eq!(given(&mut c), [place("a", 0, 0, 0)]);
    assert_eq!(charged(&c, "a"), 0);
    for n_own in 1..=limits::REFUSALS_BEFORE_CUT_OFF {
        assert_eq!(c.n_actors(), 1, "{n_own}");
        send(&mut c, "a", 2 + n_own, 100, &nan(0, 0));
        c.take_effects();
    }
    assert_eq!(c.n_actors(), 0, "that is its own work");
    assert!(close_balanced(&mut c).has_fresh_episodes());
    // An accident of its own changes no bit, and is charged.
    let mut c = resumed(1, Schedule::Lag(0), &["a"]);
    send(&mut c, "a", 1, 100, &nan(0, 0));
    c.take_effects();
    send(&mut c, "a", 2, 100, &rollout(0, 0, 0));
    assert_eq!((charged(&c, "a"), c.n_pending()), (1, 1));
    assert!(!close_balanced(&mut c).has_fresh_episodes());
}

#[test]
fn where_another_policy_acts_only_the_end_of_an_episode_proves_that_its_state_was_sound() {
    let mut c = left_behind(4, Schedule::Async { staleness_max: 8 }, &["a", "b"]);
    for (sequence, env) in [(1, 0), (2, 1)] {
        send(&mut c, "a", sequence, 100, &nan(env, 1));
    }
    c.take_effects();
    send(&mut c, "b", 1, 100, &rollout(0, 1, 0));
    assert_eq!(charged(&c, "a"), 0);
    assert!(!events(&mut c).iter().any(|it| matches!(it, RunEvent::Distrusted { .. })));
    send(&mut c, "b", 2, 100, &with_end(rollout(1, 1, 0)));
    assert_eq!(charged(&c, "a"), 1);
    assert!(events(&mut c).iter().any(|it| matches!(it, RunEvent::Distrusted { .. })));
    close_balanced(&mut c);
}

#[test]
fn who_sent_a_state_is_the_last_to_try_it_and_charges_nobody_by_going_on() {
    let mut c = coordinator(3, Schedule::Lag(1), &["k", "m", "x"]);
    send(&mut c, "x", 1, 100, &rollout(2, 0, 0));
    c.left(actor("x"), Incarnation(1));
    assert!(given(&mut c).contains(&place("k", 2, 1, 1)));
    join(&mut c, "x");
    send(&mut c, "k", 1, 100, &nan(2, 1));
    assert_eq!(given(&mut c), [place("m", 2, 1, 1)], "though the other one has none");
    c.left(actor("m"), Incarnation(1));
    assert_eq!(given(&mut c), [place("k", 1, 0, 0), place("x", 2, 1, 1)]);
    send(&mut c, "x", 2, 100, &rollout(2, 1, 0));
    let is_wary = |event: &RunEvent| matches!(event, RunEvent::Distrusted { actor, .. } if actor.as_str() == "k");
    assert!(events(&mut c).iter().any(is_wary));
    assert_eq!(charged(&c, "k"), 0);
}

#[test]
fn who_goes_on_sending_what_was_taken_from_it_is_charged() {
    let mut c = resumed(2, Schedule::Lag(0), &["a", "b"]);
    send(&mut c, "a", 1, 100, &nan(0, 0));
    let (to, taken) = assignments(&mut c).remove(0);
    assert_eq!((&to, taken.envs.len()), (&actor("a"), 0));
    let key = (actor("a"), Incarnation(1));
    // It may have published as much as it was allowed to before it followed.
    send_under(&mut c, "a", 2, 1, &nan(0, 1));
    let membership = c.roster.membership(&key).unwrap();
    c.followed(&key, membership, taken.epoch);
    let limit = c.roster_entries()[0].limit;
    for sequence in 3..=limit {
        send_under(&mut c, "a", sequence, 1, &nan(0, sequence));
    }
    assert_eq!((charged(&c, "a"), c.books().superseded), (0, limit - 1));
    c.take_effects();
    send_under(&mut c, "a", limit + 1, 1, &nan(0, 9));
    assert_eq!(charged(&c, "a"), 1);
    // What it sent before it was lost comes again afterwards.
    let mut c = resumed(2, Schedule::Lag(0), &["a", "b"]);
    c.left(actor("a"), Incarnation(1));
    join(&mut c, "a");
    send_under(&mut c, "a", 1, 1, &nan(0, 0));
    assert_eq!((charged(&c, "a"), c.books().superseded), (0, 1));
}
