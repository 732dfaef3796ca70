//! Everything that can happen to a rollout, without a network.

use leadtime_proto::header::Schema;
use leadtime_proto::{Iteration, Schedule, codec, fakes};

use crate::stragglers::BACK_OFF;

use super::*;

mod checkpoints;
mod inherited;
mod strangers;

const WINDOW: u32 = 4;

/// A run that begins when all of these actors are there, which they are.
fn coordinator(n_envs: usize, schedule: Schedule, names: &[&str]) -> Coordinator {
    let settings = CoordinatorSettings {
        learner: Incarnation(99),
        spec: fakes::run_spec("test", 1, schedule),
        window: WINDOW,
        actors_min: names.len().max(1),
    };
    let mut builds = Builds::default();
    builds.note(&Build { program: "test".to_owned(), cpu: "cpu".to_owned() });
    let places = RolloutQueue::beginning(n_envs);
    let start = CoordinatorStart { places, builds, ..CoordinatorStart::default() };
    let mut c = Coordinator::new(settings, start);
    for name in names {
        join(&mut c, name);
    }
    c
}

fn actor(name: &str) -> ActorId {
    ActorId::new(name).unwrap()
}

fn hello(name: &str, published: u64, first_unacknowledged: u64) -> Hello {
    Hello {
        published: Sequence(published),
        first_unacknowledged: Sequence(first_unacknowledged),
        ..fakes::hello(actor(name), Incarnation(1))
    }
}

fn join(coordinator: &mut Coordinator, name: &str) {
    coordinator.hello(&hello(name, 0, 1)).unwrap();
    coordinator.joined(actor(name), Incarnation(1));
    answer(coordinator, name);
}

/// Answers the order to wait.
fn answer(coordinator: &mut Coordinator, name: &str) {
    let key = (actor(name), Incarnation(1));
    if let Some(membership) = coordinator.roster.membership(&key) {
        coordinator.answered(&key, membership);
    }
}

fn rollout(env_id: u32, iteration: u64, version: u64) -> Rollout {
    Rollout {
        snapshot: vec![iteration as u8],
        ..fakes::rollout(EnvId(env_id), Iteration(iteration), PolicyVersion(version))
    }
}

/// Sends a rollout under an epoch, at most the newest that its actor was given.
fn send(coordinator: &mut Coordinator, name: &str, sequence: u64, epoch: u64, rollout: &Rollout) {
    coordinator.take_orphans();
    let sender = coordinator.roster.sender(&(actor(name), Incarnation(1)));
    let epoch = epoch.min(sender.map_or(0, |sender| sender.ordered.0));
    send_under(coordinator, name, sequence, epoch, rollout);
}

fn send_under(
    coordinator: &mut Coordinator,
    name: &str,
    sequence: u64,
    epoch: u64,
    rollout: &Rollout,
) {
    let payload = codec::encode(rollout).unwrap();
    let header = Header {
        sequence: Sequence(sequence),
        epoch: Epoch(epoch),
        version: rollout.version,
        ..Header::plain(Schema::Rollout, Incarnation(1), &payload)
    };
    coordinator.rollout(actor(name), &header, &payload);
}

/// Takes what is to be done, as far as `pick` wants it.
fn told<T>(coordinator: &mut Coordinator, pick: impl FnMut(Effect) -> Option<T>) -> Vec<T> {
    coordinator.take_effects().into_iter().filter_map(pick).collect()
}

fn assignments(coordinator: &mut Coordinator) -> Vec<(ActorId, Assignment)> {
    told(coordinator, |effect| match effect {
        Effect::Control { to, control: Control::Assign(assignment), .. } => {
            Some((to.0, assignment))
        }
        _ => None,
    })
}

fn credits(coordinator: &mut Coordinator) -> Vec<(u64, u64)> {
    told(coordinator, |effect| match effect {
        Effect::Credit { credit, .. } => Some((credit.acknowledged.0, credit.limit.0)),
        _ => None,
    })
}

fn events(coordinator: &mut Coordinator) -> Vec<RunEvent> {
    told(coordinator, |effect| match effect {
        Effect::Event(event) => Some(event),
        _ => None,
    })
}

fn close_balanced(coordinator: &mut Coordinator) -> Books {
    coordinator.close();
    coordinator.books().check().unwrap();
    coordinator.books().clone()
}

#[test]
fn one_actor_feeds_one_update() {
    let mut c = coordinator(2, Schedule::Lag(0), &["a"]);
    let (_, assignment) = assignments(&mut c).remove(0);
    assert_eq!(assignment.envs.len(), 2);
    join(&mut c, "a");
    assert!(assignments(&mut c).is_empty(), "a token that is reported twice disturbs nobody");
    send(&mut c, "a", 1, 1, &rollout(0, 0, 0));
    assert!(c.next_batch().is_none());
    send(&mut c, "a", 2, 1, &rollout(1, 0, 0));
    assert_eq!(c.next_batch().unwrap().len(), 2);
    c.trained(PolicyVersion(1));
    assert_eq!(credits(&mut c), [(2, 2 + u64::from(WINDOW))]);
    assert_eq!(close_balanced(&mut c).trained, 2);
}

#[test]
fn an_actor_that_answers_no_order_gets_no_environment() {
    let mut c = coordinator(2, Schedule::Lag(0), &["a"]);
    c.take_effects();
    c.hello(&hello("ghost", 0, 1)).unwrap();
    c.joined(actor("ghost"), Incarnation(1));
    let waits = told(&mut c, |effect| match effect {
        Effect::Control { to, control: Control::Wait, .. } => Some(to.0),
        _ => None,
    });
    assert_eq!(waits, [actor("ghost")]);
    let update = |c: &mut Coordinator, number: u64| {
        for env in 0..2 {
            let sequence = 2 * number + u64::from(env) + 1;
            send(c, "a", sequence, 99, &rollout(env, number, number));
        }
        assert_eq!(c.next_batch().unwrap().len(), 2);
        c.trained(PolicyVersion(number + 1));
        assignments(c).into_iter().map(|(to, _)| to).collect::<Vec<_>>()
    };
    assert!(update(&mut c, 0).is_empty());
    answer(&mut c, "ghost");
    assert!(update(&mut c, 1).contains(&actor("ghost")));
}

