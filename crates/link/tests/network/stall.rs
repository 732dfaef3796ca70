//! A consumer that does not look: nothing else may wait for it.

use std::time::Duration;

use leadtime_link::{ActorEvent, LearnerEvent, LearnerLink, ListenSettings};
use leadtime_proto::message::{Control, ControlAck};
use leadtime_proto::{Epoch, PolicyVersion, RefusalCause};

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
    learner.offer_weights(PolicyVersion(1), b"weights").unwrap();

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
    assert_eq!(honest.pull_weights(None).await.unwrap().1, b"weights");
    let obey = async {
        let ack = until(&honest_events, |event| match event {
            ActorEvent::Control { ack, .. } => Some(ack),
            _ => None,
        });
        ack.await.acknowledge(ControlAck { epoch: Epoch(1) }).unwrap();
    };
    let id = actor_id("honest");
    let (ack, ()) = tokio::join!(learner.control(&id, ACTOR, &Control::Pause, SOON), obey);
    ack.unwrap();
    for sequence in 1..=PER_ACTOR as u64 {
        let (header, payload) = rollout(sequence);
        honest.publish_rollout(&header, payload).unwrap();
    }

    // All of the flood has been judged; what was not taken is counted.
    let refused = || learner.refusals().get(&RefusalCause::Overflow).copied().unwrap_or(0);
    let judged = async {
        while refused() < FLOOD - PER_ACTOR as u64 {
            rogue.pull_weights(None).await.unwrap();
        }
    };
    tokio::time::timeout(SOON, judged).await.expect("the flood is judged");
    assert_eq!(refused(), FLOOD - PER_ACTOR as u64);

    let mut n_taken = (0, 0);
    while n_taken.1 < PER_ACTOR {
        let event = tokio::time::timeout(Duration::from_secs(20), events.recv_async()).await;
        match event.expect("the honest actor's rollouts are there").unwrap() {
            LearnerEvent::Rollout { actor, .. } if actor == id => n_taken.1 += 1,
            LearnerEvent::Rollout { .. } => n_taken.0 += 1,
            _ => {}
        }
    }
    assert_eq!(n_taken, (PER_ACTOR, PER_ACTOR));
}
