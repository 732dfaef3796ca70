//! What an intruder can send to a learner, and what becomes of it.

use leadtime_link::keys::{Key, Member};
use leadtime_link::{ActorEvent, Error, LearnerEvent};
use leadtime_proto::header::{PROTOCOL_VERSION, Schema};
use leadtime_proto::limits::{MAX_ROLLOUT_BYTES, REFUSALS_BEFORE_CUT_OFF};
use leadtime_proto::message::Credit;
use leadtime_proto::receive::{self, ROLLOUT};
use leadtime_proto::{ActorId, Header, PolicyVersion, Refusal, RefusalCause, Rollout, Sequence};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use zenoh::Session;
use zenoh::qos::CongestionControl;

use crate::support::*;

/// An attachment, a payload, and why they are refused.
type Case<'a> = (Option<Vec<u8>>, &'a [u8], RefusalCause);

/// Bytes behind a rollout that prove whose it is.
const TAG_PROOF_BYTES: usize = 64;

async fn put(session: &Session, key: &str, attachment: Option<Vec<u8>>, payload: &[u8]) {
    // Waits for room: by default a message of many fragments is dropped on a busy machine.
    let message = session.put(key, payload).congestion_control(CongestionControl::Block);
    match attachment {
        Some(attachment) => message.attachment(attachment).await.unwrap(),
        None => message.await.unwrap(),
    }
}

