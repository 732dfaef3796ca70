//! Coming and going, on both sides.

use leadtime_link::keys::Key;
use leadtime_link::{
    ActorEvent, ActorLink, Error, LearnerEvent, LearnerLink, ListenSettings, StartKey,
};
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

#[tokio::test(flavor = "multi_thread")]
async fn a_faster_answer_to_a_hello_does_not_take_an_actor_from_its_learner() {
    let site = Site::new();
    let (_learner, events) = site.learner().await;
    let (actor, actor_events) = site.welcomed("a", &events).await;
    let through =
        ListenSettings { connect: vec![site.endpoint.clone()], ..ListenSettings::new(Vec::new()) };
    let other = StartKey::numbered(101);
    let (_rival, rival_events) =
        LearnerLink::open(&run("one"), DOMAIN, &other, &through).await.unwrap();
    hear_of(&actor_events, other.incarnation(), true).await;
    let (said, no) = (hello("a"), HelloReply::Refused { reason: "enough".to_owned() });
    let answers = async {
        answer_next(&rival_events, &no).await;
        welcome_next(&events).await;
    };
    let (answer, ()) = tokio::join!(actor.hello(None, &said, SOON), answers);
    assert_eq!(answer.unwrap(), welcome("one"));

    // Where the learner says nothing, the other one counts: it may be the next learner of the run.
    let answers = async {
        answer_next(&rival_events, &no).await;
        drop(next_hello(&events).await);
    };
    let (answer, ()) = tokio::join!(actor.hello(None, &said, SOON), answers);
    assert!(matches!(answer.unwrap_err(), Error::Refused { .. }));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_no_that_proves_nothing_turns_away_only_who_was_never_welcome() {
    let site = Site::new();
    let (_learner, events) = site.learner().await;
    let (known, _known_events) = site.welcomed("a", &events).await;
    let (newcomer, _newcomer_events) = site.actor("b").await;
    let intruder = site.raw("client").await;
    let key = Key::Hello(&run("one")).to_string();
    let hellos = intruder.declare_queryable(key).await.unwrap();
    look_at(&intruder).await;
    let say_no = async || {
        let question = hellos.recv_async().await.unwrap();
        question.reply_err("go away").await.unwrap();
        drop(question);
        drop(next_hello(&events).await);
    };
    let said = hello("a");
    let (answer, ()) = tokio::join!(known.hello(None, &said, SOON), say_no());
    assert!(matches!(answer.unwrap_err(), Error::Rejected { reason, .. } if reason == "go away"));
    let said = hello("b");
    let (answer, ()) = tokio::join!(newcomer.hello(None, &said, SOON), say_no());
    assert!(matches!(answer.unwrap_err(), Error::Refused { reason, .. } if reason == "go away"));
}

#[tokio::test(flavor = "multi_thread")]
async fn an_actor_hears_the_news_of_its_own_learner_alone() {
    let site = Site::new();
    let (learner, events) = site.learner().await;
    let (_actor, actor_events) = site.welcomed("a", &events).await;
    let through =
        ListenSettings { connect: vec![site.endpoint.clone()], ..ListenSettings::new(Vec::new()) };
    let other = StartKey::numbered(101);
    let (rival, _rival_events) =
        LearnerLink::open(&run("one"), DOMAIN, &other, &through).await.unwrap();
    hear_of(&actor_events, other.incarnation(), true).await;
    for version in 1..=3 {
        rival.offer_weights(PolicyVersion(version), b"forged".as_slice().into()).unwrap();
    }
    learner.offer_weights(PolicyVersion(1), b"own".as_slice().into()).unwrap();
    let news = until(&actor_events, |event| match event {
        ActorEvent::Announcement(news) => Some(news),
        _ => None,
    });
    assert_eq!(news.await, learner.announcement());
}
