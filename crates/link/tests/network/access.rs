//! What each certificate may do: the access list line by line, enforced by a router and by a listening learner.
//!
//! What must be refused leaves no trace, so each forgery is followed by something that is allowed on the same connection:
//! once that has arrived, the forgery would have arrived before it.

use std::time::Duration;

use leadtime_certs::Role;
use leadtime_link::keys::{Key, Member};
use leadtime_link::live::{LiveServiceLink, OtherNotifier};
use leadtime_link::{
    AccessList, ActorEvent, ActorLink, Error, LearnerEvent, LearnerLink, ListenSettings,
    ObserverEvent, ObserverLink, RouterLink, StartKey,
};
use leadtime_proto::header::Schema;
use leadtime_proto::message::{Control, ControlReply, Credit};
use leadtime_proto::{
    Epoch, Header, Incarnation, PolicyVersion, RefusalCause, Sequence, ServiceName,
};
use sha2::{Digest as _, Sha256};
use zenoh::qos::CongestionControl;
use zenoh::query::{Query, QueryTarget};
use zenoh::{Session, Wait as _};

use crate::certificates::{Pki, dialler};
use crate::support::*;

const PEERS: [(Role, &str); 8] = [
    (Role::Router, "r1"),
    (Role::Learner, "l1"),
    (Role::Actor, "a7"),
    (Role::Actor, "a8"),
    (Role::Actor, "a9"),
    (Role::Observer, "o1"),
    (Role::Recorder, "w1"),
    (Role::Learner, "l2"),
];
/// Who may not send what a learner sends.
const FORGERS: [&str; 3] = ["a8", "o1", "stranger"];
/// The version that they say they have.
const FORGED: PolicyVersion = PolicyVersion(99);

/// A learner and its address, with or without a router between it and everybody else.
struct Guarded {
    pki: Pki,
    endpoint: leadtime_link::Endpoint,
    learner: LearnerLink,
    events: LearnerEvents,
    _router: Option<RouterLink>,
}

impl Guarded {
    async fn new(has_router: bool) -> Self {
        let pki = Pki::new();
        for (role, name) in PEERS {
            pki.issue(role, name);
        }
        // Of our authority, and in no list.
        pki.issue(Role::Actor, "stranger");
        let peers: Vec<_> =
            PEERS.iter().map(|(role, name)| (*role, name.parse().unwrap())).collect();
        let access = AccessList::parse(&AccessList::of(&peers).unwrap().to_text()).unwrap();
        let open = |settings| async move {
            LearnerLink::open(&run("one"), DOMAIN, &learner_start(), &settings).await.unwrap()
        };
        let mut guard = pki.listen(if has_router { "r1" } else { "l1" });
        guard.access = Some(access);
        if !has_router {
            let (learner, events) = open(guard).await;
            let endpoint = learner.locators()[0].parse().unwrap();
            return Self { pki, endpoint, learner, events, _router: None };
        }
        let router = RouterLink::open(&guard).await.unwrap();
        let endpoint: leadtime_link::Endpoint = router.locators()[0].parse().unwrap();
        let (learner, events) = open(dial(&pki, "l1", &endpoint)).await;
        Self { pki, endpoint, learner, events, _router: Some(router) }
    }

    async fn actor(&self, id: &str) -> (ActorLink, ActorEvents) {
        let settings = self.pki.connect(id, &self.endpoint);
        let (actor, events) = ActorLink::open(&settings, &actor_id(id), &start(id)).await.unwrap();
        say_hello(&actor, id, &self.events).await;
        (actor, events)
    }

    /// A session outside the link that shows this certificate.
    async fn raw(&self, name: &str) -> Session {
        dialler(&self.pki, name, &self.endpoint).await.expect("its certificate is good")
    }

    async fn observer(&self, name: &str) -> (ObserverLink, leadtime_link::Events<ObserverEvent>) {
        ObserverLink::open(&self.pki.connect(name, &self.endpoint)).await.unwrap()
    }
}

/// How a learner reaches a router.
fn dial(pki: &Pki, name: &str, router: &leadtime_link::Endpoint) -> ListenSettings {
    ListenSettings { connect: vec![router.clone()], endpoints: Vec::new(), ..pki.listen(name) }
}

