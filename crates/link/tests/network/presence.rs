//! Coming and going, on both sides.

use leadtime_link::{ActorEvent, ActorLink, Error, LearnerEvent, LearnerLink};
use leadtime_proto::{Incarnation, PolicyVersion};

use crate::support::*;

async fn joined(events: &LearnerEvents, id: &str) -> Incarnation {
    until(events, |event| match event {
        LearnerEvent::Joined { actor, incarnation } => {
            (actor == actor_id(id)).then_some(incarnation)
        }
        _ => None,
    })
    .await
}

async fn left(events: &LearnerEvents, id: &str) -> Incarnation {
    until(events, |event| match event {
        LearnerEvent::Left { actor, incarnation } => (actor == actor_id(id)).then_some(incarnation),
        _ => None,
    })
    .await
}

#[tokio::test(flavor = "multi_thread")]
async fn an_actor_that_goes_is_missed_and_one_that_returns_is_another_start() {
    let site = Site::new();
    let (_learner, events) = site.learner().await;
    let (actor, _actor_events) = site.actor("a").await;
    // Its presence is told before its hello, so a learner hears of the end of everyone it welcomed.
    let said = hello("a", ACTOR);
    let greet = async {
        let first = joined(&events, "a").await;
        welcome_next(&events).await;
        first
    };
    let (answer, first) = tokio::join!(actor.hello(None, &said, SOON), greet);
    answer.unwrap();
    assert_eq!(first, ACTOR);
    drop(actor);
    assert_eq!(left(&events, "a").await, ACTOR);

    let again = Incarnation(201);
    let (actor, _actor_events) =
        ActorLink::open(&site.connect(), &actor_id("a"), again).await.unwrap();
    let said = hello("a", again);
    let greet = async {
        let second = joined(&events, "a").await;
        welcome_next(&events).await;
        second
    };
    let (answer, second) = tokio::join!(actor.hello(None, &said, SOON), greet);
    answer.unwrap();
    assert_eq!(second, again);
    actor.close().await.unwrap();
    assert_eq!(left(&events, "a").await, again);
}

#[tokio::test(flavor = "multi_thread")]
async fn actors_outlive_their_learner_and_greet_the_next_one() {
    let site = Site::new();
    let (learner, events) = site.learner().await;
    let (actor, actor_events) = site.welcomed("a", &events).await;
    until(&actor_events, |event| match event {
        ActorEvent::LearnerJoined(incarnation) => (incarnation == LEARNER).then_some(()),
        _ => None,
    })
    .await;

    learner.close().await.unwrap();
    drop((learner, events));
    until(&actor_events, |event| match event {
        ActorEvent::LearnerLeft(incarnation) => (incarnation == LEARNER).then_some(()),
        _ => None,
    })
    .await;
    assert!(matches!(
        actor.pull_weights(PolicyVersion(0), [0; 32]).await.unwrap_err(),
        Error::NoAnswer { .. }
    ));

    let next = Incarnation(101);
    let (learner, events) =
        LearnerLink::open(&run("one"), DOMAIN, next, &site.listen()).await.unwrap();
    learner.offer_weights(PolicyVersion(1), b"resumed".as_slice().into()).unwrap();
    until(&actor_events, |event| match event {
        ActorEvent::LearnerJoined(incarnation) => (incarnation == next).then_some(()),
        _ => None,
    })
    .await;
    say_hello(&actor, "a", ACTOR, &events).await;
    assert_eq!(pull(&actor, &learner, 1).await.unwrap(), b"resumed");
    let (header, payload) = rollout(1);
    actor.publish_rollout(&header, payload).unwrap();
    until(&events, |event| match event {
        LearnerEvent::Rollout { header: got, .. } => (got == header).then_some(()),
        _ => None,
    })
    .await;
}
