//! An actor's decisions, without a network.

use bytes::Bytes;
use leadtime_link::{ConnectSettings, StartKey};
use leadtime_proto::header::Schema;
use leadtime_proto::message::EnvAssignment;
use leadtime_proto::{ActorId, Head, Header, RunName, RunSpec, Schedule, fakes, limits};

use super::*;

const LEARNER: Incarnation = Incarnation(100);
const PATIENCE: Duration = Duration::from_mins(30);

/// Orders are numbered, environments and weights are nothing.
type ToDo = ActorOutput<(), u32, ()>;

/// An actor, and a clock that stands still unless it is told otherwise.
struct Bench {
    actor: Actor<(), u32, ()>,
    now: Instant,
}

fn welcome(learner: Incarnation, versions: std::ops::RangeInclusive<u64>) -> Welcome {
    let spec = fakes::run_spec("test", 1, Schedule::Lag(0));
    fakes::welcome(RunName::new("r").unwrap(), spec, news(learner, versions))
}

fn news(learner: Incarnation, versions: std::ops::RangeInclusive<u64>) -> Announcement {
    let versions = versions.map(|version| (PolicyVersion(version), [version as u8; 32]));
    Announcement { learner, versions: versions.collect() }
}

impl Bench {
    fn new(versions: std::ops::RangeInclusive<u64>) -> Self {
        let settings = ActorSettings {
            actor: ActorId::new("a").unwrap(),
            start: StartKey::numbered(1),
            run: None,
            connect: ConnectSettings::new(Vec::new()),
            reconnect_timeout: PATIENCE,
            yields_to_learner: false,
            program: "test".to_owned(),
            cpu: "cpu".to_owned(),
        };
        let now = Instant::now();
        Self { actor: Actor::new(settings, welcome(LEARNER, versions), now).unwrap(), now }
    }

    /// The same with the newest version, which it asks for first.
    fn with_weights(versions: std::ops::RangeInclusive<u64>) -> Self {
        let newest = *versions.end();
        let mut bench = Self::new(versions);
        assert_eq!(names(&bench.give(ActorInput::Tick)), ["pull"]);
        bench.pulled(newest);
        bench
    }

    fn give(&mut self, input: ActorInput<(), u32, ()>) -> Vec<ToDo> {
        self.actor.handle(self.now, input)
    }

    fn wait(&mut self, time: Duration) -> Vec<ToDo> {
        self.now += time;
        self.give(ActorInput::Tick)
    }

    fn assign(&mut self, reply: u32, epoch: u64, envs: &[u32]) -> Vec<ToDo> {
        let env =
            |&id| EnvAssignment { env_id: EnvId(id), iteration: Iteration(0), snapshot: vec![1] };
        let envs = envs.iter().map(env).collect();
        let assignment = Assignment { epoch: Epoch(epoch), envs, keep: Vec::new() };
        let (learner, control) = (self.actor.learner(), Control::Assign(assignment));
        self.give(ActorInput::Order { learner, control, reply })
    }

    /// Has an assignment restored and adopted; the next rollout is of this iteration.
    fn follow(&mut self, reply: u32, epoch: u64, next: u64) -> Vec<ToDo> {
        self.assign(reply, epoch, &[0]);
        self.give(ActorInput::Restored { envs: (), failed: Vec::new() });
        self.collected(0, Some(next))
    }

    fn collected(&mut self, n: usize, next: Option<u64>) -> Vec<ToDo> {
        let header = Header::plain(Schema::Rollout, Incarnation(1), &[]);
        let rollout = EncodedRollout { header, payload: Bytes::new() };
        self.give(ActorInput::Collected { rollouts: vec![rollout; n], next: next.map(Iteration) })
    }

    fn pulled(&mut self, version: u64) -> Vec<ToDo> {
        self.give(ActorInput::Pulled { version: PolicyVersion(version), weights: () })
    }

    fn credit(&mut self, acknowledged: u64, limit: u64) -> Vec<ToDo> {
        self.give(ActorInput::Credit(Credit {
            incarnation: Incarnation(1),
            learner: self.actor.learner(),
            acknowledged: Sequence(acknowledged),
            limit: Sequence(limit),
        }))
    }

    fn welcomed(&mut self, learner: Incarnation) -> Vec<ToDo> {
        self.give(ActorInput::Welcomed(Box::new(welcome(learner, 0..=9))))
    }
}