fn credit(limit: u64) -> Credit {
    Credit {
        incarnation: start("a7").incarnation(),
        learner: LEARNER,
        acknowledged: Sequence(0),
        limit: Sequence(limit),
    }
}

async fn put(session: &Session, key: Key<'_>, attachment: &[u8], payload: &[u8]) {
    let put = session.put(key.to_string(), payload.to_vec()).attachment(attachment.to_vec());
    put.congestion_control(CongestionControl::Block).await.unwrap();
}

/// Asks, and returns the number of answers; a refused question ends at once.
async fn n_answers(session: &Session, key: Key<'_>) -> usize {
    let answers = session.get(key.to_string()).timeout(SOON).await.unwrap();
    let mut n = 0;
    while answers.recv_async().await.is_ok() {
        n += 1;
    }
    n
}

async fn everything_of_a_run_passes(guarded: &Guarded) {
    let Guarded { learner, events, .. } = guarded;
    let (observer, seen) = guarded.observer("o1").await;
    observer.follow(&run("one")).unwrap();
    let (actor, told) = guarded.actor("a7").await;
    let joined = until(&seen, |event| match event {
        ObserverEvent::Joined(Member::Actor(id), start) => Some((id, start)),
        _ => None,
    });
    assert_eq!(joined.await, (actor_id("a7"), start("a7").incarnation()));

    for sequence in 1..=20 {
        let (header, payload) = rollout("a7", sequence);
        actor.publish_rollout(&header, payload).unwrap();
    }
    for sequence in 1..=20 {
        let (of, header, _) = next_rollout(events).await;
        assert_eq!((of, header.sequence), (actor_id("a7"), Sequence(sequence)));
    }
    learner.send_credit(&actor_id("a7"), credit(24)).unwrap();
    let limit = until(&told, |event| match event {
        ActorEvent::Credit(credit) => Some(credit.limit),
        _ => None,
    });
    assert_eq!(limit.await, Sequence(24));

    let weights = vec![7; 200_000];
    learner.offer_weights(PolicyVersion(3), weights.clone().into()).unwrap();
    let news = until(&told, |event| match event {
        ActorEvent::Announcement(news) => Some(news),
        _ => None,
    });
    let sha256 = news.await.versions[0].1;
    assert_eq!(actor.pull_weights(PolicyVersion(3), sha256).await.unwrap(), weights);
    let news = until(&seen, |event| match event {
        ObserverEvent::Announcement { announcement, .. } => Some(announcement.versions),
        _ => None,
    });
    assert_eq!(news.await, [(PolicyVersion(3), sha256)]);
    let pulled = observer.pull_weights(&run("one"), &domain(), PolicyVersion(3), sha256).await;
    assert_eq!(pulled.unwrap(), weights);
    assert!(observer.round_trip(&run("one")).await.unwrap() < SOON);

    let order = Control::Stop { reason: "test".to_owned(), cut_off: false };
    let followed = ControlReply::Followed { epoch: Epoch(1) };
    let (id, a7) = (actor_id("a7"), start("a7").incarnation());
    let (answer, heard) =
        tokio::join!(learner.control(&id, a7, &order, SOON), obey_next(&told, &followed));
    assert_eq!((answer.unwrap(), heard), (followed, order));

    learner.publish_metrics(b"{\"of\":\"learner\"}").unwrap();
    actor.publish_metrics(b"{\"of\":\"actor\"}").unwrap();
    let mut members = Vec::new();
    while members.len() < 2 {
        members.push(
            until(&seen, |event| match event {
                ObserverEvent::Metrics { member, .. } => Some(member),
                _ => None,
            })
            .await,
        );
    }
    members.sort();
    assert_eq!(members, [Member::Learner, Member::Actor(actor_id("a7"))]);
    actor.close().await.unwrap();
    until(events, |event| {
        matches!(event, LearnerEvent::Left(id, _) if id == actor_id("a7")).then_some(())
    })
    .await;
}