#[test]
fn an_actor_that_answers_no_order_gets_none_though_nobody_else_should_have_some() {
    let mut c = coordinator(2, Schedule::Lag(0), &["a"]);
    c.take_effects();
    c.stragglers.fail(&actor("a"), 0);
    c.hello(&hello("ghost", 0, 1)).unwrap();
    c.joined(actor("ghost"), Incarnation(1));
    c.rebalance();
    assert!(assignments(&mut c).is_empty(), "it stays with the one that there is");
    answer(&mut c, "ghost");
    c.rebalance();
    let told = assignments(&mut c);
    let given: Vec<(&str, usize)> =
        told.iter().map(|(to, it)| (to.as_str(), it.envs.len())).collect();
    assert_eq!(given, [("a", 0), ("ghost", 2)]);
}

#[test]
fn duplicates_are_counted_and_gaps_wait_for_what_is_missing() {
    let mut c = coordinator(1, Schedule::Lag(2), &["a"]);
    c.take_effects();
    send(&mut c, "a", 1, 1, &rollout(0, 0, 0));
    send(&mut c, "a", 1, 1, &rollout(0, 0, 0));
    send(&mut c, "a", 3, 1, &rollout(0, 2, 0));
    assert_eq!(credits(&mut c), [(1, 5)]);
    send(&mut c, "a", 2, 1, &rollout(0, 1, 0));
    send(&mut c, "a", 3, 1, &rollout(0, 2, 0));
    let books = close_balanced(&mut c);
    assert_eq!((books.duplicates, books.unused_at_end, books.published), (1, 3, 3));
}

#[test]
fn an_actor_with_half_a_window_left_is_credited_with_others_or_at_the_next_tick() {
    let mut c = coordinator(1, Schedule::Lag(9), &["a"]);
    assert_eq!(credits(&mut c), [(0, 4)]);
    let arrives = |c: &mut Coordinator, n: u64| {
        send(c, "a", n, 1, &rollout(0, n - 1, 0));
        credits(c)
    };
    assert_eq!(arrives(&mut c, 1), [], "it may send three more");
    assert_eq!(arrives(&mut c, 2), [(2, 6)]);
    assert_eq!(arrives(&mut c, 3), []);
    c.tick();
    assert_eq!(credits(&mut c), [(3, 7)]);
    assert_eq!(arrives(&mut c, 4), []);
    assert!(c.next_batch().is_some());
    assert_eq!(credits(&mut c), [(4, 8)]);
    c.stop_everyone("the end");
    assert_eq!(arrives(&mut c, 5), [(5, 9)], "who leaves waits for it");
    close_balanced(&mut c);
}

#[test]
fn an_actor_that_leaves_is_replaced_from_the_newest_snapshot_and_no_longer_heard() {
    let mut c = coordinator(2, Schedule::Lag(1), &["a"]);
    send(&mut c, "a", 1, 1, &rollout(0, 0, 0));
    join(&mut c, "b");
    assert_eq!(assignments(&mut c).len(), 1, "the joiner waits for the end of the update");
    c.left(actor("a"), Incarnation(1));
    let (to, assignment) = assignments(&mut c).remove(0);
    assert_eq!((to, assignment.epoch), (actor("b"), Epoch(2)));
    let places: Vec<(u64, usize)> =
        assignment.envs.iter().map(|env| (env.iteration.0, env.snapshot.len())).collect();
    assert_eq!(places, [(1, 1), (0, 0)]);
    send(&mut c, "a", 2, 1, &rollout(1, 0, 0));
    send(&mut c, "b", 1, 2, &rollout(1, 0, 0));
    assert_eq!(c.next_batch().unwrap().len(), 2);
    c.trained(PolicyVersion(1));
    let books = close_balanced(&mut c);
    assert_eq!((books.trained, books.superseded), (2, 1));
}

#[test]
fn a_joiner_gets_its_share_when_an_update_is_done() {
    let mut c = coordinator(2, Schedule::Lag(0), &["a"]);
    c.take_effects();
    join(&mut c, "b");
    for env in 0..2 {
        send(&mut c, "a", u64::from(env) + 1, 1, &rollout(env, 0, 0));
    }
    c.next_batch().unwrap();
    c.trained(PolicyVersion(1));
    let told = assignments(&mut c);
    assert_eq!(told[0].1.keep, [EnvId(0)]);
    assert_eq!(told[1].1.envs[0].env_id, EnvId(1));
    assert_eq!(told[1].1.envs[0].iteration, Iteration(1));
    send(&mut c, "a", 3, 1, &rollout(0, 1, 1));
    assert_eq!(c.n_pending(), 1, "a kept environment's rollout counts although its epoch is old");
    close_balanced(&mut c);
}

#[test]
fn an_environment_that_came_back_ignores_what_was_under_way_before() {
    let mut c = coordinator(1, Schedule::Lag(0), &["a"]);
    c.take_effects();
    c.left(actor("a"), Incarnation(1));
    join(&mut c, "a");
    send(&mut c, "a", 1, 1, &rollout(0, 0, 0));
    assert_eq!(c.books().superseded, 1);
    send(&mut c, "a", 2, 2, &rollout(0, 0, 0));
    assert_eq!(c.n_pending(), 1);
    close_balanced(&mut c);
}