/// Names what is to be done, in order.
fn names(outputs: &[ToDo]) -> Vec<&'static str> {
    let name = |output: &ToDo| match output {
        ActorOutput::Hello { .. } => "hello",
        ActorOutput::Reply(..) => "reply",
        ActorOutput::Restore(_) => "restore",
        ActorOutput::Adopt { .. } => "adopt",
        ActorOutput::Collect { .. } => "collect",
        ActorOutput::Publish(_) => "publish",
        ActorOutput::Pull { .. } => "pull",
        ActorOutput::End(_) => "end",
    };
    outputs.iter().map(name).collect()
}

fn replies(outputs: &[ToDo]) -> Vec<(u32, ControlReply)> {
    let reply = |output: &ToDo| match output {
        ActorOutput::Reply(reply, answer) => Some((*reply, answer.clone())),
        _ => None,
    };
    outputs.iter().filter_map(reply).collect()
}

#[test]
fn an_assignment_is_restored_answered_adopted_collected_and_sent() {
    let mut bench = Bench::with_weights(0..=0);
    assert_eq!(names(&bench.assign(1, 1, &[0, 1])), ["restore"]);
    let done = bench.give(ActorInput::Restored { envs: (), failed: Vec::new() });
    assert_eq!(names(&done), ["reply", "adopt"]);
    assert_eq!(replies(&done), [(1, ControlReply::Followed { epoch: Epoch(1) })]);
    assert_eq!(names(&bench.collected(0, Some(0))), ["collect"]);
    assert_eq!(names(&bench.collected(2, Some(1))), ["publish"]);
    assert_eq!(bench.actor.outbox.sent, Sequence(2));
}

#[test]
fn orders_that_nobody_could_follow_in_time_are_dropped_and_given_again() {
    let mut bench = Bench::with_weights(0..=0);
    bench.assign(0, 1, &[0]);
    for epoch in 2..10 * MAX_ORDERS as u64 {
        bench.assign(0, epoch, &[0]);
        bench.assign(0, 1, &[0]);
    }
    assert_eq!(bench.actor.orders.len(), MAX_ORDERS);
    assert_eq!(bench.actor.restoring.as_ref().unwrap().replies.len(), MAX_ORDERS);
}

#[test]
fn a_wait_is_named_after_what_is_missing() {
    let mut bench = Bench::with_weights(0..=0);
    assert_eq!(bench.actor.waits_for(), Some(CollectWait::Environments));
    bench.follow(1, 1, 0);
    assert_eq!(bench.actor.waits_for(), None, "it collects");
    // A window's worth is not acknowledged, and version 1 is not here.
    bench.collected(4, Some(1));
    assert_eq!(bench.actor.waits_for(), Some(CollectWait::Credit));
    bench.credit(4, 8);
    assert_eq!(bench.actor.waits_for(), Some(CollectWait::Weights));
    bench.give(ActorInput::LearnerLeft(LEARNER));
    assert_eq!(bench.actor.waits_for(), Some(CollectWait::Learner));
}

#[test]
fn an_environment_that_cannot_be_restored_is_reported_and_the_rest_go_on() {
    let mut bench = Bench::with_weights(0..=0);
    bench.assign(1, 7, &[0, 1]);
    assert!(bench.assign(2, 7, &[0, 1]).is_empty(), "given again while it is restored");
    let done = bench.give(ActorInput::Restored { envs: (), failed: vec![EnvId(1)] });
    let answer = ControlReply::CannotRestore { epoch: Epoch(7), envs: vec![EnvId(1)] };
    assert_eq!(replies(&done), [(1, answer.clone()), (2, answer.clone())]);
    assert_eq!(replies(&bench.assign(3, 7, &[0, 1])), [(3, answer)], "and again");
    assert_eq!(names(&bench.collected(0, Some(0))), ["collect"], "the other environment");
    bench.assign(4, 8, &[1]);
    let done = bench.give(ActorInput::Restored { envs: (), failed: Vec::new() });
    assert_eq!(replies(&done), [(4, ControlReply::Followed { epoch: Epoch(8) })]);
}

#[test]
fn an_actor_without_credit_asks_again_less_and_less_often() {
    let mut bench = Bench::new(5..=5);
    bench.follow(1, 1, 5);
    let mut hellos = Vec::new();
    for second in 1..=90_u64 {
        if names(&bench.wait(Duration::from_secs(1))).contains(&"hello") {
            hellos.push(second);
            bench.welcomed(LEARNER);
        }
    }
    assert_eq!(hellos, [6, 17, 38, 79]);
    assert!(names(&bench.credit(0, 4)).is_empty());
    for _ in 0..20 {
        assert!(!names(&bench.wait(Duration::from_secs(1))).contains(&"hello"));
        bench.credit(0, 4);
    }
    bench.wait(Duration::from_secs(6));
    assert!(bench.actor.is_greeting(), "credit begins the count anew");
}

