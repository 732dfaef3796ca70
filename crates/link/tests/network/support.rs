//! What the tests share: a site with an address, peers, raw sessions, and waiting with a limit.

use std::time::Duration;

use bytes::Bytes;
use leadtime_link::{
    ActorEvent, ActorLink, ConnectSettings, Endpoint, Error, Events, HelloResponder, LearnerEvent,
    LearnerLink, ListenSettings, Payload, RefusalCounts, StartKey,
};
use leadtime_proto::header::Schema;
use leadtime_proto::message::{Announcement, Control, ControlReply, Hello, HelloReply, Welcome};
use leadtime_proto::{
    ActorId, DomainName, EnvId, Header, Incarnation, Iteration, PolicyVersion, RefusalCause,
    Rollout, RunName, Schedule, Sequence, codec, fakes,
};
use tempfile::TempDir;

/// The number that belongs to [`learner_start`].
pub(crate) const LEARNER: Incarnation = Incarnation(0x3a60_119f_06de_804c);
pub(crate) const DOMAIN: &str = "cue_recall";
/// Longest wait for anything that must happen.
pub(crate) const SOON: Duration = Duration::from_secs(20);

pub(crate) type LearnerEvents = flume::Receiver<LearnerEvent>;
pub(crate) type ActorEvents = Events<ActorEvent>;

/// An address of its own.
pub(crate) struct Site {
    pub(crate) endpoint: Endpoint,
    _dir: TempDir,
}

impl Site {
    pub(crate) fn new() -> Self {
        let dir = tempfile::Builder::new().prefix("lt").tempdir().unwrap();
        let endpoint = format!("unixsock-stream/{}", dir.path().join("z").display());
        Self { endpoint: endpoint.parse().unwrap(), _dir: dir }
    }

    pub(crate) fn listen(&self) -> ListenSettings {
        ListenSettings::new(vec![self.endpoint.clone()])
    }

    pub(crate) fn connect(&self) -> ConnectSettings {
        ConnectSettings { timeout: SOON, ..ConnectSettings::new(vec![self.endpoint.clone()]) }
    }

    pub(crate) async fn learner(&self) -> (LearnerLink, LearnerEvents) {
        LearnerLink::open(&run("one"), DOMAIN, &learner_start(), &self.listen()).await.unwrap()
    }

    pub(crate) async fn actor(&self, id: &str) -> (ActorLink, ActorEvents) {
        ActorLink::open(&self.connect(), &actor_id(id), &start(id)).await.unwrap()
    }

    /// An actor that a learner has welcomed.
    pub(crate) async fn welcomed(
        &self,
        id: &str,
        learner: &LearnerEvents,
    ) -> (ActorLink, ActorEvents) {
        let (actor, events) = self.actor(id).await;
        say_hello(&actor, id, learner).await;
        (actor, events)
    }

    /// A session outside the link: an intruder, or a foreign program.
    pub(crate) async fn raw(&self, mode: &str) -> zenoh::Session {
        raw_at(mode, self.endpoint.as_str()).await
    }
}

/// A session outside the link, at any address.
pub(crate) async fn raw_at(mode: &str, endpoint: &str) -> zenoh::Session {
    let place = if mode == "client" { "connect" } else { "listen" };
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", format!("\"{mode}\"")),
        ("scouting/multicast/enabled", "false".to_owned()),
        (format!("{place}/endpoints").as_str(), format!("[\"{endpoint}\"]")),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    zenoh::open(config).await.unwrap()
}

/// Says hello and has the learner welcome it.
pub(crate) async fn say_hello(actor: &ActorLink, id: &str, learner: &LearnerEvents) -> Welcome {
    let hello = hello(id);
    let (said, ()) = tokio::join!(actor.hello(None, &hello, SOON), welcome_next(learner));
    said.unwrap()
}

/// Waits until the learner has looked at everything that this session has sent it.
pub(crate) async fn look_at(session: &zenoh::Session) {
    let key = leadtime_link::keys::Key::Weights(&run("one"), &domain()).to_string();
    let answers = session.get(key).await.unwrap();
    let answer = tokio::time::timeout(SOON, answers.recv_async()).await;
    answer.expect("the answer comes soon").expect("the learner answers");
}

/// Welcomes the next actor that says hello.
pub(crate) async fn welcome_next(learner: &LearnerEvents) {
    answer_next(learner, &HelloReply::Welcome(Box::new(welcome("one")))).await;
}