#[test]
fn every_broken_rule_has_its_own_count_and_the_environment_is_given_anew() {
    use RefusalCause as Cause;
    let mut c = coordinator(1, Schedule::Lag(0), &["a"]);
    c.take_effects();
    let mut nan = rollout(0, 0, 0);
    nan.rewards[0] = f32::NAN;
    let mut absurd = rollout(0, 0, 0);
    absurd.rewards[0] = 1e30;
    let bad = [
        (nan, Cause::NonFinite),
        (absurd, Cause::Magnitude),
        (rollout(9, 0, 0), Cause::Assignment),
        (rollout(0, 0, 1), Cause::Version),
    ];
    for (sequence, (rollout, cause)) in (1..).zip(bad) {
        send(&mut c, "a", sequence, 100, &rollout);
        assert_eq!(c.books().refusals.get(&cause), Some(&1), "{cause:?}");
        assert_eq!(assignments(&mut c).len(), 1, "given anew after {cause:?}");
    }
    let payload = codec::encode(&rollout(0, 0, 0)).unwrap();
    let header = |sequence, payload: &[u8]| Header {
        sequence: Sequence(sequence),
        epoch: Epoch(100),
        ..Header::plain(Schema::Rollout, Incarnation(1), payload)
    };
    c.rollout(actor("a"), &header(5, b"else"), &payload);
    c.rollout(actor("a"), &header(6, b"short"), b"short");
    c.rollout(actor("a"), &header(500, &payload), &payload);
    c.rollout(actor("x"), &header(1, &payload), &payload);
    c.refused_by_link(Some(actor("a")), by_link(Cause::Oversize, Some(1)));
    for cause in
        [Cause::Checksum, Cause::Malformed, Cause::Credit, Cause::Stranger, Cause::Oversize]
    {
        assert_eq!(c.books().refusals.get(&cause), Some(&1), "{cause:?}");
    }
    assert_eq!(close_balanced(&mut c).refused, 6);
}

fn by_link(cause: RefusalCause, start: Option<u64>) -> Refusal {
    Refusal { sender: start.map(Incarnation), ..Refusal::new(cause, "refused") }
}

#[test]
fn only_messages_with_a_members_own_start_are_held_against_it() {
    use RefusalCause as Cause;
    let mut c = coordinator(1, Schedule::Lag(0), &["a"]);
    for _ in 0..2 * limits::REFUSALS_BEFORE_CUT_OFF {
        c.refused_by_link(Some(actor("a")), by_link(Cause::Header, None));
        c.refused_by_link(Some(actor("a")), by_link(Cause::Oversize, Some(2)));
    }
    let overflow = ((Some(actor("a")), Cause::Overflow), 3_000);
    c.refused_without_event([overflow]);
    assert_eq!(c.n_actors(), 1, "garbage under its name, and too little room, are not its fault");
    let counted =
        [Cause::Header, Cause::Oversize, Cause::Overflow].map(|cause| c.books().refusals[&cause]);
    assert_eq!(counted, [32, 32, 3_000]);
    for _ in 0..limits::REFUSALS_BEFORE_CUT_OFF {
        c.refused_by_link(Some(actor("a")), by_link(Cause::Oversize, Some(1)));
    }
    assert_eq!(c.n_actors(), 0);
}

#[test]
fn skipping_a_rollout_is_refused() {
    let mut c = coordinator(1, Schedule::Async { staleness_max: 8 }, &["a"]);
    send(&mut c, "a", 1, 1, &rollout(0, 3, 0));
    assert_eq!(close_balanced(&mut c).refusals[&RefusalCause::Assignment], 1);
}

#[test]
fn a_rogue_is_told_why_and_cut_off_and_the_others_go_on() {
    let mut c = coordinator(2, Schedule::Lag(0), &["good"]);
    join(&mut c, "rogue");
    let mut nan = rollout(0, 0, 0);
    nan.next_value = f32::INFINITY;
    let mut told = Vec::new();
    for sequence in 1..=limits::REFUSALS_BEFORE_CUT_OFF + 4 {
        send(&mut c, "rogue", sequence, 100, &nan);
        told.extend(c.take_effects());
    }
    told.retain(|effect| {
        matches!(effect, Effect::Control { control: Control::Stop { cut_off: true, .. }, .. })
    });
    assert_eq!(told.len(), 1);
    assert_eq!(c.n_actors(), 1);
    assert_eq!(c.hello(&hello("rogue", 20, 21)), Err(HelloRefusal::CutOff));
    for env in 0..2 {
        send(&mut c, "good", u64::from(env) + 1, 100, &rollout(env, 0, 0));
    }
    assert_eq!(c.next_batch().unwrap().len(), 2);
    let books = close_balanced(&mut c);
    assert_eq!(books.refused, limits::REFUSALS_BEFORE_CUT_OFF);
}

#[test]
fn a_resumed_learner_rolls_back_what_was_lost_and_supersedes_what_was_made_before() {
    let mut c = coordinator(1, Schedule::Lag(0), &[]);
    assert_eq!(c.hello(&hello("a", 7, 6)), Ok(Sequence(6)));
    c.joined(actor("a"), Incarnation(1));
    answer(&mut c, "a");
    assert_eq!(c.books().rolled_back, 5);
    send(&mut c, "a", 6, 100, &rollout(0, 5, 5));
    send(&mut c, "a", 7, 100, &rollout(0, 0, 0));
    assert_eq!((c.books().superseded, c.books().refused), (2, 0));
    send(&mut c, "a", 8, 1, &rollout(0, 0, 0));
    assert_eq!(c.n_pending(), 1);
    close_balanced(&mut c);
}

#[test]
fn a_copy_of_an_older_hello_takes_nothing_from_the_one_that_counts() {
    let mut c = coordinator(1, Schedule::Lag(0), &[]);
    assert_eq!(c.hello(&hello("a", 3, 1)), Ok(Sequence(1)));
    c.joined(actor("a"), Incarnation(1));
    assert_eq!(c.hello(&hello("a", 8, 6)), Ok(Sequence(6)));
    answer(&mut c, "a");
    assert_eq!(c.books().rolled_back, 5);
    for sequence in 6..=8 {
        send(&mut c, "a", sequence, 100, &rollout(0, 0, 0));
    }
    assert_eq!((c.books().superseded, c.n_pending()), (3, 0), "made for another learner");
    assert_eq!(c.hello(&hello("a", 99, 100)), Err(HelloRefusal::Nonsense));
    send(&mut c, "a", 9, 1, &rollout(0, 0, 0));
    assert_eq!(c.n_pending(), 1);
    close_balanced(&mut c);
}