#[test]
fn an_actor_at_work_does_not_ask_for_credit() {
    let mut bench = Bench::with_weights(0..=0);
    assert_eq!(names(&bench.follow(1, 1, 0)), ["collect"]);
    for _ in 0..60 {
        assert_eq!(names(&bench.wait(Duration::from_secs(1))), [""; 0]);
    }
    assert_eq!(names(&bench.collected(2, Some(1))), ["publish"]);
    // Nobody acknowledges it: the learner does not count on this actor any more.
    assert_eq!(names(&bench.wait(ACK_TIMEOUT + Duration::from_millis(1))), ["hello"]);
}

#[test]
fn environments_that_went_on_elsewhere_are_let_go_and_others_asked_for() {
    let mut bench = Bench::with_weights(5..=40);
    // The order was followed too late: the learner has given this actor up, and its weights are gone.
    let told = bench.follow(1, 1, 4);
    let pulled = told.iter().filter_map(|output| match output {
        ActorOutput::Pull { version, .. } => Some(version.0),
        _ => None,
    });
    // What it needs first, and what it will need, as much of it as may be under way.
    assert!(pulled.eq(4..4 + MAX_PULLS as u64));
    let told = bench.give(ActorInput::PullFailed { version: PolicyVersion(4), not_kept: true });
    assert_eq!(names(&told), ["hello"]);
    assert_eq!(names(&bench.welcomed(LEARNER)), ["adopt"]);
    assert!(bench.collected(0, None).is_empty());
    assert!(bench.actor.next.is_none());
}

#[test]
fn a_new_learner_starts_everything_over() {
    let mut bench = Bench::with_weights(0..=0);
    bench.follow(1, 5, 0);
    bench.assign(2, 6, &[1]);
    let next = Incarnation(101);
    assert_eq!(names(&bench.give(ActorInput::LearnerJoined(next))), ["hello"]);
    assert!(bench.actor.is_greeting());
    bench.welcomed(next);
    let late = bench.give(ActorInput::Restored { envs: (), failed: Vec::new() });
    assert_eq!(replies(&late), [], "nobody waits for the answer any more");
    bench.collected(1, Some(1));
    assert_eq!(bench.actor.outbox.made, Sequence(0), "made for the learner before");
    assert_eq!(names(&bench.assign(3, 1, &[0])), ["restore"], "its epochs count anew");
}

#[test]
fn what_is_made_while_a_new_learner_reads_the_hello_is_not_sent_to_it() {
    let mut bench = Bench::with_weights(0..=0);
    assert_eq!(names(&bench.follow(1, 5, 0)), ["collect"]);
    let next = Incarnation(101);
    let told = bench.give(ActorInput::LearnerLeft(LEARNER));
    let [ActorOutput::Hello { hello, .. }] = &told[..] else { panic!("{told:?}") };
    let published = hello.published;
    assert!(bench.collected(2, Some(1)).is_empty(), "the job ends while the learner is looked for");
    assert!(!names(&bench.welcomed(next)).contains(&"publish"));
    assert_eq!(bench.actor.outbox.made, published);
    assert_eq!(names(&bench.assign(2, 1, &[0])), ["restore"]);
    // The next hello names what was made before it, and that is sent.
    let mut bench = Bench::with_weights(0..=0);
    bench.follow(1, 5, 0);
    bench.give(ActorInput::LearnerLeft(LEARNER));
    bench.collected(2, Some(1));
    bench.give(ActorInput::NotWelcomed(Box::new(leadtime_link::Error::Dead)));
    bench.now = bench.actor.wakes_at().unwrap();
    let told = bench.give(ActorInput::Tick);
    let [ActorOutput::Hello { hello, .. }] = &told[..] else { panic!("{told:?}") };
    assert_eq!(hello.published, Sequence(2));
    assert!(names(&bench.welcomed(next)).contains(&"publish"));
    assert_eq!((bench.actor.outbox.made, bench.actor.outbox.sent), (Sequence(2), Sequence(2)));
}

