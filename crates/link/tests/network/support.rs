//! What the tests share: a site with an address, peers, raw sessions, and waiting with a limit.

use std::time::Duration;

use leadtime_link::{
    ActorEvent, ActorLink, ConnectSettings, Endpoint, LearnerEvent, LearnerLink, ListenSettings,
};
use leadtime_proto::header::{PROTOCOL_VERSION, Schema};
use leadtime_proto::message::{Hello, Welcome};
use leadtime_proto::{
    ActionSpec, ActorId, DomainName, Encoder, EnvId, EnvSpec, HeadCredit, Header, Incarnation,
    Iteration, PolicySpec, PolicyVersion, Rollout, RunName, Schedule, Sequence, TaskSpec, codec,
};
use tempfile::TempDir;

pub(crate) const LEARNER: Incarnation = Incarnation(100);
pub(crate) const ACTOR: Incarnation = Incarnation(200);
pub(crate) const DOMAIN: &str = "cue_recall";
/// Longest wait for anything that must happen.
pub(crate) const SOON: Duration = Duration::from_secs(20);

pub(crate) type LearnerEvents = flume::Receiver<LearnerEvent>;
pub(crate) type ActorEvents = flume::Receiver<ActorEvent>;

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
        LearnerLink::open(&run("one"), DOMAIN, LEARNER, &self.listen()).await.unwrap()
    }

    pub(crate) async fn actor(&self, id: &str) -> (ActorLink, ActorEvents) {
        ActorLink::open(&self.connect(), &actor_id(id), ACTOR).await.unwrap()
    }

    /// An actor that a learner has welcomed.
    pub(crate) async fn welcomed(
        &self,
        id: &str,
        learner: &LearnerEvents,
    ) -> (ActorLink, ActorEvents) {
        let (actor, events) = self.actor(id).await;
        say_hello(&actor, id, ACTOR, learner).await;
        (actor, events)
    }

    /// A session outside the link: an intruder, or a foreign program.
    pub(crate) async fn raw(&self, mode: &str) -> zenoh::Session {
        raw(mode, &self.endpoint).await
    }
}

async fn raw(mode: &str, endpoint: &Endpoint) -> zenoh::Session {
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
pub(crate) async fn say_hello(
    actor: &ActorLink,
    id: &str,
    incarnation: Incarnation,
    learner: &LearnerEvents,
) -> Welcome {
    let hello = hello(id, incarnation);
    let (said, ()) = tokio::join!(actor.hello(None, &hello, SOON), welcome_next(learner));
    said.unwrap()
}

/// Welcomes the next actor that says hello.
pub(crate) async fn welcome_next(learner: &LearnerEvents) {
    let reply = until(learner, |event| match event {
        LearnerEvent::Hello { reply, .. } => Some(reply),
        _ => None,
    });
    reply.await.welcome(welcome("one")).unwrap();
}

/// Waits for the first event that `pick` takes; lets the others go.
pub(crate) async fn until<E, T>(
    events: &flume::Receiver<E>,
    mut pick: impl FnMut(E) -> Option<T>,
) -> T {
    let wait = async {
        loop {
            let event = events.recv_async().await.expect("the link is open");
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

pub(crate) fn hello(id: &str, incarnation: Incarnation) -> Hello {
    Hello {
        protocol: PROTOCOL_VERSION,
        program: "test".to_owned(),
        actor: actor_id(id),
        incarnation,
        cpu: "cpu".to_owned(),
        published: Sequence(0),
        first_unacknowledged: Sequence(1),
    }
}

pub(crate) fn welcome(name: &str) -> Welcome {
    let actions = ActionSpec::discrete("choice", 2);
    let task = TaskSpec { domain: DOMAIN.to_owned(), settings: "{}".to_owned() };
    Welcome {
        run: run(name),
        learner: LEARNER,
        run_seed: 7,
        task,
        env: EnvSpec { obs_dim: 1, actions: actions.clone(), metrics: Vec::new() },
        policy: PolicySpec {
            obs_dim: 1,
            encoder: Encoder::Identity,
            hidden: vec![64, 64],
            actions,
            head_credit: HeadCredit::All,
            logit_bias: Vec::new(),
            normalize_observations: false,
        },
        n_steps: 2,
        schedule: Schedule::Lag(0),
        window: 4,
        version: PolicyVersion(0),
        resend_from: Sequence(1),
    }
}

/// A rollout message that a learner takes.
pub(crate) fn rollout(sequence: u64) -> (Header, Vec<u8>) {
    let rollout = Rollout {
        env_id: EnvId(3),
        iteration: Iteration(sequence),
        n_steps: 2,
        observations: vec![0.5, 1.5],
        snapshot: vec![1, 2, 3],
        ..Rollout::default()
    };
    let payload = codec::encode(&rollout).unwrap();
    let header =
        Header { sequence: Sequence(sequence), ..Header::plain(Schema::Rollout, ACTOR, &payload) };
    (header, payload)
}
