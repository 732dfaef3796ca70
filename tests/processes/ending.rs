//! An actor that comes while its run ends is dismissed, as those are that are there: whatever is left to do is nobody's fault.

use crate::support::{PATIENCE, Place, SOON, fake_actor, signal};
use leadtime_link::{
    ActorEvent, Error, Events, LearnerEvent, LearnerLink, ListenSettings, RUN_IS_ENDING, StartKey,
};
use leadtime_proto::message::{Assignment, Control, ControlReply, HelloReply};
use leadtime_proto::{Epoch, RunName};

/// Waits until the learner sends an actor away; returns the order, which is not answered as long as that is kept.
async fn sent_away(events: &Events<ActorEvent>) -> ActorEvent {
    let stop = async {
        while let Some(event) = events.recv().await {
            match event {
                ActorEvent::Control { control: Control::Stop { cut_off: false, .. }, .. } => {
                    return event;
                }
                // One order at a time: to wait, and then the environments.
                ActorEvent::Control { control, reply, .. } => {
                    let Control::Assign(Assignment { epoch, .. }) = control else {
                        reply.reply(&ControlReply::Followed { epoch: Epoch(0) }).unwrap();
                        continue;
                    };
                    reply.reply(&ControlReply::Followed { epoch }).unwrap();
                }
                _ => {}
            }
        }
        panic!("the learner is gone");
    };
    tokio::time::timeout(PATIENCE, stop).await.expect("the learner sends its actors away")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_learner_that_ends_dismisses_who_comes_late() {
    let place = Place::new();
    let endpoint = place.endpoint("learner");
    let learner = place.start(&["learner -c cartpole --name r --listen", &endpoint]);
    let endpoint = endpoint.parse().unwrap();
    // It takes no notice of its dismissal, so the learner waits for it for a while.
    let (stays, events, hello) = fake_actor(&endpoint, "stays").await;
    stays.hello(None, &hello, SOON).await.unwrap();
    let (late, _events, hello) = fake_actor(&endpoint, "late").await;
    signal("TERM", learner.id());
    let _order = sent_away(&events).await;
    let error = late.hello(None, &hello, SOON).await.unwrap_err();
    assert!(matches!(&error, Error::Ending { run } if run.as_str() == "r"), "{error}");
    tokio::task::block_in_place(|| learner.finish(PATIENCE).with_code(130));
}

#[tokio::test(flavor = "multi_thread")]
async fn an_end_that_was_planned_may_take_longer_than_an_interrupt_and_is_a_success() {
    let place = Place::new();
    let begin = async |name: &str, more: &str| {
        let endpoint = place.endpoint(name);
        let learner = ["learner -c cartpole --name", name, "--listen", &endpoint, more];
        let mut command = place.program(&learner);
        command.args(["--metrics-to", "exec sleep 600"]);
        let learner = place.start_with(command);
        let (actor, events, hello) = fake_actor(&endpoint.parse().unwrap(), "stays").await;
        actor.hello(None, &hello, SOON).await.unwrap();
        (learner, actor, events)
    };
    // Neither the actor nor the command ends when it is to: together that is more than an interrupted learner has.
    let (timed, _timed_actor, timed_events) = begin("timed", "--stop-after 10s").await;
    let (drained, _drained_actor, drained_events) = begin("drained", "").await;
    signal("USR1", drained.id());
    let _orders = tokio::join!(sent_away(&timed_events), sent_away(&drained_events));
    tokio::task::block_in_place(|| {
        timed.finish(PATIENCE).with_code(0).saying(&["the time of --stop-after is over"]);
        drained.finish(PATIENCE).with_code(0).saying(&["asked to drain"]);
    });
}

#[tokio::test(flavor = "multi_thread")]
async fn an_actor_that_comes_late_ends_well() {
    let place = Place::new();
    let endpoint = place.endpoint("learner");
    let listen = ListenSettings::new(vec![endpoint.parse().unwrap()]);
    let run = RunName::new("r").unwrap();
    let (_learner, events) =
        LearnerLink::open(&run, "cartpole", &StartKey::numbered(1), &listen).await.unwrap();
    let answering = tokio::spawn(async move {
        while let Ok(event) = events.recv_async().await {
            if let LearnerEvent::Hello { reply, .. } = event {
                reply.reply(&HelloReply::Refused { reason: RUN_IS_ENDING.to_owned() }).unwrap();
            }
        }
    });
    let actor = place.start(&["actor --connect", &endpoint]);
    let done = tokio::task::block_in_place(|| actor.finish(PATIENCE));
    answering.abort();
    let done = done.with_code(0).saying(&["leaving: the run is ending: nothing is left to do"]);
    assert!(!done.stderr.contains("error"), "{}", done.stderr);
    assert!(done.stdout.contains("run r: 0 steps"), "{}", done.stdout);
}
