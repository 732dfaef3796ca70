//! An actor that lies: every kind of bad rollout is refused, told and counted, the actor is cut off, and the run's
//! weights are those of a run without it.
//!
//! Both actors keep journals of their own: what they say they published must be what the learner's books hold.

use serde_json::{Value, json};

use crate::support::{PATIENCE, Place, Running, SOON, fake_actor, result, wait_until};
use leadtime_link::keys::Member;
use leadtime_link::{
    ActorEvent, ActorLink, ConnectSettings, Error as LinkError, Events, LearnerLink,
    ListenSettings, ObserverEvent, ObserverLink, StartKey,
};
use leadtime_proto::header::{PROTOCOL_VERSION, Schema};
use leadtime_proto::limits::{MAX_ROLLOUT_BYTES, MAX_SNAPSHOT_BYTES, REFUSALS_BEFORE_CUT_OFF};
use leadtime_proto::message::{Control, ControlReply, EnvAssignment, Welcome};
use leadtime_proto::{
    ActorId, EnvId, Epoch, Header, Incarnation, Iteration, PolicyVersion, Rollout, RunName,
    Sequence, codec,
};

const RUN: &str = "learner -c cartpole --seed 5 --name r --set learner.n_steps=32 --set learner.total_steps=5120 --listen";
/// What the rogue sends, in turn; each is wrong in one way only.
const LIES: [fn(&mut Rollout); 9] = [
    |rollout| rollout.observations[3] = f32::NAN,
    |rollout| rollout.rewards[0] = f32::INFINITY,
    |rollout| rollout.values.truncate(3),
    |rollout| rollout.actions[0] = 7,
    |rollout| rollout.env_id = EnvId(1_000),
    |rollout| rollout.version = PolicyVersion(1_000_000),
    |rollout| rollout.version.0 -= 1,
    |rollout| rollout.rewards[0] = 1e30,
    |rollout| rollout.snapshot = vec![0; MAX_SNAPSHOT_BYTES + 1],
];

fn learner(place: &Place, extra: &str) -> Running {
    place.start(&[RUN, &place.endpoint("learner"), extra])
}

fn honest(place: &Place) -> Running {
    place.start(&["actor --json --id honest --connect", &place.endpoint("learner")])
}

/// An actor without a conscience.
struct Rogue {
    link: ActorLink,
    events: Events<ActorEvent>,
    welcome: Welcome,
    start: Incarnation,
    epoch: Epoch,
    env: EnvAssignment,
    sent: u64,
}

impl Rogue {
    async fn enter(endpoint: &str) -> Self {
        let (link, events, hello) = fake_actor(&endpoint.parse().unwrap(), "rogue").await;
        let welcome = link.hello(None, &hello, SOON).await.unwrap();
        let env = EnvAssignment { env_id: EnvId(0), iteration: Iteration(0), snapshot: Vec::new() };
        let start = hello.incarnation;
        let mut rogue = Self { link, events, welcome, start, epoch: Epoch(0), env, sent: 0 };
        while rogue.epoch == Epoch(0) {
            assert!(rogue.hear().await.is_none(), "it was sent away before it did anything");
        }
        rogue
    }

    /// Handles one event; returns the reason if the learner dismissed this actor.
    async fn hear(&mut self) -> Option<(String, bool)> {
        let event = tokio::time::timeout(SOON, self.events.recv()).await;
        if let ActorEvent::Control { control, reply, .. } = event.expect("in time").expect("open") {
            let mut away = None;
            match control {
                Control::Assign(assignment) => {
                    self.epoch = assignment.epoch;
                    self.env = assignment.envs.first().cloned().unwrap_or(self.env.clone());
                    // The honest actor's: what it lies about its own may follow from the checkpoint, as far as the learner knows.
                    self.env.env_id = EnvId(0);
                }
                Control::Stop { reason, cut_off } => away = Some((reason, cut_off)),
                Control::Wait => {}
            }
            // The answer may find nobody any more.
            drop(reply.reply(&ControlReply::Followed { epoch: self.epoch }));
            return away;
        }
        None
    }