#[expect(clippy::too_many_lines, reason = "the lines of one table")]
async fn nothing_under_another_name_passes(guarded: &Guarded) {
    let Guarded { learner, events, .. } = guarded;
    let (one, domain) = (run("one"), domain());
    let [a8, a9] = ["a8", "a9"].map(actor_id);
    let forger = guarded.raw("a8").await;
    let (header, payload) = rollout("a", 1);
    let header = header.to_bytes();

    // Rollouts and metrics.
    put(&forger, Key::Rollouts(&one, &domain, &a9), &header, &payload).await;
    put(&forger, Key::Rollouts(&one, &domain, &a8), &header, &payload).await;
    // It reaches the learner, which takes none from a peer that has not said hello.
    let refused = until(events, |event| match event {
        LearnerEvent::Refused { actor, refusal, .. } => Some((actor, refusal.cause)),
        _ => None,
    });
    assert_eq!(refused.await, (Some(a8.clone()), RefusalCause::Stranger));

    // Presence: an actor's, and a learner's.
    let alive = |member: &Member| Key::Alive(&one, member, Incarnation(9)).to_string();
    let (mine, others) = (Member::Actor(a8.clone()), Member::Actor(a9.clone()));
    let mut tokens = Vec::new();
    for member in [&others, &Member::Learner, &mine] {
        tokens.push(forger.liveliness().declare_token(alive(member)).await.unwrap());
    }
    let joined = until(events, |event| match event {
        LearnerEvent::Joined(id, Incarnation(9)) => Some(id),
        _ => None,
    });
    assert_eq!(joined.await, a8);
    let (observer, seen) = guarded.observer("o1").await;
    observer.follow(&one).unwrap();
    let mut present = Vec::new();
    while present.len() < 2 {
        present.push(
            until(&seen, |event| match event {
                ObserverEvent::Joined(member, start) => Some((member, start)),
                _ => None,
            })
            .await,
        );
    }
    present.sort_by_key(|(_, start)| start.0);
    assert_eq!(present, [(mine, Incarnation(9)), (Member::Learner, LEARNER)]);

    // Credit: that of another actor is not to be read.
    let (sender, heard) = flume::bounded(8);
    let listen = |key: Key<'_>| {
        let sender = sender.clone();
        let key = key.to_string();
        let take = move |sample: zenoh::sample::Sample| {
            drop(sender.send(sample.key_expr().to_string()));
        };
        forger.declare_subscriber(key).callback(take)
    };
    let _others = listen(Key::Credit(&one, &a9)).await.unwrap();
    let _mine = listen(Key::Credit(&one, &a8)).await.unwrap();
    let (_own, _heard) = guarded.actor("a8").await;
    let (_obedient, _orders) = guarded.actor("a9").await;
    let credit = |id| Credit { incarnation: start(id).incarnation(), ..credit(1) };
    let heard = async {
        loop {
            learner.send_credit(&a9, credit("a9")).unwrap();
            learner.send_credit(&a8, credit("a8")).unwrap();
            let wait = tokio::time::timeout(Duration::from_millis(50), heard.recv_async());
            if let Ok(Ok(key)) = wait.await {
                return key;
            }
        }
    };
    let heard = tokio::time::timeout(SOON, heard).await.expect("its own credit comes");
    assert_eq!(heard, Key::Credit(&one, &a8).to_string());

    // Orders come from the learner alone.
    for name in ["a8", "o1", "w1", "stranger"] {
        let session = guarded.raw(name).await;
        assert_eq!(n_answers(&session, Key::Control(&one, &a9)).await, 0, "{name} gives orders");
    }
    // Hello is for actors.
    for name in ["o1", "w1", "l2", "stranger"] {
        let session = guarded.raw(name).await;
        assert_eq!(n_answers(&session, Key::Hello(&one)).await, 0, "{name} says hello");
    }
    // A stranger sees nobody, and is told that.
    let mut settings = guarded.pki.connect("stranger", &guarded.endpoint);
    settings.timeout = Duration::from_secs(5);
    let (stranger, _events) =
        ActorLink::open(&settings, &actor_id("stranger"), &start("stranger")).await.unwrap();
    let said = stranger.hello(None, &hello("stranger"), Duration::from_millis(500)).await;
    let error = said.unwrap_err();
    assert!(matches!(&error, Error::Unlisted { name, .. } if name == "stranger"), "{error}");
    // An observer who plays an actor sees the learner, and is told that it may not say hello.
    let settings = guarded.pki.connect("o1", &guarded.endpoint);
    let (player, _events) =
        ActorLink::open(&settings, &actor_id("o1"), &start("o1")).await.unwrap();
    let error = player.hello(None, &hello("o1"), SOON).await.unwrap_err();
    assert!(matches!(error, Error::NotAllowed { .. }), "{error}");
}

