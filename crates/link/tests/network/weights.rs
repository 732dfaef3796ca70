//! Weights: announced, pulled, kept, and taken only if they are the announced ones.

use leadtime_link::keys::Key;
use leadtime_link::{ActorEvent, Error};
use leadtime_proto::header::Schema;
use leadtime_proto::message::Announcement;
use leadtime_proto::{Header, PolicyVersion};
use zenoh::Wait as _;
use zenoh::query::Query;

use crate::support::*;

async fn announced(events: &ActorEvents, version: u64) -> Announcement {
    until(events, |event| match event {
        ActorEvent::Announcement(news) => (news.newest().0 == version).then_some(news),
        _ => None,
    })
    .await
}

#[tokio::test(flavor = "multi_thread")]
async fn weights_are_announced_with_their_digest_and_pulled() {
    let site = Site::new();
    let (learner, events) = site.learner().await;
    let (actor, actor_events) = site.welcomed("a", &events).await;
    assert!(matches!(pull(&actor, &learner, 1).await.unwrap_err(), Error::NotKept { .. }));
    learner.offer_weights(PolicyVersion(1), b"first".as_slice().into()).unwrap();
    let news = announced(&actor_events, 1).await;
    assert_eq!(news, learner.announcement());
    assert_eq!(actor.pull_weights(PolicyVersion(1), news.versions[0].1).await.unwrap(), b"first");

    // Older ones can be pulled until they are retired.
    for version in 1..=6 {
        learner.offer_weights(PolicyVersion(version), vec![version as u8; 70_000].into()).unwrap();
    }
    assert_eq!(pull(&actor, &learner, 2).await.unwrap(), vec![2; 70_000]);
    learner.retire_weights(PolicyVersion(6));
    let error = pull(&actor, &learner, 2).await.unwrap_err();
    assert!(error.to_string().contains("versions 3 to 6 are"), "{error}");
    assert_eq!(pull(&actor, &learner, 6).await.unwrap(), vec![6; 70_000]);

    // An actor that joins late hears of them by the repetition.
    let (late, late_events) = site.welcomed("late", &events).await;
    announced(&late_events, 6).await;
    assert_eq!(pull(&late, &learner, 6).await.unwrap(), vec![6; 70_000]);
}

/// Answers every pull, faster than the learner or not, as an intruder would.
async fn answer_pulls(site: &Site, attachment: Vec<u8>, payload: &'static [u8]) -> zenoh::Session {
    let session = site.raw("client").await;
    session
        .declare_queryable(Key::Weights(&run("one"), &domain()).to_string())
        .complete(true)
        .callback(move |query: Query| {
            let reply = query.reply(query.key_expr().clone(), payload);
            reply.attachment(attachment.clone()).wait().unwrap();
        })
        .background()
        .await
        .unwrap();
    session
}

fn header(payload: &[u8]) -> Vec<u8> {
    let version = PolicyVersion(4);
    let header = Header { version, ..Header::plain(Schema::Weights, LEARNER, payload) };
    header.to_bytes().to_vec()
}

#[tokio::test(flavor = "multi_thread")]
async fn an_answer_of_another_process_to_a_pull_is_not_taken_for_the_learners() {
    let site = Site::new();
    let (learner, events) = site.learner().await;
    let (actor, _actor_events) = site.welcomed("a", &events).await;
    let intruders = [
        answer_pulls(&site, header(b"false"), b"false").await,
        answer_pulls(&site, header(b"whole"), b"wh0le").await,
        answer_pulls(&site, Vec::new(), b"rubbish").await,
    ];
    let error = actor.pull_weights(PolicyVersion(4), [0; 32]).await.unwrap_err();
    assert!(matches!(error, Error::NotKept { .. }), "the learner's no says more: {error}");
    learner.offer_weights(PolicyVersion(4), b"true".as_slice().into()).unwrap();
    for _ in 0..50 {
        assert_eq!(pull(&actor, &learner, 4).await.unwrap(), b"true");
    }
    drop(intruders);
}