#[test]
fn a_run_whose_members_answer_no_order_is_said_to_wait_for_actors() {
    let mut c = coordinator(2, Schedule::Lag(0), &[]);
    c.hello(&hello("ghost", 0, 1)).unwrap();
    c.joined(actor("ghost"), Incarnation(1));
    assert_eq!((c.n_actors(), c.n_answering(), c.n_actors_needed()), (1, 0, Some(1)));
    join(&mut c, "a");
    assert_eq!((c.n_actors(), c.n_answering(), c.n_actors_needed()), (2, 1, None));
    assert_eq!(assignments(&mut c).into_iter().map(|(to, _)| to).collect::<Vec<_>>(), [actor("a")]);
    c.left(actor("a"), Incarnation(1));
    assert!(matches!(events(&mut c)[..], [RunEvent::ActorLeft { n_actors: 1, n_envs: 2, .. }]));
    assert_eq!(c.n_actors_needed(), Some(1));
    let mut c = coordinator(1, Schedule::Async { staleness_max: 0 }, &["a"]);
    assert_eq!(c.window(), 2);
    c.hello(&hello("ghost", 0, 1)).unwrap();
    c.joined(actor("ghost"), Incarnation(1));
    assert_eq!(c.window(), 2, "it takes no part of what the others may have on their way");
}

#[test]
fn rollouts_of_who_was_never_a_member_enter_no_books() {
    let mut c = coordinator(1, Schedule::Lag(0), &["a"]);
    let before = c.books().clone();
    c.hello(&hello("stranger", 0, 1)).unwrap();
    send(&mut c, "stranger", 1, 1, &rollout(0, 0, 0));
    assert_eq!(*c.books(), before);
    // Its rollout overtook its token: it comes again and is entered.
    c.joined(actor("stranger"), Incarnation(1));
    send(&mut c, "stranger", 1, 1, &rollout(0, 0, 0));
    assert_eq!(c.books().superseded, before.superseded + 1);
    // Rollouts of an actor that has left are still acknowledged.
    c.left(actor("stranger"), Incarnation(1));
    send(&mut c, "stranger", 2, 1, &rollout(0, 0, 0));
    assert_eq!(c.books().superseded, before.superseded + 2);
    close_balanced(&mut c);
}

#[test]
fn a_full_queue_gives_no_more_credit_until_it_is_used() {
    let mut c = coordinator(1, Schedule::Async { staleness_max: 0 }, &["a"]);
    assert_eq!(credits(&mut c), [(0, 2)], "two updates' worth, not a window");
    send(&mut c, "a", 1, 1, &rollout(0, 0, 0));
    assert_eq!(credits(&mut c), [(1, 2)]);
    send(&mut c, "a", 2, 1, &rollout(0, 1, 0));
    assert_eq!(credits(&mut c), [(2, 2)], "full: the limit stays");
    assert_eq!(c.window(), 1, "who enters now may have one on its way");
    c.next_batch().unwrap();
    c.trained(PolicyVersion(1));
    c.next_batch();
    assert_eq!(credits(&mut c), [(2, 4)]);
    assert_eq!(close_balanced(&mut c).dropped_stale, 1);
}

#[test]
fn async_uses_what_is_made_even_by_actors_that_are_never_slower_than_their_credit() {
    let mut c = coordinator(4, Schedule::Async { staleness_max: 8 }, &[]);
    (c.settings.window, c.settings.actors_min) = (64, 2);
    let mut actors = [("a", [0, 1]), ("b", [2, 3])].map(|(name, envs)| (name, envs, 0_u64, 0_u64));
    for (name, ..) in actors {
        join(&mut c, name);
    }
    for version in 0..50 {
        for effect in c.take_effects() {
            if let Effect::Credit { to, credit } = effect {
                let of_actor = actors.iter_mut().find(|(name, ..)| to == actor(name)).unwrap();
                of_actor.3 = credit.limit.0;
            }
        }
        for (name, envs, made, limit) in &mut actors {
            while *made < *limit {
                let env = envs[(*made % 2) as usize];
                *made += 1;
                let next = c.queue.expected(EnvId(env)).unwrap();
                send(&mut c, name, *made, 100, &rollout(env, next.0, version));
            }
        }
        assert_eq!(c.next_batch().unwrap().len(), 4);
        c.trained(PolicyVersion(version + 1));
    }
    let books = close_balanced(&mut c);
    assert!(20 * books.dropped_stale <= books.published, "{books:?}");
    assert_eq!((books.trained, books.refused), (200, 0));
}

#[test]
fn rollouts_lost_with_a_killed_learner_are_counted_once_and_have_a_limit() {
    let mut c = coordinator(1, Schedule::Lag(0), &[]);
    let (lost, kept) = (MAX_LOST + 1, MAX_UNACKNOWLEDGED + 1);
    // More than a learner loses: the run was begun anew, and so has to be the actor.
    let refused = c.hello(&hello("a", lost, lost + 1)).unwrap_err();
    assert_eq!(refused, HelloRefusal::TooManyLost);
    assert!(refused.to_string().ends_with(": restart it"), "{refused}");
    // One that is too much, and three that contradict themselves.
    for (published, first) in [(kept, 1), (0, 0), (1, 3), (u64::MAX, 1)] {
        assert_eq!(c.hello(&hello("a", published, first)), Err(HelloRefusal::Nonsense));
    }
    assert_eq!(c.books().rolled_back, 0);
    assert_eq!(c.hello(&hello("a", 7, 6)), Ok(Sequence(6)));
    assert_eq!(c.hello(&hello("a", 7, 6)), Ok(Sequence(6)), "the answer may have been lost");
    c.joined(actor("a"), Incarnation(1));
    answer(&mut c, "a");
    assert_eq!(c.hello(&hello("a", 9, 9)), Err(HelloRefusal::Nonsense));
    assert_eq!(c.books().rolled_back, 5);
    close_balanced(&mut c);
}

