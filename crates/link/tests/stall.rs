//! A consumer that does not look, one that does not read, and those who say nothing: nothing else may wait for them.
//!
//! In a process of its own, and one test at a time: the threads on which the network library receives are the whole process's,
//! and a test that stalls some makes others wait.

#![expect(clippy::unwrap_used, reason = "the tests' helpers fail as their tests do")]

#[path = "network/support.rs"]
mod support;

use std::sync::Arc;
use std::time::{Duration, Instant};

use leadtime_link::keys::Key;
use leadtime_link::{
    ActorLink, ConnectSettings, Endpoint, Error, LearnerLink, ListenSettings, fake_hello,
};
use leadtime_proto::header::Schema;
use leadtime_proto::message::{Assignment, Control, ControlReply, EnvAssignment, HelloReply};
use leadtime_proto::{
    EnvId, Epoch, Header, Iteration, PolicyVersion, RefusalCause, Rollout, Sequence, codec,
};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpStream, UnixListener, UnixStream};
use tokio::sync::{Mutex, watch};
use tokio::task::JoinSet;

use crate::support::*;

/// Held by each of these tests.
static ALONE: Mutex<()> = Mutex::const_new(());

const PER_ACTOR: usize = 4;
const FLOOD: u64 = 3_000;

/// Waits for one thing that nobody may hold up. Waiting for a connection that does not read takes five seconds,
/// until it is given up; all of a test may take longer than that on a busy machine.
async fn promptly<T>(it: impl Future<Output = T>) -> T {
    let started = Instant::now();
    let done = it.await;
    assert!(started.elapsed() < Duration::from_secs(4), "{:?}", started.elapsed());
    done
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_to_a_stalled_learner_is_bounded_and_holds_up_nobody() {
    let _alone = ALONE.lock().await;
    let site = Site::new();
    let settings = ListenSettings { rollouts_per_actor: PER_ACTOR, ..site.listen() };
    let (learner, events) =
        LearnerLink::open(&run("one"), DOMAIN, &learner_start(), &settings).await.unwrap();
    let (rogue, _rogue_events) = site.welcomed("rogue", &events).await;
    let (honest, honest_events) = site.welcomed("honest", &events).await;
    learner.offer_weights(PolicyVersion(1), b"weights".as_slice().into()).unwrap();

    // Nobody looks at `events` from here on.
    let flood = tokio::task::spawn_blocking(move || {
        for sequence in 1..=FLOOD {
            let (header, payload) = rollout("rogue", sequence);
            rogue.publish_rollout(&header, payload).unwrap();
        }
        rogue
    });
    let rogue = tokio::time::timeout(SOON, flood).await.expect("publishing never waits").unwrap();

    // Pulls and orders go on, and so do the rollouts of those who keep to their window.
    assert_eq!(pull(&honest, &learner, 1).await.unwrap(), b"weights");
    let (id, honest_start) = (actor_id("honest"), start("honest").incarnation());
    let order = Control::Stop { reason: "enough".to_owned(), cut_off: false };
    let answer = ControlReply::Followed { epoch: Epoch(1) };
    let obey = obey_next(&honest_events, &answer);
    let (followed, _) = tokio::join!(learner.control(&id, honest_start, &order, SOON), obey);
    followed.unwrap();
    for sequence in 1..=PER_ACTOR as u64 {
        let (header, payload) = rollout("honest", sequence);
        honest.publish_rollout(&header, payload).unwrap();
    }

    // All of the flood has been looked at; what was not taken is counted, and on its sender's account.
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
    for number in 1..=n as u64 {
        let (header, payload) = fake_hello(&start("deaf"), number, &hello("deaf")).unwrap();
        let (stalled, key) = (stalled.clone(), Key::Hello(&run("one")).to_string());
        let asked = session.get(key).payload(payload).attachment(header.to_bytes());
        asked.callback(move |_| _ = stalled.recv()).await.unwrap();
    }
    (stall, session)
}

#[tokio::test(flavor = "multi_thread")]
async fn answering_one_that_does_not_read_holds_up_neither_the_learner_nor_its_actors() {
    const N: usize = 1_000;
    let _alone = ALONE.lock().await;
    let site = Site::new();
    let (_learner, events) = site.learner().await;
    let deaf = ask_without_reading(&site, N).await;
    // Far more than the connection holds; each answer would wait for seconds.
    let mut large = welcome("one");
    large.spec.task.settings = "x".repeat(16_000);
    let large = HelloReply::Welcome(Box::new(large));
    for _ in 0..N {
        promptly(answer_next(&events, &large)).await;
    }
    drop(deaf);
}

/// A line from an actor to a learner, on which the actor's end stops reading when it is told to. For the learner the connection goes on
/// when the actor gives it up.
struct Line {
    is_stalled: watch::Sender<bool>,
    _ends: JoinSet<()>,
}

impl Line {
    /// Takes one connection at `from` and passes on what comes, to the socket at `to` and back.
    fn lay(from: &str, to: &str) -> Self {
        let path = |endpoint: &str| endpoint.strip_prefix("unixsock-stream/").unwrap().to_owned();
        let (listener, to) = (UnixListener::bind(path(from)).unwrap(), path(to));
        let (is_stalled, stalled) = watch::channel(false);
        let mut ends = JoinSet::new();
        ends.spawn(async move {
            let (actor, _) = listener.accept().await.unwrap();
            let (mut from_actor, to_actor) = actor.into_split();
            let learner = UnixStream::connect(to).await.unwrap();
            let (from_learner, mut to_learner) = learner.into_split();
            let up = tokio::io::copy(&mut from_actor, &mut to_learner);
            drop(tokio::join!(up, pass_on(from_learner, to_actor, stalled)));
        });
        Self { is_stalled, _ends: ends }
    }
}

/// Passes on what comes until it is stalled; what comes then is not even read.
async fn pass_on(
    mut from: tokio::net::unix::OwnedReadHalf,
    mut to: tokio::net::unix::OwnedWriteHalf,
    mut stalled: watch::Receiver<bool>,
) {
    async fn until(stalled: &mut watch::Receiver<bool>) {
        drop(stalled.wait_for(|stalled| *stalled).await);
    }
    let mut bytes = vec![0; 1 << 16];
    loop {
        let read = tokio::select! {
            biased;
            () = until(&mut stalled) => std::future::pending().await,
            read = from.read(&mut bytes) => read.unwrap_or(0),
        };
        if read == 0 || to.write_all(&bytes[..read]).await.is_err() {
            return;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn orders_to_a_connection_that_does_not_read_end_in_time_and_hold_up_no_other() {
    const N: u64 = 16;
    let _alone = ALONE.lock().await;
    let site = Site::new();
    let (learner, events) = site.learner().await;
    let learner = Arc::new(learner);
    let (_honest, honest_events) = site.welcomed("honest", &events).await;
    let through = format!("{}-line", site.endpoint);
    let line = Line::lay(&through, site.endpoint.as_str());
    let connect =
        ConnectSettings { timeout: SOON, ..ConnectSettings::new(vec![through.parse().unwrap()]) };
    let (deaf, _deaf_events) =
        ActorLink::open(&connect, &actor_id("deaf"), &start("deaf")).await.unwrap();
    say_hello(&deaf, "deaf", &events).await;
    line.is_stalled.send_replace(true);

    // Far more than the connection holds: sending waits for seconds, until the connection is given up.
    let (started, timeout) = (Instant::now(), Duration::from_secs(1));
    let mut orders = JoinSet::new();
    for epoch in 1..=N {
        let env =
            EnvAssignment { env_id: EnvId(0), iteration: Iteration(0), snapshot: vec![9; 400_000] };
        let order =
            Control::Assign(Assignment { epoch: Epoch(epoch), envs: vec![env], keep: vec![] });
        let (learner, start) = (Arc::clone(&learner), start("deaf").incarnation());
        let give = async move { learner.control(&actor_id("deaf"), start, &order, timeout).await };
        orders.spawn(give);
    }
    let order = Control::Stop { reason: "enough".to_owned(), cut_off: false };
    let (answer, id) = (ControlReply::Followed { epoch: Epoch(1) }, actor_id("honest"));
    let honest_start = start("honest").incarnation();
    let obey = obey_next(&honest_events, &answer);
    let (followed, _) = tokio::join!(learner.control(&id, honest_start, &order, SOON), obey);
    followed.unwrap();
    while let Some(ended) = orders.join_next().await {
        let error = ended.unwrap().unwrap_err();
        assert!(
            matches!(&error, Error::NoAnswer { timeout: after, .. } if *after == timeout),
            "{error}"
        );
    }
    assert!(started.elapsed() < Duration::from_secs(4), "{:?}", started.elapsed());
}

#[tokio::test(flavor = "multi_thread")]
async fn one_that_reads_everything_and_stops_reading_holds_up_no_rollout() {
    const N: u64 = 16;
    let _alone = ALONE.lock().await;
    let site = Site::new();
    let (_learner, events) = site.learner().await;
    let (honest, _honest_events) = site.welcomed("honest", &events).await;
    let through = format!("{}-line", site.endpoint);
    let line = Line::lay(&through, site.endpoint.as_str());
    let reader = raw_at("client", &through).await;
    let _everything = reader.declare_subscriber("**").callback(|_| ()).await.unwrap();
    look_at(&reader).await;
    line.is_stalled.send_replace(true);

    // Far more than the connection holds: passing them on would wait.
    let observations = vec![0.25; 100_000];
    let rollout = Rollout { observations, n_steps: 2, ..Rollout::default() };
    let payload = codec::encode(&rollout).unwrap();
    let plain = Header::plain(Schema::Rollout, start("honest").incarnation(), &payload);
    for sequence in (1..=N).map(Sequence) {
        let header = Header { sequence, ..plain };
        honest.publish_rollout(&header, payload.clone().into()).unwrap();
        assert_eq!(promptly(next_rollout(&events)).await.1, header);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn connections_that_say_nothing_keep_nobody_out_and_are_given_up() {
    const N: usize = 300;
    let _alone = ALONE.lock().await;
    let settings = ListenSettings::new(vec!["tcp/127.0.0.1:0".parse().unwrap()]);
    let (learner, events) =
        LearnerLink::open(&run("one"), DOMAIN, &learner_start(), &settings).await.unwrap();
    let endpoint: Endpoint = learner.locators()[0].parse().unwrap();
    let address = endpoint.as_str().strip_prefix("tcp/").unwrap();
    let mut silent = Vec::new();
    let started = Instant::now();
    for _ in 0..N {
        silent.push(TcpStream::connect(address).await.unwrap());
    }
    let connect = ConnectSettings { timeout: SOON, ..ConnectSettings::new(vec![endpoint.clone()]) };
    let (actor, _told) = ActorLink::open(&connect, &actor_id("a"), &start("a")).await.unwrap();
    say_hello(&actor, "a", &events).await;
    // As the library is set by itself, a hundred of them keep everybody out for ten seconds.
    assert!(started.elapsed() < Duration::from_secs(8), "{:?}", started.elapsed());
    for mut connection in silent {
        let mut byte = [0];
        let read = tokio::time::timeout(SOON, connection.read(&mut byte)).await;
        let read = read.expect("it is given up");
        assert!(matches!(read, Ok(0) | Err(_)), "{read:?}");
    }
}