    /// A rollout that nothing is wrong with, as far as its shape tells.
    fn plausible(&self) -> Rollout {
        let (n, dim) = (self.welcome.spec.n_steps as usize, self.welcome.spec.env.obs_dim);
        let behavior = self.welcome.spec.schedule.behavior_version(self.env.iteration);
        Rollout {
            env_id: self.env.env_id,
            iteration: self.env.iteration,
            version: behavior.unwrap_or_default(),
            n_steps: n as u32,
            observations: vec![0.0; n * dim],
            next_observation: vec![0.0; dim],
            masks: vec![u64::MAX; n],
            actions: vec![0; n * self.welcome.spec.env.actions.heads.len()],
            log_probs: vec![-0.7; n],
            values: vec![0.0; n],
            rewards: vec![1.0; n],
            snapshot: vec![1],
            ..Rollout::default()
        }
    }

    fn header(&self, sequence: u64, payload: &[u8]) -> Header {
        let plain = Header::plain(Schema::Rollout, self.start, payload);
        let version = self.plausible().version;
        Header { sequence: Sequence(sequence), epoch: self.epoch, version, ..plain }
    }

    fn send(&mut self, payload: Vec<u8>, damage: fn(&mut Header)) {
        self.sent += 1;
        let mut header = self.header(self.sent, &payload);
        damage(&mut header);
        self.link.publish_rollout(&header, payload.into()).unwrap();
    }

    /// Sends what is refused before it is known whose it is: it has no place in the sequence, no answer, and no consequence.
    fn send_unread(&self, payload: Vec<u8>, protocol: u32) {
        let header = Header { protocol, ..self.header(self.sent + 1, &payload) };
        self.link.publish_rollout(&header, payload.into()).unwrap();
    }
}

/// What the learner must have counted: two rounds of kinds, the second one cut short by the sixteenth refusal that is held
/// against the rogue. What is too large to be looked at, or of another protocol, is nobody's.
fn expected_refusals() -> Value {
    json!({
        "oversize": 1,
        "protocol": 1,
        "checksum": 2,
        "malformed": 2,
        "assignment": 1,
        "version": 2,
        "shape": 2,
        "non_finite": 4,
        "action": 1,
        "snapshot": 1,
        "magnitude": 1,
    })
}

async fn misbehave(endpoint: String) -> (u64, String) {
    let mut rogue = Rogue::enter(&endpoint).await;
    for turn in 0.. {
        assert!(turn < 4 * REFUSALS_BEFORE_CUT_OFF, "the rogue was never cut off");
        match turn as usize % (LIES.len() + 4) {
            0 => rogue.send(b"not a rollout".to_vec(), |_| {}),
            1 => {
                let payload = codec::encode(&rogue.plausible()).unwrap();
                rogue.send(payload, |header| header.checksum ^= 1);
            }
            lie if lie < LIES.len() + 2 => {
                let mut rollout = rogue.plausible();
                LIES[lie - 2](&mut rollout);
                rogue.send(codec::encode(&rollout).unwrap(), |_| {});
            }
            unread => {
                let is_long = unread == LIES.len() + 2;
                let n_bytes = if is_long { MAX_ROLLOUT_BYTES + 1 } else { 1 };
                rogue.send_unread(vec![0; n_bytes], PROTOCOL_VERSION - u32::from(!is_long));
                continue;
            }
        }
        // Every refusal is answered: by the environments anew, or by being sent away.
        let before = rogue.epoch;
        while rogue.epoch == before {
            if let Some((reason, cut_off)) = rogue.hear().await {
                assert!(cut_off);
                return (rogue.sent, reason);
            }
        }
    }
    unreachable!("the loop has no end of its own")
}