/// Answers the next hello.
pub(crate) async fn answer_next(learner: &LearnerEvents, answer: &HelloReply) {
    next_hello(learner).await.reply(answer).unwrap();
}

/// Waits for the next hello, and returns where to answer it.
pub(crate) async fn next_hello(learner: &LearnerEvents) -> Box<HelloResponder> {
    let reply = until(learner, |event| match event {
        LearnerEvent::Hello { reply, .. } => Some(reply),
        _ => None,
    });
    reply.await
}

/// Answers the next order, and returns it.
pub(crate) async fn obey_next(actor: &ActorEvents, answer: &ControlReply) -> Control {
    let order = until(actor, |event| match event {
        ActorEvent::Control { control, reply, .. } => Some((control, reply)),
        _ => None,
    });
    let (control, reply) = order.await;
    reply.reply(answer).unwrap();
    control
}

/// Waits for the next rollout message.
pub(crate) async fn next_rollout(learner: &LearnerEvents) -> (ActorId, Header, Payload) {
    let message = until(learner, |event| match event {
        LearnerEvent::Rollout { actor, header, payload } => Some((actor, header, payload)),
        _ => None,
    });
    message.await
}

/// Where events come from.
pub(crate) trait EventSource<E> {
    async fn next(&self) -> Option<E>;
}

impl<E> EventSource<E> for flume::Receiver<E> {
    async fn next(&self) -> Option<E> {
        self.recv_async().await.ok()
    }
}

impl<E> EventSource<E> for Events<E> {
    async fn next(&self) -> Option<E> {
        self.recv().await
    }
}

/// Waits for the first event that `pick` takes; lets the others go.
pub(crate) async fn until<E, T>(
    events: &impl EventSource<E>,
    mut pick: impl FnMut(E) -> Option<T>,
) -> T {
    let wait = async {
        loop {
            let event = events.next().await.expect("the link is open");
            if let Some(picked) = pick(event) {
                return picked;
            }
        }
    };
    tokio::time::timeout(SOON, wait).await.expect("the event comes soon")
}

pub(crate) fn run(name: &str) -> RunName {
    RunName::new(name).unwrap()
}

pub(crate) fn actor_id(id: &str) -> ActorId {
    ActorId::new(id).unwrap()
}

pub(crate) fn domain() -> DomainName {
    DomainName::new(DOMAIN).unwrap()
}

/// The keys of the learner in these tests.
pub(crate) fn learner_start() -> StartKey {
    StartKey::numbered(100)
}

/// The keys of an actor in these tests.
pub(crate) fn start(id: &str) -> StartKey {
    StartKey::numbered(id.bytes().fold(200, |number, byte| 31 * number + u64::from(byte)))
}

pub(crate) fn hello(id: &str) -> Hello {
    fakes::hello(actor_id(id), start(id).incarnation())
}

pub(crate) fn welcome(name: &str) -> Welcome {
    let nothing = Announcement { learner: LEARNER, versions: Vec::new() };
    fakes::welcome(run(name), fakes::run_spec(DOMAIN, 2, Schedule::Lag(0)), nothing)
}

/// A rollout message that a learner takes.
pub(crate) fn rollout(id: &str, sequence: u64) -> (Header, Bytes) {
    let rollout = Rollout {
        env_id: EnvId(3),
        iteration: Iteration(sequence),
        n_steps: 2,
        observations: vec![0.5, 1.5],
        snapshot: vec![1, 2, 3],
        ..Rollout::default()
    };
    let payload = codec::encode(&rollout).unwrap();
    let plain = Header::plain(Schema::Rollout, start(id).incarnation(), &payload);
    let header = Header { sequence: Sequence(sequence), ..plain };
    (header, payload.into())
}

/// Pulls the weights that a learner announces.
pub(crate) async fn pull(
    actor: &ActorLink,
    learner: &LearnerLink,
    version: u64,
) -> Result<Vec<u8>, Error> {
    let told = learner.announcement().versions;
    let sha256 = told.iter().find(|(told, _)| told.0 == version).map_or([0; 32], |told| told.1);
    actor.pull_weights(PolicyVersion(version), sha256).await
}

/// Adds up the refusals of a cause.
pub(crate) fn total(counts: &RefusalCounts, cause: RefusalCause) -> u64 {
    counts.iter().filter(|((_, of), _)| *of == cause).map(|(_, n)| n).sum()
}
