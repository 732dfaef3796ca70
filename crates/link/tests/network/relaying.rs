//! What a learner that listens passes on: everything but the rollouts of its run, which are for itself.

use std::time::Duration;

use leadtime_link::{
    ActorLink, ConnectSettings, LearnerLink, ListenSettings, RouterLink, StartKey,
};
use leadtime_proto::message::{HelloReply, Welcome};

use crate::support::*;

/// Has an actor deliver one rollout, and waits until a learner has it.
async fn delivers(actor: &ActorLink, id: &str, sequence: u64, events: &LearnerEvents) {
    let (header, payload) = rollout(id, sequence);
    actor.publish_rollout(&header, payload).unwrap();
    let (sender, arrived, _) = next_rollout(events).await;
    assert_eq!((sender, arrived), (actor_id(id), header));
}

/// Says hello to one of several runs, whose learner welcomes the actor.
async fn joins(
    actor: &ActorLink,
    id: &str,
    name: &str,
    (learner, events): (&LearnerLink, &LearnerEvents),
) {
    let welcome = Welcome { weights: learner.announcement(), ..welcome(name) };
    let (hello, name, answer) = (hello(id), run(name), HelloReply::Welcome(Box::new(welcome)));
    let said = actor.hello(Some(&name), &hello, SOON);
    let (said, ()) = tokio::join!(said, answer_next(events, &answer));
    said.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reader_of_everything_is_sent_no_rollouts() {
    let unix = Site::new();
    // To the library's rules a peer that comes by TCP is another subject.
    for listen in [unix.listen(), ListenSettings::new(vec!["tcp/127.0.0.1:0".parse().unwrap()])] {
        reader_is_sent_no_rollouts(&listen).await;
    }
}

async fn reader_is_sent_no_rollouts(listen: &ListenSettings) {
    let (learner, events) =
        LearnerLink::open(&run("one"), DOMAIN, &learner_start(), listen).await.unwrap();
    let endpoint: leadtime_link::Endpoint = learner.locators()[0].parse().unwrap();
    let reader = raw_at("client", endpoint.as_str()).await;
    let (sender, heard) = flume::bounded(1_024);
    let mut held = Vec::new();
    for keys in ["**", "leadtime/1/*/traj/**", "leadtime/1/one/traj/cue_recall/a"] {
        let sender = sender.clone();
        let take = move |sample: zenoh::sample::Sample| {
            sender.try_send(sample.key_expr().to_string()).unwrap_or_default();
        };
        held.push(reader.declare_subscriber(keys).callback(take).await.unwrap());
    }
    look_at(&reader).await;
    let connect = ConnectSettings { timeout: SOON, ..ConnectSettings::new(vec![endpoint]) };
    let (actor, _told) = ActorLink::open(&connect, &actor_id("a"), &start("a")).await.unwrap();
    say_hello(&actor, "a", &events).await;
    for sequence in 1..=8 {
        delivers(&actor, "a", sequence, &events).await;
    }
    // Metrics come after the rollouts, which go first; they may be dropped, so they are repeated.
    let wait = async {
        loop {
            actor.publish_metrics(b"{}").unwrap();
            let next = tokio::time::timeout(Duration::from_millis(50), heard.recv_async());
            let Ok(key) = next.await else { continue };
            let key = key.unwrap();
            assert!(!key.contains("/traj/"), "{key}");
            if key.ends_with("/metrics/actor/a") {
                return;
            }
        }
    };
    tokio::time::timeout(SOON, wait).await.expect("everything else is passed on");
}

#[tokio::test(flavor = "multi_thread")]
async fn rollouts_of_another_run_reach_their_learner_through_one_that_listens() {
    let site = Site::new();
    let (one, events) = site.learner().await;
    let through =
        ListenSettings { connect: vec![site.endpoint.clone()], ..ListenSettings::new(Vec::new()) };
    let other = StartKey::numbered(101);
    let (two, events_of_two) =
        LearnerLink::open(&run("two"), DOMAIN, &other, &through).await.unwrap();
    let (near, _told) = site.actor("a").await;
    joins(&near, "a", "one", (&one, &events)).await;
    let (far, _told) = site.actor("b").await;
    joins(&far, "b", "two", (&two, &events_of_two)).await;
    for sequence in 1..=4 {
        delivers(&near, "a", sequence, &events).await;
        delivers(&far, "b", sequence, &events_of_two).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_learner_that_listens_below_a_router_has_the_rollouts_of_both_sides() {
    let site = Site::new();
    let any = ListenSettings::new(vec!["tcp/127.0.0.1:0".parse().unwrap()]);
    let router = RouterLink::open(&any).await.unwrap();
    let above: leadtime_link::Endpoint = router.locators()[0].parse().unwrap();
    let both = ListenSettings { connect: vec![above.clone()], ..site.listen() };
    let (_learner, events) =
        LearnerLink::open(&run("one"), DOMAIN, &learner_start(), &both).await.unwrap();
    let (near, _near_events) = site.welcomed("near", &events).await;
    let through = ConnectSettings { timeout: SOON, ..ConnectSettings::new(vec![above]) };
    let (far, _far_events) =
        ActorLink::open(&through, &actor_id("far"), &start("far")).await.unwrap();
    say_hello(&far, "far", &events).await;
    for sequence in 1..=4 {
        delivers(&near, "near", sequence, &events).await;
        delivers(&far, "far", sequence, &events).await;
    }
}
