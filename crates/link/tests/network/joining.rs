//! Finding a run, being welcome or not, and addresses that do not work.

use std::error::Error as _;
use std::time::{Duration, Instant};

use leadtime_link::keys::Key;
use leadtime_link::{
    ActorLink, ConnectSettings, Endpoint, Error, LearnerLink, ListenSettings, RUN_IS_ENDING,
};
use leadtime_proto::header::Schema;
use leadtime_proto::message::HelloReply;
use leadtime_proto::{Header, RefusalCause};

use crate::support::*;

const SHORT: Duration = Duration::from_millis(300);

fn to(endpoint: &Endpoint, timeout: Duration) -> ConnectSettings {
    ConnectSettings { timeout, ..ConnectSettings::new(vec![endpoint.clone()]) }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_learner_on_port_zero_tells_the_port_it_got() {
    let settings = ListenSettings::new(vec!["tcp/127.0.0.1:0".parse().unwrap()]);
    let (learner, events) =
        LearnerLink::open(&run("one"), DOMAIN, &learner_start(), &settings).await.unwrap();
    let locator: Endpoint = learner.locators()[0].parse().unwrap();
    assert!(!locator.as_str().ends_with(":0"), "{locator}");
    let (actor, _events) =
        ActorLink::open(&to(&locator, SOON), &actor_id("a"), &start("a")).await.unwrap();
    say_hello(&actor, "a", &events).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_actor_may_be_there_before_its_learner() {
    let site = Site::new();
    let (early, late) = tokio::join!(site.actor("a"), site.learner());
    assert_eq!(say_hello(&early.0, "a", &late.1).await, welcome("one"));
}

#[tokio::test(flavor = "multi_thread")]
async fn one_of_several_runs_at_an_address_has_to_be_named() {
    let site = Site::new();
    let _router = site.raw("router").await;
    let through =
        ListenSettings { connect: vec![site.endpoint.clone()], ..ListenSettings::new(Vec::new()) };
    let (_one, events) =
        LearnerLink::open(&run("one"), DOMAIN, &learner_start(), &through).await.unwrap();
    let (_two, _) =
        LearnerLink::open(&run("two"), DOMAIN, &learner_start(), &through).await.unwrap();
    let (actor, _events) = site.actor("a").await;
    let said = hello("a");

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
    let error = ActorLink::open(&to(&site.endpoint, SHORT), &actor_id("a"), &start("a")).await;
    let error = error.map(drop).unwrap_err();
    assert!(matches!(error, Error::Unreachable { timeout, .. } if timeout == SHORT), "{error}");
    assert!(error.to_string().contains(site.endpoint.as_str()), "{error}");
    assert!(error.to_string().contains("there is no such socket"), "{error}");
    assert!((SHORT..SOON).contains(&started.elapsed()), "{:?}", started.elapsed());

    let _router = site.raw("router").await;
    let (actor, _events) = site.actor("a").await;
    let error = actor.hello(None, &hello("a"), SHORT).await.unwrap_err();
    assert!(matches!(error, Error::NoLearner { .. }), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_address_in_use_is_named() {
    let site = Site::new();
    let (_learner, _events) = site.learner().await;
    let any = ListenSettings::new(vec!["tcp/127.0.0.1:0".parse().unwrap()]);
    let (first, _events) =
        LearnerLink::open(&run("one"), DOMAIN, &learner_start(), &any).await.unwrap();
    for taken in [site.endpoint.as_str(), &first.locators()[0]] {
        let error = listen_error(taken).await;
        assert!(matches!(&error, Error::AddressInUse { .. }), "{error}: {:?}", error.source());
    }
    // Of two, only the one that is taken is blamed.
    let free = tempfile::tempdir().unwrap();
    let free = format!("unixsock-stream/{}", free.path().join("z").display());
    let taken = first.locators().remove(0);
    let error = listen_error_at(&[&free, &taken]).await.to_string();
    assert!(error.starts_with(&format!("--listen: `{taken}` is in use: ")), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_address_of_another_machine_is_told_as_that() {
    // It is kept for documentation: no machine has it.
    let error = listen_error("tcp/192.0.2.1:7447").await;
    let told = "--listen: this machine has no address 192.0.2.1: listen on one of its own, or on 0.0.0.0 for all";
    assert_eq!(error.to_string(), told);
}

/// Opens a learner where none can be.
async fn listen_error(endpoint: &str) -> Error {
    listen_error_at(&[endpoint]).await
}

async fn listen_error_at(endpoints: &[&str]) -> Error {
    let endpoints = endpoints.iter().map(|endpoint| endpoint.parse().unwrap());
    let settings = ListenSettings::new(endpoints.collect());
    let opened = LearnerLink::open(&run("two"), DOMAIN, &learner_start(), &settings).await;
    opened.map(drop).unwrap_err()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_file_where_the_socket_is_to_be_is_not_removed_and_a_missing_directory_reported() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("policy.safetensors");
    std::fs::write(&path, b"precious").unwrap();
    let there = format!("unixsock-stream/{}", path.display());
    assert!(matches!(listen_error(&there).await, Error::NotASocket { .. }));
    assert_eq!(std::fs::read(&path).unwrap(), b"precious");
    assert!(matches!(listen_error("unixsock-stream//no/such/dir/z").await, Error::Listen { .. }));
}

#[tokio::test(flavor = "multi_thread")]
async fn an_actor_that_is_not_wanted_is_told_why() {
    let site = Site::new();
    let (_learner, events) = site.learner().await;
    let (actor, _actor_events) = site.actor("a").await;
    let (said, no) = (hello("a"), HelloReply::Refused { reason: "name is taken".to_owned() });
    let (answer, ()) = tokio::join!(actor.hello(None, &said, SOON), answer_next(&events, &no));
    let error = answer.unwrap_err();
    assert!(
        matches!(&error, Error::Refused { reason, .. } if reason == "name is taken"),
        "{error}"
    );
    let (header, payload) = rollout("a", 1);
    let error = actor.publish_rollout(&header, payload).unwrap_err();
    assert!(matches!(error, Error::NotInARun { .. }), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_actor_that_comes_when_its_run_is_ending_is_told_so() {
    let site = Site::new();
    let (_learner, events) = site.learner().await;
    let (actor, _actor_events) = site.actor("a").await;
    let (said, no) = (hello("a"), HelloReply::Refused { reason: RUN_IS_ENDING.to_owned() });
    let (answer, ()) = tokio::join!(actor.hello(None, &said, SOON), answer_next(&events, &no));
    let error = answer.unwrap_err();
    assert!(matches!(&error, Error::Ending { run: of } if *of == run("one")), "{error}");
    assert_eq!(error.to_string(), "run `one`: the run is ending: nothing is left to do");
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
            header[12] = 77; // The protocol.
            let reply = query.reply(query.key_expr().clone(), Vec::new()).attachment(header);
            zenoh::Wait::wait(reply).unwrap();
        })
        .await
        .unwrap();
    let alive = Key::Alive(&run("one"), &leadtime_link::keys::Member::Learner, LEARNER).to_string();
    let _token = foreign.liveliness().declare_token(&alive).await.unwrap();
    let (actor, _events) = site.actor("a").await;
    let error = actor.hello(None, &hello("a"), SOON).await.unwrap_err();
    let Error::BadAnswer { source, .. } = error else { panic!("{error}") };
    assert_eq!(source.cause, RefusalCause::Protocol);
    assert!(source.to_string().contains("protocol 77"), "{source}");
}