#[test]
fn hellos_of_another_learners_actor_count_as_no_loss_here() {
    let mut c = coordinator(1, Schedule::Lag(0), &[]);
    for acknowledged in 1..=50 {
        let said = c.hello(&hello("a", acknowledged + 2, acknowledged + 1));
        assert_eq!(said, Ok(Sequence(acknowledged + 1)));
        c.joined(actor("a"), Incarnation(1));
        assert_eq!(credits(&mut c), [(acknowledged, acknowledged + u64::from(WINDOW))]);
    }
    assert_eq!(*c.books(), Books::default(), "it answers the orders of the other one");
    // Its learner is gone, and it works for this one from now on. Its rollouts may overtake its answer.
    send(&mut c, "a", 51, 0, &rollout(0, 0, 0));
    assert_eq!((c.books().rolled_back, c.books().superseded), (50, 1));
    answer(&mut c, "a");
    send(&mut c, "a", 52, 0, &rollout(0, 0, 0));
    send(&mut c, "a", 53, 1, &rollout(0, 0, 0));
    assert_eq!((c.books().rolled_back, c.books().superseded, c.n_pending()), (50, 2, 1));
    close_balanced(&mut c);
}

#[test]
fn strangers_do_not_fill_the_books() {
    let mut c = coordinator(1, Schedule::Lag(0), &[]);
    for i in 0..MAX_LOSERS {
        let name = format!("s{i}");
        c.hello(&hello(&name, 1, 2)).unwrap();
        c.joined(actor(&name), Incarnation(1));
        assert_eq!(c.books().rolled_back, i as u64, "a hello alone is none");
        answer(&mut c, &name);
    }
    assert_eq!(c.hello(&hello("one-more", 1, 2)), Err(HelloRefusal::TooManyLost));
    assert_eq!(c.hello(&hello("honest", 0, 1)), Ok(Sequence(1)));
    assert_eq!(c.books().rolled_back, MAX_LOSERS as u64);
}

#[test]
fn a_name_is_taken_for_as_long_as_its_actor_is_there() {
    let mut c = coordinator(1, Schedule::Lag(0), &["a"]);
    c.take_effects();
    let second = Hello { incarnation: Incarnation(2), ..hello("a", 0, 1) };
    c.joined(actor("a"), Incarnation(2));
    assert_eq!(c.hello(&second), Err(HelloRefusal::Taken));
    assert!(assignments(&mut c).is_empty(), "the first goes on undisturbed");
    c.left(actor("a"), Incarnation(1));
    assert_eq!(c.hello(&second), Ok(Sequence(1)));
    let key = (actor("a"), Incarnation(2));
    let membership = c.roster.membership(&key).unwrap();
    c.answered(&key, membership);
    assert_eq!(assignments(&mut c).len(), 1);
    assert_eq!(c.hello(&hello("a", 0, 1)), Err(HelloRefusal::Taken), "the first is too late");
}

#[test]
fn an_assignment_with_large_snapshots_comes_in_parts() {
    let mut c = coordinator(3, Schedule::Lag(0), &[]);
    let mut places = RolloutQueue::beginning(3);
    for place in &mut places {
        place.snapshot = vec![0; ASSIGNMENT_BYTES / 2];
    }
    c.queue = RolloutQueue::new(Schedule::Lag(0), places);
    join(&mut c, "a");
    let told = assignments(&mut c);
    let shape: Vec<(u64, usize, usize)> =
        told.iter().map(|(_, a)| (a.epoch.0, a.envs.len(), a.keep.len())).collect();
    assert_eq!(shape, [(1, 2, 0), (2, 1, 2)]);
}

#[test]
fn missing_actors_are_counted_before_the_run_and_in_it() {
    let mut c = coordinator(1, Schedule::Lag(0), &[]);
    c.settings.actors_min = 2;
    assert_eq!(c.n_actors_needed(), Some(2));
    join(&mut c, "a");
    assert_eq!(c.n_actors_needed(), Some(2));
    join(&mut c, "b");
    assert_eq!(c.n_actors_needed(), None);
    c.left(actor("a"), Incarnation(1));
    assert_eq!(c.n_actors_needed(), None, "one is enough once it runs");
    c.left(actor("b"), Incarnation(1));
    assert_eq!(c.n_actors_needed(), Some(1));
    c.stop_everyone("done");
    assert_eq!(c.n_actors_needed(), None);
    assert_eq!(c.hello(&hello("c", 0, 1)), Err(HelloRefusal::Closing));
    c.joined(actor("c"), Incarnation(1));
    assert_eq!(c.n_actors(), 0, "nobody is welcome to a run that ends");
}

#[test]
fn a_run_that_ends_during_an_update_accounts_for_its_rollouts_and_moves_nothing() {
    let during_an_update = || {
        let mut c = coordinator(2, Schedule::Lag(0), &["a"]);
        send(&mut c, "a", 1, 1, &rollout(0, 0, 0));
        send(&mut c, "a", 2, 1, &rollout(1, 0, 0));
        assert_eq!(c.next_batch().unwrap().len(), 2);
        // Its share is due when the update is done.
        join(&mut c, "b");
        c.take_effects();
        c.stop_everyone("done");
        let stopped = told(&mut c, |effect| match effect {
            Effect::Control { to, control: Control::Stop { cut_off: false, .. }, .. } => Some(to.0),
            _ => None,
        });
        assert_eq!(stopped, [actor("a"), actor("b")]);
        c.left(actor("a"), Incarnation(1));
        c
    };
    // It is done in time.
    let mut c = during_an_update();
    c.trained(PolicyVersion(1));
    assert!(assignments(&mut c).is_empty(), "nobody is given what another one left");
    assert_eq!(c.places().iter().map(|place| place.iteration.0).collect::<Vec<_>>(), [1, 1]);
    let books = close_balanced(&mut c);
    assert_eq!((books.trained, books.unused_at_end, books.steps_redone), (2, 0, 0));
    // It is not, and is made again after a resume.
    let mut c = during_an_update();
    assert_eq!(c.n_pending(), 2);
    assert_eq!(c.places().iter().map(|place| place.iteration.0).collect::<Vec<_>>(), [0, 0]);
    let books = close_balanced(&mut c);
    assert_eq!((books.trained, books.unused_at_end, books.steps_redone), (0, 2, 0));
}