async fn refused(events: &LearnerEvents) -> (Option<ActorId>, Refusal) {
    until(events, |event| match event {
        LearnerEvent::Refused { actor, refusal, .. } => Some((actor, refusal)),
        LearnerEvent::Rollout { header, .. } => panic!("{header:?} was taken"),
        _ => None,
    })
    .await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_message_that_is_not_a_rollout_is_refused_with_its_cause_before_it_is_read() {
    let site = Site::new();
    let (learner, events) = site.learner().await;
    let intruder = site.raw("client").await;
    let (name, domain, rogue) = (run("one"), domain(), actor_id("rogue"));
    let key = Key::Rollouts(&name, &domain, &rogue).to_string();
    let (header, payload) = rollout("rogue", 1);
    let good = header.to_bytes();

    let mut foreign = good;
    foreign[12] = 9;
    let rogue_start = start("rogue").incarnation();
    let credit = Header::plain(Schema::Credit, rogue_start, &payload).to_bytes();
    let huge = vec![0; MAX_ROLLOUT_BYTES + TAG_PROOF_BYTES + 1];
    let unproved = [&payload[..], &[0; TAG_PROOF_BYTES]].concat();
    let cases = [
        (None, &payload[..], RefusalCause::Header),
        (Some(b"garbage".to_vec()), b"garbage".as_slice(), RefusalCause::Header),
        (Some(vec![0; 48]), &payload, RefusalCause::Header),
        (Some(foreign.to_vec()), &payload, RefusalCause::Protocol),
        (Some(credit.to_vec()), &payload, RefusalCause::Schema),
        (Some(good.to_vec()), &huge, RefusalCause::Oversize),
        (Some(good.to_vec()), &unproved, RefusalCause::Stranger),
    ];
    let refuses = async |cases: &[Case<'_>]| {
        for (attachment, payload, cause) in cases {
            put(&intruder, &key, attachment.clone(), payload).await;
            let (actor, refusal) = refused(&events).await;
            // Whatever number the header has, nobody is blamed for it.
            assert_eq!((actor, refusal.cause, refusal.sender), (Some(rogue.clone()), *cause, None));
        }
    };
    refuses(&cases).await;
    // From now on somebody of that name, and with that number, may be.
    let (_member, _member_events) = site.welcomed("rogue", &events).await;
    refuses(&cases[..6]).await;
    let cases = [&unproved, &unproved[1..], &payload[..], &[]];
    for message in cases {
        refuses(&[(Some(good.to_vec()), message, RefusalCause::Proof)]).await;
    }
    let elsewhere = key.replace("rogue", "ROGUE");
    put(&intruder, &elsewhere, Some(good.to_vec()), &payload).await;
    let (actor, refusal) = refused(&events).await;
    assert_eq!((actor, refusal.cause), (None, RefusalCause::Key));

    assert!(learner.take_uncounted().is_empty(), "each was an event");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_payload_that_is_not_the_headers_is_refused_when_opened() {
    let site = Site::new();
    let (_learner, events) = site.learner().await;
    let (actor, _actor_events) = site.welcomed("a", &events).await;
    let (header, payload) = rollout("a", 1);
    let mut damaged = payload.to_vec();
    damaged[3] ^= 0x10;
    let a = start("a").incarnation();
    let garbage = Header::plain(Schema::Rollout, a, b"garbage");
    let cases = [
        (header, damaged, RefusalCause::Checksum),
        (garbage, b"garbage".to_vec(), RefusalCause::Malformed),
    ];
    for (header, payload, cause) in cases {
        actor.publish_rollout(&header, payload.into()).unwrap();
        let (_, header, payload) = next_rollout(&events).await;
        let opened = receive::open::<Rollout>(&header, &payload, ROLLOUT);
        assert_eq!(opened.unwrap_err().cause, cause);
    }

    // What the network would drop unsaid is not even sent.
    let payload = vec![0; 2 * MAX_ROLLOUT_BYTES + 1];
    let header = Header::plain(Schema::Rollout, a, &payload);
    let error = actor.publish_rollout(&header, payload.into()).unwrap_err();
    assert!(matches!(error, Error::TooLarge { .. }), "{error}");
}

/// Deletes what is at a key.
async fn delete(session: &Session, key: &str) {
    session.delete(key).congestion_control(CongestionControl::Block).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn deletes_and_messages_without_header_on_a_live_actors_keys_are_charged_to_nobody() {
    // More than what would cut its sender off, if it had one.
    const N: usize = REFUSALS_BEFORE_CUT_OFF as usize + 4;
    let site = Site::new();
    let (learner, events) = site.learner().await;
    let (actor, told) = site.welcomed("a", &events).await;
    let intruder = site.raw("client").await;
    let (name, domain, a) = (run("one"), domain(), actor_id("a"));
    let (member, incarnation) = (Member::Actor(a.clone()), start("a").incarnation());
    let rollouts = Key::Rollouts(&name, &domain, &a).to_string();
    for _ in 0..N {
        put(&intruder, &rollouts, None, b"garbage").await;
        delete(&intruder, &rollouts).await;
        let credit = Key::Credit(&name, &a);
        let news = Key::Announcement(&name, &domain);
        for key in [credit, news, Key::Alive(&name, &member, incarnation)] {
            delete(&intruder, &key.to_string()).await;
        }
    }
    look_at(&intruder).await;

    // The actor is still there, and everything reaches both sides.
    let (header, payload) = rollout("a", 1);
    actor.publish_rollout(&header, payload).unwrap();
    let mut n_refused = 0;
    let arrived = until(&events, |event| match event {
        LearnerEvent::Refused { actor, refusal, .. } => {
            let found = (actor, refusal.cause, refusal.sender);
            assert_eq!(found, (Some(a.clone()), RefusalCause::Header, None));
            n_refused += 1;
            None
        }
        LearnerEvent::Rollout { actor, header, .. } => Some((actor, header)),
        LearnerEvent::Left(actor, _) => panic!("{actor} has not left"),
        _ => None,
    });
    assert_eq!(arrived.await, (a.clone(), header));
    assert_eq!(n_refused, 2 * N);
    assert!(learner.take_uncounted().is_empty(), "each was an event");
    let (acknowledged, limit) = (Sequence(1), Sequence(9));
    let credit = Credit { incarnation, learner: LEARNER, acknowledged, limit };
    learner.send_credit(&a, credit).unwrap();
    let heard = until(&told, |event| match event {
        ActorEvent::Credit(credit) => Some(credit),
        ActorEvent::LearnerLeft(_) => panic!("the learner has not left"),
        _ => None,
    });
    assert_eq!(heard.await, credit);
    learner.offer_weights(PolicyVersion(1), b"weights".as_slice().into()).unwrap();
    assert_eq!(pull(&actor, &learner, 1).await.unwrap(), b"weights");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_actor_that_is_cut_off_is_only_counted() {
    let site = Site::new();
    let (learner, events) = site.learner().await;
    let (rogue, _rogue_events) = site.welcomed("rogue", &events).await;
    let (honest, _honest_events) = site.welcomed("honest", &events).await;
    learner.cut_off(&actor_id("rogue"), start("rogue").incarnation());
    let (header, payload) = rollout("rogue", 1);
    rogue.publish_rollout(&header, payload).unwrap();
    // The answer to a query shows that what this connection sent before has been looked at.
    while total(&learner.take_uncounted(), RefusalCause::CutOff) == 0 {
        rogue.pull_weights(PolicyVersion(0), [0; 32]).await.unwrap_err();
    }
    let (header, payload) = rollout("honest", 1);
    honest.publish_rollout(&header, payload).unwrap();
    assert_eq!(next_rollout(&events).await.0, actor_id("honest"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_malformed_hello_or_one_of_another_release_is_answered_and_counted() {
    let site = Site::new();
    let (learner, events) = site.learner().await;
    let intruder = site.raw("client").await;
    let good = Header::plain(Schema::Hello, start("a").incarnation(), b"garbage").to_bytes();
    let mut foreign = good;
    foreign[12] = 77;
    let other_release = format!(
        "the message has protocol 77, its receiver speaks {PROTOCOL_VERSION}: run the same release on both sides"
    );
    let unproved =
        "the message does not prove that it comes from the process that its header names";
    for (header, told, cause) in [
        (good, unproved, RefusalCause::Proof),
        (foreign, other_release.as_str(), RefusalCause::Protocol),
    ] {
        let question = intruder.get(Key::Hello(&run("one")).to_string()).payload(b"garbage");
        let answers = question.attachment(header).await.unwrap();
        let answer = answers.recv_async().await.unwrap();
        let sentence = answer.result().unwrap_err().payload().try_to_string().unwrap();
        assert_eq!(sentence, told);
        let (_, refusal) = refused(&events).await;
        assert_eq!((refusal.cause, refusal.sender), (cause, None));
        assert_eq!(refusal.to_string(), told);
    }
    assert!(learner.take_uncounted().is_empty(), "each was an event");
}

/// Carries one connection on, and changes a byte of each `DAMAGE` on its way there; returns when that side has ended it.
async fn damage(from: tokio::net::UnixListener, to: String) {
    let (near, _) = from.accept().await.unwrap();
    let far = tokio::net::UnixStream::connect(to).await.unwrap();
    let ((mut asked, mut answer), (mut answered, mut ask)) = (near.into_split(), far.into_split());
    let there = async {
        let mut bytes = vec![0; 1 << 16];
        while let Ok(n @ 1..) = asked.read(&mut bytes).await {
            let found: Vec<usize> = bytes[..n]
                .windows(6)
                .enumerate()
                .filter(|(_, it)| it == b"DAMAGE")
                .map(|(at, _)| at)
                .collect();
            for at in found {
                bytes[at + 3] = b'?';
            }
            if ask.write_all(&bytes[..n]).await.is_err() {
                break;
            }
        }
    };
    tokio::select! {
        () = there => panic!("the stranger gave up first"),
        _ = tokio::io::copy(&mut answered, &mut answer) => {}
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_key_that_is_none_ends_the_connection_on_which_it_comes_and_nothing_else() {
    let (site, elsewhere) = (Site::new(), Site::new());
    let (_learner, events) = site.learner().await;
    let path = |site: &Site| site.endpoint.as_str().split_once('/').unwrap().1.to_owned();
    let relay = tokio::net::UnixListener::bind(path(&elsewhere)).unwrap();
    let relay = tokio::spawn(damage(relay, path(&site)));
    let stranger = elsewhere.raw("client").await;
    stranger.declare_keyexpr("leadtime/1/one/DAMAGE").await.unwrap();
    let _keys = stranger.declare_subscriber("leadtime/1/one/credit/DAMAGE").await.unwrap();
    tokio::time::timeout(SOON, relay).await.expect("it is ended").unwrap();
    // Whoever declares or sends something has it looked for among all keys that are known.
    let (actor, _events) = site.welcomed("a", &events).await;
    let (header, payload) = rollout("a", 1);
    actor.publish_rollout(&header, payload).unwrap();
    assert_eq!(next_rollout(&events).await.1, header);
}