#[test]
fn a_learner_that_is_back_gets_what_was_made_meanwhile() {
    let mut bench = Bench::with_weights(0..=0);
    bench.follow(1, 5, 0);
    bench.give(ActorInput::LearnerLeft(LEARNER));
    bench.collected(2, Some(1));
    assert!(names(&bench.welcomed(LEARNER)).contains(&"publish"));
    assert_eq!(bench.actor.outbox.sent, Sequence(2));
}

#[test]
fn a_hello_that_fails_is_said_again_until_time_is_over() {
    let mut bench = Bench::new(0..=0);
    assert_eq!(names(&bench.give(ActorInput::LearnerLeft(LEARNER))), ["hello"]);
    let failed = || ActorInput::NotWelcomed(Box::new(leadtime_link::Error::Dead));
    let started = bench.now;
    while bench.now < started + PATIENCE {
        assert!(bench.give(failed()).is_empty());
        bench.now = bench.actor.wakes_at().expect("it tries again");
        assert_eq!(names(&bench.give(ActorInput::Tick)), ["hello"]);
    }
    let end = bench.give(failed());
    assert!(matches!(end[..], [ActorOutput::End(Err(Error::LearnerLost { .. }))]), "{end:?}");
    assert_eq!(bench.actor.n_reconnects, 1);
}

#[test]
fn an_actor_that_is_refused_dismissed_or_cut_off_leaves() {
    let taken = leadtime_link::Error::Taken(ActorId::new("a").unwrap());
    let mut bench = Bench::new(0..=0);
    bench.give(ActorInput::LearnerLeft(LEARNER));
    let end = bench.give(ActorInput::NotWelcomed(Box::new(taken)));
    assert!(matches!(end[..], [ActorOutput::End(Err(Error::Link(_)))]), "{end:?}");
    // The order to leave did not come through, because it looked for its learner.
    let ending = leadtime_link::Error::Ending { run: RunName::new("r").unwrap() };
    let mut bench = Bench::new(0..=0);
    bench.give(ActorInput::LearnerLeft(LEARNER));
    let end = bench.give(ActorInput::NotWelcomed(Box::new(ending)));
    assert!(matches!(end[..], [ActorOutput::End(Ok(ActorEnd::Dismissed { .. }))]), "{end:?}");
    for cut_off in [false, true] {
        let mut bench = Bench::new(0..=0);
        let control = Control::Stop { reason: "enough".to_owned(), cut_off };
        let order = |learner| ActorInput::Order { learner, control: control.clone(), reply: 1 };
        assert!(!names(&bench.give(order(Incarnation(101)))).contains(&"reply"), "another's");
        let told = bench.give(order(LEARNER));
        assert_eq!(names(&told), ["reply", "end"]);
        let Some(ActorOutput::End(end)) = told.last() else { panic!() };
        assert_eq!(end.is_err(), cut_off);
    }
}

#[test]
fn a_run_that_cannot_be_is_not_joined() {
    let impossible: [fn(&mut RunSpec); 3] = [
        |spec| spec.policy.obs_dim = 9,
        |spec| {
            let head = |name: char| Head { name: name.to_string(), n_choices: 2 };
            spec.env.actions.heads = ('a'..).take(limits::MAX_HEADS + 1).map(head).collect();
            spec.policy.actions = spec.env.actions.clone();
        },
        |spec| spec.n_steps = 0,
    ];
    for make in impossible {
        let mut welcome = welcome(LEARNER, 0..=0);
        make(&mut welcome.spec);
        let settings = Bench::new(0..=0).actor.settings;
        let refused = Actor::<(), u32, ()>::new(settings, welcome, Instant::now());
        assert!(matches!(refused.unwrap_err(), Error::Spec(_)));
    }
}

#[test]
fn waiting_rollouts_are_handed_over_together_and_the_rest_once_those_are_sent() {
    let mut bench = Bench::with_weights(0..=0);
    let sizes = |outputs: Vec<ToDo>| {
        let size = |output: &ToDo| match output {
            ActorOutput::Publish(rollouts) => Some(rollouts.len()),
            _ => None,
        };
        outputs.iter().filter_map(size).collect::<Vec<_>>()
    };
    bench.follow(1, 1, 0);
    assert_eq!(sizes(bench.collected(200, Some(1))), [4], "a window");
    assert_eq!(sizes(bench.credit(2, 6)), [0; 0], "the thread is busy");
    assert_eq!(sizes(bench.give(ActorInput::Published)), [2]);
    assert_eq!(sizes(bench.give(ActorInput::Published)), [0; 0]);
    assert_eq!(sizes(bench.credit(6, 200)), [PUBLISHING]);
}