#[test]
fn another_build_or_class_of_cpu_counts_from_the_admission_on() {
    let mut c = coordinator(1, Schedule::Lag(0), &[]);
    let other = Hello { program: "b".to_owned(), cpu: "other".to_owned(), ..hello("b", 0, 1) };
    for i in 0..500 {
        let stranger = Hello { actor: actor(&format!("s{i}")), ..other.clone() };
        c.hello(&stranger).unwrap();
    }
    join(&mut c, "a");
    assert!(c.builds().is_uniform(), "nobody else is a member");
    assert!(events(&mut c).iter().all(|event| !matches!(event, RunEvent::OtherBuild { .. })));
    c.hello(&other).unwrap();
    for _ in 0..3 {
        c.hello(&other).unwrap();
        c.joined(actor("b"), Incarnation(1));
        c.left(actor("b"), Incarnation(1));
    }
    assert!(!c.builds().is_uniform());
    let told = events(&mut c);
    let is_other = |event: &&RunEvent| matches!(event, RunEvent::OtherBuild { .. });
    assert_eq!(told.iter().filter(is_other).count(), 1, "once");
}

#[test]
fn more_actors_than_environments_are_reported_once() {
    let mut c = coordinator(1, Schedule::Lag(0), &["a", "b", "c"]);
    let is_report = |event: &&RunEvent| matches!(event, RunEvent::TooManyActors { .. });
    assert_eq!(events(&mut c).iter().filter(is_report).count(), 1);
}

#[test]
fn a_mute_member_is_named_and_loses_its_environments_to_the_others() {
    let mut c = coordinator(2, Schedule::Lag(0), &["honest", "mute"]);
    c.take_effects();
    send(&mut c, "honest", 1, 1, &rollout(0, 0, 0));
    (0..100).for_each(|_| c.tick());
    let effects = c.take_effects();
    let named = |effect: &Effect| {
        matches!(effect, Effect::Event(RunEvent::WaitingForRollouts { actor, n_envs: 1, .. })
            if actor.as_str() == "mute")
    };
    assert!(effects.iter().any(named));
    let assigned = effects.iter().filter_map(|effect| match effect {
        Effect::Control { to, control: Control::Assign(assignment), .. } => {
            Some((to.0.as_str(), assignment.envs.len(), assignment.keep.len()))
        }
        _ => None,
    });
    let assigned: Vec<_> = assigned.collect();
    assert_eq!(assigned[..2], [("honest", 1, 1), ("mute", 0, 0)]);
    send(&mut c, "mute", 1, 2, &rollout(1, 0, 0));
    assert_eq!(c.books().superseded, 1, "it wakes up too late");
    send(&mut c, "honest", 2, 100, &rollout(1, 0, 0));
    assert_eq!(c.next_batch().unwrap().len(), 2);
    c.trained(PolicyVersion(1));
    close_balanced(&mut c);
}

#[test]
fn an_actor_that_took_no_control_messages_waits_until_it_gets_environments_again() {
    let mut c = coordinator(2, Schedule::Lag(0), &["a"]);
    join(&mut c, "ghost");
    for n_failures in 1..4 {
        c.rebalance();
        c.give_up(&(actor("ghost"), Incarnation(1)));
        join(&mut c, "ghost");
        c.rebalance();
        let held = |c: &Coordinator| c.assigner.counts(c.roster.members())[&actor("ghost")];
        let n_ticks = (0..1_000).find(|_| {
            c.tick();
            c.rebalance_due && {
                c.rebalance();
                held(&c) > 0
            }
        });
        assert_eq!(n_ticks.map(|n| n + 1), Some(BACK_OFF << (n_failures - 1)));
    }
    c.left(actor("a"), Incarnation(1));
    c.take_effects();
    assert!(!c.assigner.has_orphans(), "with nobody else there it has to do");
}

/// Says that `name` cannot restore an environment that it was just given.
fn cannot_restore(coordinator: &mut Coordinator, name: &str, env_id: u32) {
    coordinator.take_orphans();
    coordinator.cannot_restore(&(actor(name), Incarnation(1)), Epoch(100), &[EnvId(env_id)]);
}

#[test]
fn a_snapshot_that_nobody_restores_is_given_up_and_its_sender_cut_off() {
    let mut c = coordinator(3, Schedule::Lag(0), &["a", "b", "rogue"]);
    send(&mut c, "rogue", 1, 100, &rollout(2, 0, 0));
    c.left(actor("rogue"), Incarnation(1));
    c.take_effects();
    cannot_restore(&mut c, "a", 2);
    let [(first, kept), (to, assignment)] = &assignments(&mut c)[..] else { panic!("two orders") };
    assert_eq!((first, kept.envs.len()), (&actor("a"), 0));
    assert_eq!((to, assignment.envs[0].snapshot.len()), (&actor("b"), 1), "b is to try it");
    cannot_restore(&mut c, "b", 2);
    let effects = c.take_effects();
    let again = effects.iter().find_map(|effect| match effect {
        Effect::Control { to, control: Control::Assign(assignment), .. } => Some((to, assignment)),
        _ => None,
    });
    let (to, assignment) = again.unwrap();
    assert_eq!((&to.0, assignment.envs[0].iteration), (&actor("b"), Iteration(0)), "made again");
    let cut = |effect: &Effect| matches!(effect, Effect::Event(RunEvent::CutOff { actor, .. }) if actor.as_str() == "rogue");
    assert!(effects.iter().any(cut));
    assert_eq!(c.hello(&hello("rogue", 1, 2)), Err(HelloRefusal::CutOff));
    cannot_restore(&mut c, "a", 2);
    assert!(c.take_effects().is_empty(), "it does not have the environment any more");
    for (sequence, (name, env)) in [(1, ("a", 0)), (1, ("b", 1)), (2, ("b", 2))] {
        send(&mut c, name, sequence, 100, &rollout(env, 0, 0));
    }
    assert_eq!(c.next_batch().unwrap().len(), 3);
    c.trained(PolicyVersion(1));
    let books = close_balanced(&mut c);
    assert_eq!((books.refused, books.refusals[&RefusalCause::Snapshot]), (1, 1));
    assert!(!books.has_fresh_episodes(), "the same is made again");
}

