//! Finding a run, being welcome or not, and addresses that do not work.

use std::error::Error as _;
use std::time::{Duration, Instant};

use leadtime_link::keys::Key;
use leadtime_link::{
    ActorLink, ConnectSettings, Endpoint, Error, LearnerEvent, LearnerLink, ListenSettings,
};
use leadtime_proto::header::{PROTOCOL_VERSION, Schema};
use leadtime_proto::{Header, RefusalCause, codec};

use crate::support::*;

const SHORT: Duration = Duration::from_millis(300);

fn to(endpoint: &Endpoint, timeout: Duration) -> ConnectSettings {
    ConnectSettings { timeout, ..ConnectSettings::new(vec![endpoint.clone()]) }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_actor_finds_the_only_run_and_is_welcome() {
    let site = Site::new();
    let (_learner, events) = site.learner().await;
    let (actor, _actor_events) = site.actor("a").await;
    assert_eq!(say_hello(&actor, "a", ACTOR, &events).await, welcome("one"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_learner_on_port_zero_tells_the_port_it_got() {
    let settings = ListenSettings::new(vec!["tcp/127.0.0.1:0".parse().unwrap()]);
    let (learner, events) =
        LearnerLink::open(&run("one"), DOMAIN, LEARNER, &settings).await.unwrap();
    let locator: Endpoint = learner.locators()[0].parse().unwrap();
    assert!(!locator.as_str().ends_with(":0"), "{locator}");
    let (actor, _events) =
        ActorLink::open(&to(&locator, SOON), &actor_id("a"), ACTOR).await.unwrap();
    say_hello(&actor, "a", ACTOR, &events).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_actor_may_be_there_before_its_learner() {
    let site = Site::new();
    let (early, late) = tokio::join!(site.actor("a"), site.learner());
    say_hello(&early.0, "a", ACTOR, &late.1).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn of_several_runs_at_one_address_one_has_to_be_named() {
    let site = Site::new();
    let _router = site.raw("router").await;
    let through =
        ListenSettings { connect: vec![site.endpoint.clone()], ..ListenSettings::new(Vec::new()) };
    let (_one, events) = LearnerLink::open(&run("one"), DOMAIN, LEARNER, &through).await.unwrap();
    let (_two, _) = LearnerLink::open(&run("two"), DOMAIN, LEARNER, &through).await.unwrap();
    let (actor, _events) = site.actor("a").await;
    let said = hello("a", ACTOR);

    let error = actor.hello(None, &said, SOON).await.unwrap_err();
    let Error::SeveralRuns { runs, .. } = error else { panic!("{error}") };
    assert_eq!(runs, [run("one"), run("two")]);

    let missing = run("three");
    let error = actor.hello(Some(&missing), &said, SHORT).await.unwrap_err();
    let Error::RunNotFound { run: named, present, .. } = error else { panic!("{error}") };
    assert_eq!((named, present), (missing, vec![run("one"), run("two")]));

    let one = run("one");
    let (said, ()) = tokio::join!(actor.hello(Some(&one), &said, SOON), welcome_next(&events));
    assert_eq!(said.unwrap().run, one);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_address_without_a_learner_is_told_from_one_without_anybody() {
    let site = Site::new();
    let started = Instant::now();
    let error = ActorLink::open(&to(&site.endpoint, SHORT), &actor_id("a"), ACTOR).await;
    let error = error.map(drop).unwrap_err();
    assert!(matches!(error, Error::Unreachable { timeout, .. } if timeout == SHORT), "{error}");
    assert!(error.to_string().contains(site.endpoint.as_str()), "{error}");
    assert!(error.to_string().contains("there is no such socket"), "{error}");
    assert!((SHORT..SOON).contains(&started.elapsed()), "{:?}", started.elapsed());

    let _router = site.raw("router").await;
    let (actor, _events) = site.actor("a").await;
    let error = actor.hello(None, &hello("a", ACTOR), SHORT).await.unwrap_err();
    assert!(matches!(error, Error::NoLearner { .. }), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_address_in_use_is_named() {
    let site = Site::new();
    let (_learner, _events) = site.learner().await;
    let second = LearnerLink::open(&run("two"), DOMAIN, LEARNER, &site.listen()).await;
    let error = second.map(drop).unwrap_err();
    assert!(matches!(&error, Error::AddressInUse { .. }), "{error}: {:?}", error.source());

    let any = ListenSettings::new(vec!["tcp/127.0.0.1:0".parse().unwrap()]);
    let (first, _events) = LearnerLink::open(&run("one"), DOMAIN, LEARNER, &any).await.unwrap();
    let taken = ListenSettings::new(vec![first.locators()[0].parse().unwrap()]);
    let second = LearnerLink::open(&run("two"), DOMAIN, LEARNER, &taken).await;
    let error = second.map(drop).unwrap_err();
    assert!(matches!(&error, Error::AddressInUse { .. }), "{error}: {:?}", error.source());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_file_where_the_socket_is_to_be_is_not_removed() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("policy.safetensors");
    std::fs::write(&path, b"precious").unwrap();
    let there = format!("unixsock-stream/{}", path.display()).parse().unwrap();
    let settings = ListenSettings::new(vec![there]);
    let opened = LearnerLink::open(&run("one"), DOMAIN, LEARNER, &settings).await;
    let error = opened.map(drop).unwrap_err();
    assert!(matches!(&error, Error::NotASocket { .. }), "{error}");
    assert_eq!(std::fs::read(&path).unwrap(), b"precious");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_socket_that_cannot_be_made_is_reported() {
    let missing = ListenSettings::new(vec!["unixsock-stream//no/such/dir/z".parse().unwrap()]);
    let opened = LearnerLink::open(&run("one"), DOMAIN, LEARNER, &missing).await;
    let error = opened.map(drop).unwrap_err();
    assert!(matches!(&error, Error::Listen { .. }), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_actor_that_is_not_wanted_is_told_why() {
    let site = Site::new();
    let (_learner, events) = site.learner().await;
    let (actor, _actor_events) = site.actor("a").await;
    let refuse = async {
        let reply = until(&events, |event| match event {
            LearnerEvent::Hello { reply, .. } => Some(reply),
            _ => None,
        });
        reply.await.refuse("name is taken").unwrap();
    };
    let said = hello("a", ACTOR);
    let (answer, ()) = tokio::join!(actor.hello(None, &said, SOON), refuse);
    let error = answer.unwrap_err();
    assert!(
        matches!(&error, Error::Refused { reason, .. } if reason == "name is taken"),
        "{error}"
    );
    let (header, payload) = rollout(1);
    let error = actor.publish_rollout(&header, payload).unwrap_err();
    assert!(matches!(error, Error::NotInARun { .. }), "{error}");
}

/// Where the header says which protocol it is.
const PROTOCOL_AT: usize = 12;

#[tokio::test(flavor = "multi_thread")]
async fn a_learner_tells_an_actor_of_another_release() {
    let site = Site::new();
    let (learner, events) = site.learner().await;
    let intruder = site.raw("client").await;
    let payload = codec::encode(&hello("a", ACTOR)).unwrap();
    let mut header = Header::plain(Schema::Hello, ACTOR, &payload).to_bytes();
    header[PROTOCOL_AT] = 77;
    let answers =
        intruder.get(Key::Hello(&run("one")).to_string()).payload(payload).attachment(header);
    let answer = answers.await.unwrap().recv_async().await.unwrap();
    let sentence = answer.result().unwrap_err().payload().try_to_string().unwrap().into_owned();
    assert_eq!(
        sentence,
        format!(
            "the message has protocol 77, its receiver speaks {PROTOCOL_VERSION}: \
             run the same release on both sides"
        )
    );
    let refusal = until(&events, |event| match event {
        LearnerEvent::Refused { refusal, .. } => Some(refusal),
        _ => None,
    });
    let refusal = refusal.await;
    assert_eq!((refusal.cause, refusal.sender), (RefusalCause::Protocol, None));
    assert_eq!(refusal.to_string(), sentence);
    assert!(learner.take_uncounted().is_empty(), "it was an event");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_actor_tells_of_a_learner_of_another_release() {
    let site = Site::new();
    let foreign = site.raw("peer").await;
    let key = Key::Hello(&run("one")).to_string();
    let _queryable = foreign
        .declare_queryable(&key)
        .callback(|query| {
            let mut header = Header::plain(Schema::HelloReply, LEARNER, b"").to_bytes();
            header[PROTOCOL_AT] = 77;
            let reply = query.reply(query.key_expr().clone(), Vec::new()).attachment(header);
            zenoh::Wait::wait(reply).unwrap();
        })
        .await
        .unwrap();
    let alive = Key::Alive(&run("one"), &leadtime_link::keys::Member::Learner, LEARNER).to_string();
    let _token = foreign.liveliness().declare_token(&alive).await.unwrap();
    let (actor, _events) = site.actor("a").await;
    let error = actor.hello(None, &hello("a", ACTOR), SOON).await.unwrap_err();
    let Error::BadAnswer { source, .. } = error else { panic!("{error}") };
    assert_eq!(source.cause, RefusalCause::Protocol);
    assert!(source.to_string().contains("protocol 77"), "{source}");
}