/// Answers every pull with this name, as a learner that keeps such weights does.
async fn serve_its_name(session: &Session, name: &'static str) {
    let plain = Header::plain(Schema::Weights, LEARNER, name.as_bytes());
    let beside = Header { version: FORGED, ..plain }.to_bytes().to_vec();
    let key = Key::Weights(&run("one"), &domain()).to_string();
    let answer = move |query: Query| {
        let reply = query.reply(query.key_expr().clone(), name.as_bytes());
        drop(reply.attachment(beside.clone()).wait());
    };
    session.declare_queryable(key).complete(true).callback(answer).background().await.unwrap();
}

/// Weights and announcements are the learner's: what others put there reaches nobody, and nobody hears their answers to pulls.
async fn weights_and_news_are_the_learners(guarded: &Guarded) {
    let (one, domain) = (run("one"), domain());
    let (observer, _seen) = guarded.observer("o1").await;
    let pull = async |name: &str| {
        let sha256: [u8; 32] = Sha256::digest(name).into();
        observer.pull_weights(&one, &domain, FORGED, sha256).await
    };
    let news = || Key::Announcement(&one, &domain);
    let reader = guarded.raw("o1").await;
    let (sender, heard) = flume::bounded(64);
    let tell = move |sample: zenoh::sample::Sample| {
        drop(sender.try_send(sample.payload().to_bytes().into_owned()));
    };
    let _news = reader.declare_subscriber(news().to_string()).callback(tell).await.unwrap();

    // A peer with a learner's certificate is heard, so a forgery would be heard as well.
    let allowed = guarded.raw("l1").await;
    serve_its_name(&allowed, "l1").await;
    let is_heard = async |word: &str| {
        loop {
            put(&allowed, news(), b"l1", word.as_bytes()).await;
            let wait = tokio::time::timeout(Duration::from_millis(50), heard.recv_async());
            match wait.await {
                Ok(Ok(payload)) if payload == word.as_bytes() => return,
                Ok(Ok(payload)) => assert!(!FORGERS.iter().any(|name| payload == name.as_bytes())),
                _ => {}
            }
        }
    };
    let is_pulled = async {
        while !pull("l1").await.is_ok_and(|weights| weights == b"l1") {
            tokio::task::yield_now().await;
        }
    };
    tokio::time::timeout(SOON, is_heard("l1")).await.expect("a learner's news come");
    tokio::time::timeout(SOON, is_pulled).await.expect("a learner's answers come");

    for name in FORGERS {
        let session = guarded.raw(name).await;
        put(&session, news(), b"forged", name.as_bytes()).await;
        serve_its_name(&session, name).await;
        // Once this is answered, the list has seen the two before it.
        let key = Key::Weights(&one, &domain).to_string();
        let answers = session.get(key).target(QueryTarget::All).timeout(SOON).await.unwrap();
        while answers.recv_async().await.is_ok() {}
        let error = pull(name).await.expect_err("only learners answer");
        assert!(matches!(error, Error::NotKept { .. }), "{name}: {error}");
    }
    tokio::time::timeout(SOON, is_heard("the end")).await.expect("a learner's news come");
}

