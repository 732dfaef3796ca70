//! A consumer that does not look: nothing else may wait for it.

use std::time::Duration;

use leadtime_link::keys::Key;
use leadtime_link::{LearnerLink, ListenSettings};
use leadtime_proto::header::Schema;
use leadtime_proto::message::{Control, ControlReply, HelloReply};
use leadtime_proto::{Epoch, Header, PolicyVersion, RefusalCause, codec};

use crate::support::*;

const PER_ACTOR: usize = 4;
const FLOOD: u64 = 3_000;

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_to_a_stalled_learner_is_bounded_and_holds_up_nobody() {
    let site = Site::new();
    let settings = ListenSettings { rollouts_per_actor: PER_ACTOR, ..site.listen() };
    let (learner, events) =
        LearnerLink::open(&run("one"), DOMAIN, LEARNER, &settings).await.unwrap();
    let (rogue, _rogue_events) = site.welcomed("rogue", &events).await;
    let (honest, honest_events) = site.welcomed("honest", &events).await;
    learner.offer_weights(PolicyVersion(1), b"weights".as_slice().into()).unwrap();

    // Nobody looks at `events` from here on.
    let flood = tokio::task::spawn_blocking(move || {
        for sequence in 1..=FLOOD {
            let (header, payload) = rollout(sequence);
            rogue.publish_rollout(&header, payload).unwrap();
        }
        rogue
    });
    let rogue = tokio::time::timeout(SOON, flood).await.expect("publishing never waits").unwrap();

    // Pulls and orders go on, and so do the rollouts of those who keep to their window.
    assert_eq!(pull(&honest, &learner, 1).await.unwrap(), b"weights");
    let id = actor_id("honest");
    let order = Control::Stop { reason: "enough".to_owned(), cut_off: false };
    let answer = ControlReply::Followed { epoch: Epoch(1) };
    let obey = obey_next(&honest_events, &answer);
    let (followed, _) = tokio::join!(learner.control(&id, ACTOR, &order, SOON), obey);
    followed.unwrap();
    for sequence in 1..=PER_ACTOR as u64 {
        let (header, payload) = rollout(sequence);
        honest.publish_rollout(&header, payload).unwrap();
    }

    // All of the flood has been looked at; what was not taken is counted, and on the account of who sent it.
    let mut n_refused = 0;
    let counted = async {
        while n_refused < FLOOD - PER_ACTOR as u64 {
            pull(&rogue, &learner, 1).await.unwrap();
            let counts = learner.take_uncounted();
            assert!(counts.keys().all(|(who, _)| *who == Some(actor_id("rogue"))), "{counts:?}");
            n_refused += total(&counts, RefusalCause::Overflow);
        }
    };
    tokio::time::timeout(SOON, counted).await.expect("the flood is looked at");
    assert_eq!(n_refused, FLOOD - PER_ACTOR as u64);

    let mut n_taken = (0, 0);
    while n_taken.1 < PER_ACTOR {
        let (sender, ..) = next_rollout(&events).await;
        *(if sender == id { &mut n_taken.1 } else { &mut n_taken.0 }) += 1;
    }
    assert_eq!(n_taken, (PER_ACTOR, PER_ACTOR));
}

/// Says hello again and again from a session that never reads the answers; they end with the returned sender, which
/// comes first because closing the session waits for them.
async fn ask_without_reading(site: &Site, n: usize) -> (flume::Sender<()>, zenoh::Session) {
    let session = site.raw("client").await;
    let (stall, stalled) = flume::bounded::<()>(0);
    let payload = codec::encode(&hello("deaf", ACTOR)).unwrap();
    let header = Header::plain(Schema::Hello, ACTOR, &payload).to_bytes();
    for _ in 0..n {
        let (stalled, key) = (stalled.clone(), Key::Hello(&run("one")).to_string());
        let asked = session.get(key).payload(payload.clone()).attachment(header);
        asked.callback(move |_| _ = stalled.recv()).await.unwrap();
    }
    (stall, session)
}

#[tokio::test(flavor = "multi_thread")]
async fn answering_one_that_does_not_read_holds_up_neither_the_learner_nor_its_actors() {
    const N: usize = 1_000;
    let site = Site::new();
    let (_learner, events) = site.learner().await;
    let deaf = ask_without_reading(&site, N).await;
    // Far more than the connection holds; each answer would wait for seconds.
    let mut large = welcome("one");
    large.spec.task.settings = "x".repeat(16_000);
    let large = HelloReply::Welcome(Box::new(large));
    let started = std::time::Instant::now();
    for _ in 0..N {
        answer_next(&events, &large).await;
    }
    assert!(started.elapsed() < Duration::from_secs(4), "{:?}", started.elapsed());
    drop(deaf);
}