/// Lets a learner and its actor run to the end by themselves.
fn undisturbed() -> Place {
    let place = Place::new();
    let (first, helper) = (learner(&place, ""), honest(&place));
    first.finish(PATIENCE).with_code(0);
    helper.finish(PATIENCE).with_code(0);
    place
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rogue_actor_is_refused_told_and_cut_off_and_the_run_is_unharmed() {
    let undisturbed = undisturbed();

    // The rogue comes when there are older policies to claim.
    let place = Place::new();
    let (begun, helper) = (learner(&place, "--stop-after 3"), honest(&place));
    begun.finish(PATIENCE).with_code(0);
    let before = helper.finish(PATIENCE).with_code(0).json();
    let second = learner(&place, "--set run.actors_min=2");
    let helper = honest(&place);
    let (sent, reason) = misbehave(place.endpoint("learner")).await;
    assert_eq!(sent, REFUSALS_BEFORE_CUT_OFF);
    assert!(reason.contains("refused"), "{reason}");
    wait_until("the cut is told", SOON, || second.stderr().contains("cut off"));
    let told = second.finish(PATIENCE).with_code(0).stderr;
    let journal = helper.finish(PATIENCE).with_code(0).json();

    let (calm, disturbed) = (result(&undisturbed.run("r")), result(&place.run("r")));
    assert_eq!(calm["weights_sha256"], disturbed["weights_sha256"]);
    assert_eq!((&calm["reproducible"], &disturbed["reproducible"]), (&true.into(), &false.into()));
    assert!(told.contains("another build of the program"), "{told}");
    let books = &disturbed["books"];
    assert_eq!(books["refused"], sent, "{books}");
    assert_eq!(books["refusals"], expected_refusals());
    let lines = std::fs::read_to_string(place.run("r").join("metrics.jsonl")).unwrap();
    let last: Value = serde_json::from_str(lines.lines().last().unwrap()).unwrap();
    assert_eq!(last["refusals"], expected_refusals());
    let honest = [before, journal].map(|journal| journal["published"].as_u64().unwrap());
    let published = honest.iter().sum::<u64>() + sent;
    assert_eq!(books["published"], published, "the journals of both actors: {honest:?} and {sent}");
}

/// Which start of the run's actor is there: whoever can connect can see that.
async fn actor_start(endpoint: &str, run: &RunName) -> Incarnation {
    let settings = ConnectSettings::new(vec![endpoint.parse().unwrap()]);
    let (observer, events) = ObserverLink::open(&settings).await.unwrap();
    observer.follow(run).unwrap();
    let start = loop {
        let event = tokio::time::timeout(SOON, events.recv()).await.expect("in time");
        if let ObserverEvent::Joined(Member::Actor(_), start) = event.expect("open") {
            break start;
        }
    };
    observer.close().await.unwrap();
    start
}

/// The learner's own start cannot be played: a forger has one of its own, which nobody here knows.
#[tokio::test(flavor = "multi_thread")]
async fn an_impostor_of_the_learner_neither_orders_its_actor_about_nor_forges_weights() {
    let undisturbed = undisturbed();
    let place = Place::new();
    let (run, endpoint) = (RunName::new("r").unwrap(), place.endpoint("learner"));
    // Until the second one comes, the first waits without environments.
    let (second, helper) = (learner(&place, "--set run.actors_min=2"), honest(&place));
    let start = actor_start(&endpoint, &run).await;
    let mut settings = ListenSettings::new(Vec::new());
    settings.connect = vec![endpoint.parse().unwrap()];
    let own = StartKey::draw().unwrap();
    let (forger, _events) = LearnerLink::open(&run, "cartpole", &own, &settings).await.unwrap();
    let order = Control::Stop { reason: "a forger says so".to_owned(), cut_off: true };
    let name = ActorId::new("honest").unwrap();
    let refused = forger.control(&name, start, &order, SOON).await.unwrap_err();
    assert!(matches!(refused, LinkError::NoAnswer { .. }), "{refused}");
    for version in 1..=3 {
        forger.offer_weights(PolicyVersion(version), vec![version as u8; 100].into()).unwrap();
    }
    let other = place.start(&["actor --id other --connect", &endpoint]);
    let told = second.finish(PATIENCE).with_code(0).stderr;
    other.finish(PATIENCE).with_code(0);
    let actor = helper.finish(PATIENCE).with_code(0).stderr;
    let (calm, disturbed) = (result(&undisturbed.run("r")), result(&place.run("r")));
    assert_eq!(calm["weights_sha256"], disturbed["weights_sha256"]);
    assert_eq!(disturbed["reproducible"], true, "{told}");
    assert!(!actor.contains("cannot be read") && !actor.contains("forger"), "{actor}");
}
