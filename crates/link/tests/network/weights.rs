//! Weights: announced, pulled, kept, and refused when damaged.

use leadtime_link::keys::{Key, Member};
use leadtime_link::{ActorEvent, ActorLink, Error};
use leadtime_proto::header::Schema;
use leadtime_proto::message::{Announcement, HelloReply};
use leadtime_proto::{Header, PolicyVersion, RefusalCause, codec};
use zenoh::Wait as _;
use zenoh::liveliness::LivelinessToken;
use zenoh::query::Query;

use crate::support::*;

async fn announced(events: &ActorEvents, version: u64) -> Announcement {
    until(events, |event| match event {
        ActorEvent::Announcement(news) => (news.version.0 == version).then_some(news),
        _ => None,
    })
    .await
}

#[tokio::test(flavor = "multi_thread")]
async fn weights_are_announced_and_pulled() {
    let site = Site::new();
    let (learner, events) = site.learner().await;
    let (actor, actor_events) = site.welcomed("a", &events).await;
    learner.offer_weights(PolicyVersion(1), b"first").unwrap();
    let news = announced(&actor_events, 1).await;
    assert_eq!((news.learner, news.size), (LEARNER, 5));
    assert_eq!(actor.pull_weights(None).await.unwrap(), (PolicyVersion(1), b"first".to_vec()));
}

#[tokio::test(flavor = "multi_thread")]
async fn older_versions_can_be_pulled_until_they_are_retired() {
    let site = Site::new();
    let (learner, events) = site.learner().await;
    let (actor, _actor_events) = site.welcomed("a", &events).await;
    assert!(matches!(actor.pull_weights(None).await.unwrap_err(), Error::Rejected { .. }));
    for version in 1..=3 {
        learner.offer_weights(PolicyVersion(version), &vec![version as u8; 70_000]).unwrap();
    }
    let pulled = actor.pull_weights(Some(PolicyVersion(2))).await.unwrap();
    assert_eq!(pulled, (PolicyVersion(2), vec![2; 70_000]));
    learner.retire_weights(PolicyVersion(3));
    let error = actor.pull_weights(Some(PolicyVersion(2))).await.unwrap_err();
    assert!(error.to_string().contains("versions 3 to 3 are"), "{error}");
    assert_eq!(actor.pull_weights(None).await.unwrap().0, PolicyVersion(3));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_late_joiner_is_told_by_the_repetition_and_pulls() {
    let site = Site::new();
    let (learner, events) = site.learner().await;
    learner.offer_weights(PolicyVersion(9), b"newest").unwrap();
    let (actor, actor_events) = site.welcomed("late", &events).await;
    assert_eq!(actor.pull_weights(None).await.unwrap().1, b"newest");
    announced(&actor_events, 9).await;
}

/// A learner that answers pulls as it is told.
async fn foreign_learner(
    site: &Site,
    attachment: Vec<u8>,
    payload: Vec<u8>,
) -> ((zenoh::Session, LivelinessToken), ActorLink) {
    let session = site.raw("peer").await;
    let reply = move |query: Query, attachment: Vec<u8>, payload: Vec<u8>| {
        query.reply(query.key_expr().clone(), payload).attachment(attachment).wait().unwrap();
    };
    let body = codec::encode(&HelloReply::Welcome(Box::new(welcome("one")))).unwrap();
    let header = Header::plain(Schema::HelloReply, LEARNER, &body).to_bytes().to_vec();
    let (name, domain) = (run("one"), domain());
    session
        .declare_queryable(Key::Hello(&name).to_string())
        .callback(move |query| reply(query, header.clone(), body.clone()))
        .background()
        .await
        .unwrap();
    session
        .declare_queryable(Key::Weights(&name, &domain).to_string())
        .callback(move |query| reply(query, attachment.clone(), payload.clone()))
        .background()
        .await
        .unwrap();
    let alive = Key::Alive(&name, &Member::Learner, LEARNER).to_string();
    let token = session.liveliness().declare_token(alive).await.unwrap();
    let (actor, _events) = site.actor("a").await;
    actor.hello(None, &hello("a", ACTOR), SOON).await.unwrap();
    ((session, token), actor)
}

#[tokio::test(flavor = "multi_thread")]
async fn weights_with_a_wrong_digest_are_not_used() {
    let site = Site::new();
    let header = Header::plain(Schema::Weights, LEARNER, b"weights").to_bytes();
    let attachment = [header.as_slice(), &[0; 32]].concat();
    let (_learner, actor) = foreign_learner(&site, attachment, b"weights".to_vec()).await;
    let error = actor.pull_weights(None).await.unwrap_err();
    assert!(matches!(error, Error::WeightsDamaged { version: PolicyVersion(0) }), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn weights_that_changed_on_the_way_are_not_used() {
    let site = Site::new();
    let header = Header::plain(Schema::Weights, LEARNER, b"weights").to_bytes();
    let attachment = [header.as_slice(), &[0; 32]].concat();
    let (_learner, actor) = foreign_learner(&site, attachment, b"wEights".to_vec()).await;
    let error = actor.pull_weights(None).await.unwrap_err();
    let Error::BadAnswer { source, .. } = error else { panic!("{error}") };
    assert_eq!(source.cause(), RefusalCause::Checksum);
}

#[tokio::test(flavor = "multi_thread")]
async fn weights_without_a_digest_are_not_used() {
    let site = Site::new();
    let header = Header::plain(Schema::Weights, LEARNER, b"weights").to_bytes();
    let (_learner, actor) = foreign_learner(&site, header.to_vec(), b"weights".to_vec()).await;
    let error = actor.pull_weights(None).await.unwrap_err();
    let Error::BadAnswer { source, .. } = error else { panic!("{error}") };
    assert_eq!(source.cause(), RefusalCause::Header);
}
