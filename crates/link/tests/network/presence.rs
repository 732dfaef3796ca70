//! Coming and going, on both sides.

use leadtime_link::{ActorEvent, ActorLink, Error, LearnerEvent, LearnerLink, StartKey};
use leadtime_proto::message::{Hello, HelloReply, Welcome};
use leadtime_proto::{Incarnation, PolicyVersion};

use crate::support::*;

/// Waits for the first start of "a" that comes, or goes.
async fn next_start(events: &LearnerEvents, comes: bool) -> Incarnation {
    until(events, |event| match event {
        LearnerEvent::Joined(actor, start) if comes => (actor == actor_id("a")).then_some(start),
        LearnerEvent::Left(actor, start) if !comes => (actor == actor_id("a")).then_some(start),
        _ => None,
    })
    .await
}

/// Waits until a learner is there, or gone.
async fn hear_of(events: &ActorEvents, learner: Incarnation, comes: bool) {
    until(events, |event| match event {
        ActorEvent::LearnerJoined(start) if comes => (start == learner).then_some(()),
        ActorEvent::LearnerLeft(start) if !comes => (start == learner).then_some(()),
        _ => None,
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_actor_that_goes_is_missed_and_one_that_returns_is_another_start() {
    let site = Site::new();
    let (_learner, events) = site.learner().await;
    for start in [start("a"), start("again")] {
        let incarnation = start.incarnation();
        let (actor, _actor_events) =
            ActorLink::open(&site.connect(), &actor_id("a"), &start).await.unwrap();
        // Its presence is told before its hello, so a learner hears of the end of everyone it welcomed.
        let said = Hello { incarnation, ..hello("a") };
        let greet = async {
            assert_eq!(next_start(&events, true).await, incarnation);
            welcome_next(&events).await;
        };
        let (answer, ()) = tokio::join!(actor.hello(None, &said, SOON), greet);
        answer.unwrap();
        // Killed the first time, and in good order the second.
        if incarnation != self::start("a").incarnation() {
            actor.close().await.unwrap();
        }
        drop(actor);
        assert_eq!(next_start(&events, false).await, incarnation);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn actors_outlive_their_learner_and_greet_the_next_one() {
    let site = Site::new();
    let (learner, events) = site.learner().await;
    let (actor, actor_events) = site.welcomed("a", &events).await;
    hear_of(&actor_events, LEARNER, true).await;

    learner.close().await.unwrap();
    drop((learner, events));
    hear_of(&actor_events, LEARNER, false).await;
    assert!(matches!(
        actor.pull_weights(PolicyVersion(0), [0; 32]).await.unwrap_err(),
        Error::NoAnswer { .. }
    ));

    let next = StartKey::numbered(101);
    let (learner, events) =
        LearnerLink::open(&run("one"), DOMAIN, &next, &site.listen()).await.unwrap();
    learner.offer_weights(PolicyVersion(1), b"resumed".as_slice().into()).unwrap();
    hear_of(&actor_events, next.incarnation(), true).await;
    let welcome = Welcome { weights: learner.announcement(), ..welcome("one") };
    let (said, answer) = (hello("a"), HelloReply::Welcome(Box::new(welcome)));
    let (said, ()) = tokio::join!(actor.hello(None, &said, SOON), answer_next(&events, &answer));
    said.unwrap();
    assert_eq!(pull(&actor, &learner, 1).await.unwrap(), b"resumed");
    let (header, payload) = rollout("a", 1);
    actor.publish_rollout(&header, payload).unwrap();
    assert_eq!(next_rollout(&events).await.1, header);
}
