//! Rollouts, orders, credit and metrics, each from end to end.

use std::sync::Arc;
use std::time::Duration;

use leadtime_link::keys::{Key, Member};
use leadtime_link::{ActorEvent, Archive, Error, ObserverEvent, ObserverLink};
use leadtime_proto::message::{Assignment, Control, ControlReply, Credit, EnvAssignment};
use leadtime_proto::receive::{self, ROLLOUT};
use leadtime_proto::{
    EnvId, Epoch, Incarnation, Iteration, PolicyVersion, Rollout, Sequence, codec,
};
use zenoh::query::QueryTarget;

use crate::support::*;

#[tokio::test(flavor = "multi_thread")]
async fn a_rollout_arrives_with_its_header_and_can_be_opened() {
    let site = Site::new();
    let (_learner, events) = site.learner().await;
    let (actor, _actor_events) = site.welcomed("a", &events).await;
    let (sent_header, sent) = rollout("a", 7);
    actor.publish_rollout(&sent_header, sent.clone()).unwrap();
    let (sender, header, payload) = next_rollout(&events).await;
    assert_eq!((sender, header), (actor_id("a"), sent_header));
    let opened: Rollout = receive::open(&header, &payload, ROLLOUT).unwrap();
    assert_eq!(codec::encode(&opened).unwrap(), sent);

    // One of many fragments arrives whole.
    let rollout = Rollout { observations: vec![0.25; 300_000], n_steps: 2, ..Rollout::default() };
    let payload = codec::encode(&rollout).unwrap();
    let header = leadtime_proto::Header::plain(ROLLOUT.schema, start("a").incarnation(), &payload);
    actor.publish_rollout(&header, payload.into()).unwrap();
    let (_, header, payload) = next_rollout(&events).await;
    assert_eq!(receive::open::<Rollout>(&header, &payload, ROLLOUT).unwrap(), rollout);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_order_is_acknowledged_or_ends_in_time() {
    let site = Site::new();
    let (learner, events) = site.learner().await;
    let (_actor, actor_events) = site.welcomed("a", &events).await;
    let answer = ControlReply::CannotRestore { epoch: Epoch(3), envs: vec![EnvId(4)] };
    let env =
        EnvAssignment { env_id: EnvId(4), iteration: Iteration(2), snapshot: vec![9; 200_000] };
    let assignment = Assignment { epoch: Epoch(3), envs: vec![env], keep: vec![EnvId(1)] };
    let (id, order) = (actor_id("a"), Control::Assign(assignment));
    let a = start("a").incarnation();
    let (got, taken) =
        tokio::join!(learner.control(&id, a, &order, SOON), obey_next(&actor_events, &answer));
    assert_eq!(got.unwrap(), answer);
    assert_eq!(taken, order);

    let short = Duration::from_millis(200);
    let absent = learner.control(&actor_id("b"), a, &order, short).await;
    assert!(matches!(absent.unwrap_err(), Error::NoAnswer { timeout, .. } if timeout == short));

    // The order waits in the queue of an actor that does not look.
    let silent = learner.control(&id, a, &order, short).await;
    assert!(matches!(silent.unwrap_err(), Error::NoAnswer { .. }));
    drop(actor_events);

    // An earlier start that never said hello here.
    let earlier = learner.control(&id, Incarnation(1), &order, SOON).await;
    assert!(matches!(earlier.unwrap_err(), Error::NoAnswer { .. }));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stored_answer_does_not_answer_a_later_order() {
    let site = Site::new();
    let (learner, events) = site.learner().await;
    let (_actor, actor_events) = site.welcomed("a", &events).await;
    let (id, a) = (actor_id("a"), start("a").incarnation());
    let (listener, giver) = (site.raw("client").await, site.raw("client").await);
    let key = Key::Control(&run("one"), &id).to_string();
    let orders = listener.declare_queryable(key.as_str()).await.unwrap();
    look_at(&listener).await;
    let order = |epoch| {
        Control::Assign(Assignment { epoch: Epoch(epoch), envs: Vec::new(), keep: Vec::new() })
    };
    let follow = |epoch| ControlReply::Followed { epoch: Epoch(epoch) };

    // The listener sees an order; the giver gives it once more, and gets an answer that proves its start.
    let copy = async {
        let seen = orders.recv_async().await.unwrap();
        let payload = seen.payload().unwrap().to_bytes().into_owned();
        let header = seen.attachment().unwrap().to_bytes().into_owned();
        let place = format!("{key}?{}", seen.parameters());
        drop(seen);
        obey_next(&actor_events, &follow(1)).await;
        let again = giver.get(place).payload(payload).attachment(header).target(QueryTarget::All);
        let answers = again.await.unwrap();
        obey_next(&actor_events, &follow(1)).await;
        drop(orders.recv_async().await.unwrap());
        answers.recv_async().await.unwrap().into_result().unwrap()
    };
    let first = order(1);
    let (answer, kept) = tokio::join!(learner.control(&id, a, &first, SOON), copy);
    assert_eq!(answer.unwrap(), follow(1));

    let forge = async {
        let seen = orders.recv_async().await.unwrap();
        let header = kept.attachment().unwrap().to_bytes().into_owned();
        let body = kept.payload().to_bytes().into_owned();
        seen.reply(key.as_str(), body).attachment(header).await.unwrap();
        drop(seen);
        look_at(&listener).await;
        obey_next(&actor_events, &follow(2)).await;
    };
    let second = order(2);
    let (answer, ()) = tokio::join!(learner.control(&id, a, &second, SOON), forge);
    assert_eq!(answer.unwrap(), follow(2));
}

#[tokio::test(flavor = "multi_thread")]
async fn credit_reaches_the_start_it_is_meant_for() {
    let site = Site::new();
    let (learner, events) = site.learner().await;
    let (_actor, actor_events) = site.welcomed("a", &events).await;
    let credit = |incarnation, limit| Credit {
        incarnation,
        learner: LEARNER,
        acknowledged: Sequence(1),
        limit: Sequence(limit),
    };
    learner.send_credit(&actor_id("a"), credit(Incarnation(1), 50)).unwrap();
    let a = start("a").incarnation();
    learner.send_credit(&actor_id("a"), credit(a, 5)).unwrap();
    let first = until(&actor_events, |event| match event {
        ActorEvent::Credit(credit) => Some(credit),
        _ => None,
    });
    assert_eq!(first.await, credit(a, 5));
}

#[tokio::test(flavor = "multi_thread")]
async fn an_observer_reads_metrics_presence_and_announcements() {
    let site = Site::new();
    let (learner, events) = site.learner().await;
    let (observer, seen) = ObserverLink::open(&site.connect()).await.unwrap();
    assert!(observer.runs().await.unwrap().contains(&run("one")));
    observer.follow(&run("one")).unwrap();
    let (actor, _actor_events) = site.welcomed("a", &events).await;
    let (member, a) = (Member::Actor(actor_id("a")), start("a").incarnation());
    until(&seen, |event| match event {
        ObserverEvent::Joined(who, start) => (who == member && start == a).then_some(()),
        _ => None,
    })
    .await;

    learner.offer_weights(PolicyVersion(4), b"weights".as_slice().into()).unwrap();
    let announced = until(&seen, |event| match event {
        ObserverEvent::Announcement { domain, announcement } => Some((domain, announcement)),
        _ => None,
    })
    .await;
    assert_eq!(announced, (domain(), learner.announcement()));
    let (version, sha256) = announced.1.versions[0];
    let pulled = observer.pull_weights(&run("one"), &domain(), version, sha256).await.unwrap();
    assert_eq!((version, pulled), (PolicyVersion(4), b"weights".to_vec()));

    actor.publish_metrics(b"{\"steps\":1}").unwrap();
    learner.publish_metrics(b"{}").unwrap();
    let mut expected =
        vec![(member.clone(), b"{\"steps\":1}".to_vec()), (Member::Learner, b"{}".to_vec())];
    until(&seen, |event| {
        if let ObserverEvent::Metrics { member, json, .. } = event {
            expected.retain(|one| *one != (member.clone(), json.clone()));
        }
        expected.is_empty().then_some(())
    })
    .await;

    drop(actor);
    until(&seen, |event| match event {
        ObserverEvent::Left(who, _) => (who == member).then_some(()),
        _ => None,
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_observer_is_told_what_a_run_is_and_how_it_went() {
    let site = Site::new();
    let (mut learner, _events) = site.learner().await;
    let (observer, _seen) = ObserverLink::open(&site.connect()).await.unwrap();
    let found = observer.find_run(&site.connect(), None).await.unwrap();
    assert_eq!(found, run("one"));
    // One question at a time: the second waits, and is answered as well.
    let (begin, begun) = flume::bounded::<()>(2);
    let (go, gone) = flume::bounded::<()>(2);
    let history = move |from: u64, n_points: usize| match from {
        7 => Err("the disk is gone".to_owned()),
        8 => Ok(vec![0; (1 << 20) + 1]),
        _ => {
            begin.send(()).unwrap();
            gone.recv().unwrap();
            Ok(format!("{from} {n_points}").into_bytes())
        }
    };
    let archive = Archive { about: b"{}".to_vec(), history: Arc::new(history) };
    learner.answer_observers(archive).unwrap();
    let about = observer.ask_about(&run("one")).await.unwrap();
    assert_eq!(about, (LEARNER, b"{}".to_vec()));
    let one_at_a_time = async {
        begun.recv_async().await.unwrap();
        assert!(begun.is_empty(), "the second waits");
        go.send(()).unwrap();
        begun.recv_async().await.unwrap();
        go.send(()).unwrap();
    };
    let name = run("one");
    let (first, second, ()) = tokio::join!(
        observer.ask_history(&name, 1, 10),
        observer.ask_history(&name, 2, 20),
        one_at_a_time,
    );
    let told = [first, second].map(|answer| String::from_utf8(answer.unwrap().1).unwrap());
    assert_eq!(told, ["1 10", "2 20"]);
    for (from, n_points, reason) in
        [(7, 10, "the disk is gone"), (8, 10, "too large"), (1, 0, "1 to 4000 points")]
    {
        let refused = observer.ask_history(&name, from, n_points).await.unwrap_err();
        assert!(
            matches!(&refused, Error::Rejected { reason: why, .. } if why.contains(reason)),
            "{refused}"
        );
    }
    let missing = observer.find_run(&site.connect(), Some(run("two"))).await.unwrap_err();
    assert!(matches!(missing, Error::RunNotFound { .. }), "{missing}");
}