#[test]
fn a_snapshot_of_a_checkpoint_that_the_only_actor_cannot_restore_becomes_a_fresh_episode() {
    let mut c = coordinator(1, Schedule::Lag(0), &[]);
    let place = EnvAssignment { env_id: EnvId(0), iteration: Iteration(0), snapshot: vec![1] };
    c.queue = RolloutQueue::new(Schedule::Lag(0), vec![place]);
    join(&mut c, "a");
    c.take_effects();
    cannot_restore(&mut c, "a", 0);
    let (_, assignment) = assignments(&mut c).remove(0);
    assert_eq!(assignment.envs[0].snapshot, Vec::<u8>::new());
    assert_eq!(c.places()[0].snapshot, Vec::<u8>::new(), "the next checkpoint is whole");
    assert_eq!(c.n_actors(), 1);
    let books = close_balanced(&mut c);
    assert_eq!(books.refusals[&RefusalCause::FreshEpisode], 1);
    assert!(books.has_fresh_episodes(), "other numbers are trained on than without it");
}

#[test]
fn an_actor_that_cannot_restore_what_another_can_is_at_fault() {
    let mut c = coordinator(2, Schedule::Lag(0), &["good", "stale"]);
    cannot_restore(&mut c, "stale", 1);
    c.take_effects();
    send(&mut c, "good", 1, 100, &rollout(1, 0, 0));
    let wary = |event: &RunEvent| matches!(event, RunEvent::Distrusted { actor, .. } if actor.as_str() == "stale");
    assert!(events(&mut c).iter().any(wary));
    assert_eq!((c.n_actors(), c.books().refusals.len()), (2, 0));
}

#[test]
fn a_checkpoint_during_an_update_holds_what_was_before_it() {
    let mut c = coordinator(1, Schedule::Lag(1), &["a"]);
    for iteration in 0..2 {
        send(&mut c, "a", iteration + 1, 1, &rollout(0, iteration, 0));
    }
    c.next_batch().unwrap();
    c.trained(PolicyVersion(1));
    c.next_batch().unwrap();
    assert_eq!((c.places()[0].iteration, c.n_pending()), (Iteration(1), 1));
    c.trained(PolicyVersion(2));
    assert_eq!((c.places()[0].iteration, c.n_pending()), (Iteration(2), 0));
}

#[test]
fn environments_of_actors_lost_together_are_given_once() {
    let mut c = coordinator(4, Schedule::Lag(0), &["a", "b", "c", "d"]);
    c.take_effects();
    for name in ["a", "b", "c"] {
        c.left(actor(name), Incarnation(1));
    }
    let told = assignments(&mut c);
    assert_eq!(told.len(), 1, "{told:?}");
    assert_eq!((&told[0].0, told[0].1.envs.len(), told[0].1.keep.len()), (&actor("d"), 3, 1));
    assert!(assignments(&mut c).is_empty());
    let mut c = coordinator(4, Schedule::Lag(0), &["a", "b", "c", "d"]);
    let told = assignments(&mut c);
    assert_eq!(
        told.iter().map(|(_, it)| it.envs.len()).collect::<Vec<_>>(),
        [1; 4],
        "as for joining"
    );
}

#[test]
fn a_lost_actor_is_a_member_again_after_another_hello() {
    let mut c = coordinator(2, Schedule::Lag(0), &["a", "b"]);
    c.take_effects();
    c.left(actor("a"), Incarnation(1));
    c.joined(actor("a"), Incarnation(1));
    assert_eq!(c.n_actors(), 1, "its token is back, but it takes no orders yet");
    c.hello(&hello("a", 0, 1)).unwrap();
    assert_eq!(c.n_actors(), 2);
    c.left(actor("a"), Incarnation(1));
    c.hello(&hello("a", 0, 1)).unwrap();
    assert_eq!(c.n_actors(), 1, "a hello that overtook its token");
    c.joined(actor("a"), Incarnation(1));
    assert_eq!(c.n_actors(), 2);
}

/// Returns the membership of the only assignment that is to be sent.
fn membership(coordinator: &mut Coordinator) -> MembershipNumber {
    let memberships = told(coordinator, |effect| match effect {
        Effect::Control { membership, control: Control::Assign(_), .. } => Some(membership),
        _ => None,
    });
    let [membership] = memberships[..] else { panic!("{memberships:?}") };
    membership
}

#[test]
fn an_order_that_was_not_acknowledged_before_a_loss_does_not_end_the_next_membership() {
    let mut c = coordinator(1, Schedule::Lag(0), &["a"]);
    let key = (actor("a"), Incarnation(1));
    let before = membership(&mut c);
    c.left(actor("a"), Incarnation(1));
    join(&mut c, "a");
    let now = membership(&mut c);
    assert!(now > before && c.is_current(&key, now) && !c.is_current(&key, before));
    c.silent(&key, before);
    assert_eq!(c.n_actors(), 1);
    c.silent(&key, now);
    assert_eq!(c.n_actors(), 0);
    assert!(!c.is_current(&key, now));
}