#[test]
fn a_leaving_actor_finishes_and_sends_its_rollout_and_begins_no_other() {
    let mut bench = Bench::with_weights(0..=0);
    assert_eq!(names(&bench.follow(1, 1, 0)), ["collect"]);
    bench.actor.begin_leaving();
    assert!(bench.actor.is_busy(), "a rollout is being made");
    assert_eq!(names(&bench.assign(2, 2, &[0])), [""; 0], "nothing is begun any more");
    assert_eq!(names(&bench.collected(1, Some(1))), ["publish"]);
    assert!(bench.actor.is_busy(), "it is being sent");
    assert!(bench.give(ActorInput::Published).is_empty());
    assert!(!bench.actor.is_busy());
    let progress = bench.actor.progress(7);
    assert_eq!((progress.n_steps, progress.n_unacknowledged), (7, 1));
    bench.credit(1, 9);
    assert_eq!(bench.actor.progress(7).n_unacknowledged, 0);
}

#[test]
fn only_the_newest_presence_heard_during_a_hello_counts() {
    let (left, joined) = (ActorInput::LearnerLeft(LEARNER), ActorInput::LearnerJoined(LEARNER));
    let mut bench = Bench::new(0..=0);
    assert_eq!(names(&bench.give(left)), ["hello"]);
    for _ in 0..3 {
        bench.give(ActorInput::LearnerJoined(LEARNER));
        bench.give(ActorInput::LearnerLeft(LEARNER));
    }
    assert!(bench.give(joined).is_empty());
    bench.welcomed(LEARNER);
    assert!(!bench.actor.is_greeting(), "it is back: losses before that are out of date");
    assert_eq!(bench.actor.n_reconnects, 1);
    bench.give(ActorInput::LearnerLeft(LEARNER));
    bench.give(ActorInput::LearnerLeft(LEARNER));
    assert_eq!(names(&bench.welcomed(LEARNER)), ["hello"], "gone after it had answered");
    bench.give(ActorInput::LearnerJoined(Incarnation(101)));
    assert_eq!(names(&bench.welcomed(LEARNER)), ["hello"], "the answer of the one before");
    bench.welcomed(Incarnation(101));
    assert!(!bench.actor.is_greeting());
}

#[test]
fn a_hello_that_is_not_answered_may_take_longer_the_next_time_and_no_two_actors_keep_step() {
    let hellos = |incarnation: u64| {
        let mut bench = Bench::new(0..=0);
        let mut settings = bench.actor.settings.clone();
        settings.start = StartKey::numbered(incarnation);
        bench.actor = Actor::new(settings, welcome(LEARNER, 0..=0), bench.now).unwrap();
        let mut told = bench.give(ActorInput::LearnerLeft(LEARNER));
        let mut hellos = Vec::new();
        for _ in 0..6 {
            let [ActorOutput::Hello { timeout, .. }] = told[..] else { panic!("{told:?}") };
            bench.give(ActorInput::NotWelcomed(Box::new(leadtime_link::Error::Dead)));
            let due = bench.actor.wakes_at().unwrap();
            hellos.push((timeout, due - bench.now));
            bench.now = due;
            told = bench.give(ActorInput::Tick);
        }
        hellos
    };
    let first = hellos(1);
    for ((timeout, pause), most) in first.iter().zip([2_u64, 4, 8, 10, 10, 10]) {
        let most = Duration::from_secs(most);
        assert!((most.mul_f64(0.75)..=most).contains(timeout), "{first:?}");
        assert!(*pause <= MAX_BACK_OFF);
    }
    assert_eq!(first, hellos(1), "a named stream, not the clock");
    assert!(first.iter().zip(hellos(2)).all(|(a, b)| *a != b));
}

#[test]
fn an_actor_that_followed_a_number_beyond_every_learners_starts_over_when_it_is_welcome() {
    let mut bench = Bench::with_weights(0..=0);
    bench.follow(1, MAX_HEARD_EPOCH + 1, 0);
    let told = bench.assign(2, 5, &[0]);
    let astray = ControlReply::Followed { epoch: Epoch(MAX_HEARD_EPOCH + 1) };
    assert_eq!(replies(&told), [(2, astray)], "so its learner hears of it");
    bench.give(ActorInput::LearnerLeft(LEARNER));
    bench.welcomed(LEARNER);
    bench.collected(1, Some(1));
    assert_eq!((bench.actor.outbox.made, bench.actor.next), (Sequence(0), None), "it lets go");
    assert_eq!(names(&bench.assign(3, 5, &[0])), ["restore"]);
}