async fn rollouts_are_read_by_recorders_alone(guarded: &Guarded) {
    let (one, domain) = (run("one"), domain());
    let (sender, heard) = flume::bounded(64);
    let mut held = Vec::new();
    for name in ["o1", "a9", "w1"] {
        let session = guarded.raw(name).await;
        let sender = sender.clone();
        let subscriber = session
            .declare_subscriber(format!("leadtime/1/{one}/traj/**"))
            .callback(move |_| sender.try_send(name).unwrap_or_default())
            .await
            .unwrap();
        held.push((session, subscriber));
    }
    let source = guarded.raw("a8").await;
    let (header, payload) = rollout("a", 1);
    let key = || Key::Rollouts(&one, &domain, &actor_id("a8")).to_string();
    let wait = async {
        loop {
            let put = source.put(key(), payload.to_vec()).attachment(header.to_bytes().to_vec());
            put.await.unwrap();
            let wait = tokio::time::timeout(Duration::from_millis(50), heard.recv_async());
            if let Ok(Ok(name)) = wait.await {
                return name;
            }
        }
    };
    assert_eq!(tokio::time::timeout(SOON, wait).await.unwrap(), "w1");
    assert!(heard.drain().all(|name| name == "w1"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_second_learner_of_a_run_does_not_start_and_a_killed_one_does_not_count_as_the_first() {
    let guarded = Guarded::new(true).await;
    let (one, next) = (run("one"), StartKey::numbered(101));
    let settings = dial(&guarded.pki, "l2", &guarded.endpoint);
    let open = async |name: &str| {
        LearnerLink::open(&run(name), DOMAIN, &next, &settings).await.map(|(link, _events)| link)
    };
    let error = open("one").await.map(drop).unwrap_err();
    assert!(matches!(&error, Error::AnotherLearner { run, .. } if *run == one), "{error}");
    assert!(error.to_string().contains(guarded.endpoint.as_str()), "{error}");
    drop(open("two").await.expect("nobody leads that run"));

    // The presence of a learner that was killed, which outlives it: nobody answers.
    let ghost = guarded.raw("l1").await;
    let alive = Key::Alive(&one, &Member::Learner, Incarnation(9)).to_string();
    let _ghost = ghost.liveliness().declare_token(alive).await.unwrap();
    let (observer, seen) = guarded.observer("o1").await;
    observer.follow(&one).unwrap();
    let is_told = async |start: Incarnation, comes: bool| {
        until(&seen, |event| match event {
            ObserverEvent::Joined(Member::Learner, of) if comes => (of == start).then_some(()),
            ObserverEvent::Left(Member::Learner, of) if !comes => (of == start).then_some(()),
            _ => None,
        })
        .await;
    };
    is_told(LEARNER, true).await;
    guarded.learner.close().await.unwrap();
    is_told(LEARNER, false).await;
    let again = open("one").await.expect("it takes up the run of one that was killed");
    is_told(next.incarnation(), true).await;
    again.health().unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_second_notifier_of_a_name_hears_from_the_first_one_that_it_is_at_work() {
    let (pki, service) = (Pki::new(), ServiceName::new("n").unwrap());
    let peers = [(Role::Router, "r1"), (Role::Service, "s1"), (Role::Service, "s2")];
    for (role, name) in peers {
        pki.issue(role, name);
    }
    let peers = peers.map(|(role, name)| (role, name.parse().unwrap()));
    let guard = ListenSettings { access: AccessList::of(&peers), ..pki.listen("r1") };
    let router = RouterLink::open(&guard).await.unwrap();
    let endpoint = router.locators()[0].parse().unwrap();
    let open = async |name: &str, start| {
        LiveServiceLink::open(&dial(&pki, name, &endpoint), &service, start).await.unwrap()
    };
    let (_first, _events) = open("s1", Incarnation(1)).await;
    let (second, _events) = open("s2", Incarnation(2)).await;
    let hears =
        async { while second.other(Incarnation(2)).await.unwrap() != OtherNotifier::AtWork {} };
    tokio::time::timeout(SOON, hears).await.expect("the first one answers");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_router_enforces_the_list() {
    let guarded = Guarded::new(true).await;
    everything_of_a_run_passes(&guarded).await;
    nothing_under_another_name_passes(&guarded).await;
    weights_and_news_are_the_learners(&guarded).await;
    rollouts_are_read_by_recorders_alone(&guarded).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_listening_learner_enforces_the_list() {
    let guarded = Guarded::new(false).await;
    everything_of_a_run_passes(&guarded).await;
    nothing_under_another_name_passes(&guarded).await;
    weights_and_news_are_the_learners(&guarded).await;
    rollouts_are_read_by_recorders_alone(&guarded).await;
}