#[test]
fn an_actor_on_a_foreign_assignment_gets_its_environments_anew_under_a_higher_number() {
    let mut c = coordinator(1, Schedule::Lag(0), &["a"]);
    let key = (actor("a"), Incarnation(1));
    let first = membership(&mut c);
    c.astray(&key, first, Epoch(1 << 40));
    let effects = c.take_effects();
    let is_told = |effect: &&Effect| matches!(effect, Effect::Event(RunEvent::Astray { told, .. }) if told.0 == 1 << 40);
    assert_eq!(effects.iter().filter(is_told).count(), 1);
    let is_again = |effect: &&Effect| matches!(effect, Effect::Control { control: Control::Assign(it), .. } if it.epoch.0 == (1 << 40) + 1);
    assert_eq!(effects.iter().filter(is_again).count(), 1);
    assert_eq!(c.epoch(), Epoch(2), "to nobody else that number means anything");
    // Its rollouts tell the same as its answers, and do not count.
    send_under(&mut c, "a", 1, 1 << 41, &rollout(0, 0, 0));
    let (_, again) = assignments(&mut c).remove(0);
    assert_eq!((again.epoch, again.envs.len()), (Epoch((1 << 41) + 1), 1));
    send(&mut c, "a", 2, again.epoch.0, &rollout(0, 0, 0));
    assert_eq!(c.next_batch().unwrap().len(), 1);
    c.trained(PolicyVersion(1));
    assert_eq!(close_balanced(&mut c).superseded, 1);
}

#[test]
fn an_actor_told_the_highest_number_has_to_say_hello_again() {
    let mut c = coordinator(1, Schedule::Lag(0), &["a"]);
    let key = (actor("a"), Incarnation(1));
    let first = membership(&mut c);
    c.astray(&key, first, Epoch(u64::MAX));
    assert_eq!((c.n_actors(), c.epoch()), (0, Epoch(1)), "nobody counts on from there");
    c.hello(&hello("a", 0, 1)).unwrap();
    answer(&mut c, "a");
    let (_, again) = assignments(&mut c).remove(0);
    assert_eq!((again.epoch, again.envs.len()), (Epoch(2), 1), "at once: it did nothing wrong");
    send(&mut c, "a", 1, 2, &rollout(0, 0, 0));
    assert_eq!(c.n_pending(), 1);
}

#[test]
fn an_actor_that_goes_astray_again_and_again_is_given_up() {
    let mut c = coordinator(1, Schedule::Lag(0), &["a"]);
    let key = (actor("a"), Incarnation(1));
    let first = membership(&mut c);
    for _ in 0..=MAX_ASTRAY {
        assert_eq!(c.n_actors(), 1);
        c.astray(&key, first, Epoch(0));
    }
    assert_eq!(c.n_actors(), 0);
}

#[test]
fn a_member_that_lost_its_environments_gets_them_again_when_it_asks() {
    let mut c = coordinator(1, Schedule::Lag(0), &["a"]);
    c.take_effects();
    send(&mut c, "a", 1, 1, &rollout(0, 0, 0));
    c.next_batch().unwrap();
    c.trained(PolicyVersion(1));
    (0..IDLE_TICKS - 1).for_each(|_| c.tick());
    c.hello(&hello("a", 1, 2)).unwrap();
    assert!(assignments(&mut c).is_empty(), "it has delivered something a moment ago");
    c.tick();
    c.hello(&hello("a", 2, 2)).unwrap();
    assert!(assignments(&mut c).is_empty(), "something of it is on its way");
    c.hello(&hello("a", 0, 1)).unwrap();
    assert!(assignments(&mut c).is_empty(), "somebody kept this one");
    c.hello(&hello("a", 1, 2)).unwrap();
    let (_, again) = assignments(&mut c).remove(0);
    assert_eq!((again.epoch, again.envs[0].iteration), (Epoch(2), Iteration(1)));
    let key = (actor("a"), Incarnation(1));
    let membership = c.roster.membership(&key).unwrap();
    for n_ticks in [0, IDLE_TICKS - 1] {
        (0..n_ticks).for_each(|_| c.tick());
        c.followed(&key, membership, again.epoch);
        c.hello(&hello("a", 1, 2)).unwrap();
        assert!(assignments(&mut c).is_empty(), "a moment ago, whatever it says it has done since");
    }
    assert!(c.roster_entries()[0].silent_s > IDLE_TICKS as f64 * TICK.as_secs_f64());
    c.tick();
    c.hello(&hello("a", 1, 2)).unwrap();
    assert_eq!(assignments(&mut c).len(), 1);
}

#[test]
fn a_member_that_has_nothing_to_do_has_not_lost_its_environments() {
    let asks = |c: &mut Coordinator| {
        (0..IDLE_TICKS).for_each(|_| c.tick());
        c.hello(&hello("a", 1, 2)).unwrap();
        assignments(c).len()
    };
    let mut c = coordinator(1, Schedule::Lag(0), &["a"]);
    c.take_effects();
    send(&mut c, "a", 1, 1, &rollout(0, 0, 0));
    assert_eq!(asks(&mut c), 0, "what it has made waits");
    c.next_batch().unwrap();
    assert_eq!(asks(&mut c), 0, "the update takes long");
    c.trained(PolicyVersion(1));
    c.hello(&hello("a", 1, 2)).unwrap();
    assert!(assignments(&mut c).is_empty(), "said before it could have the new weights");
    assert_eq!(asks(&mut c), 1);
    // In `async` it waits for no weights, and there may always be an update under way.
    let mut c = coordinator(1, Schedule::Async { staleness_max: 8 }, &["a"]);
    c.take_effects();
    send(&mut c, "a", 1, 1, &rollout(0, 0, 0));
    c.next_batch().unwrap();
    assert_eq!(asks(&mut c), 1);
}
