//! The playthrough, without a page.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use leadtime_proto::TaskSpec;

use super::*;

/// Keeps what it is told, and stops looking after so many events.
struct Audience {
    told: Mutex<Vec<(EventKind, Value)>>,
    looks: AtomicBool,
    enough: usize,
    full: (flume::Sender<()>, flume::Receiver<()>),
}

impl Audience {
    fn new(enough: usize) -> Arc<Self> {
        let (told, looks) = (Mutex::default(), AtomicBool::new(true));
        Arc::new(Self { told, looks, enough, full: flume::bounded(1) })
    }

    fn wait(&self) -> Vec<(EventKind, Value)> {
        self.full.1.recv_timeout(Duration::from_mins(1)).expect("events come");
        self.told.lock().unwrap().clone()
    }
}

impl FlightWatcher for Audience {
    fn is_watched(&self) -> bool {
        self.looks.load(Ordering::Relaxed)
    }

    fn tell(&self, kind: EventKind, data: &Value) {
        let mut told = self.told.lock().unwrap();
        told.push((kind, data.clone()));
        if told.len() >= self.enough {
            self.looks.store(false, Ordering::Relaxed);
            self.full.0.try_send(()).ok();
        }
    }
}

/// An untrained policy of a built-in world.
fn plan(domain: &'static str) -> (FlightPlan, Vec<u8>) {
    let registry = leadtime_worlds::builtin();
    let task = TaskSpec { domain: domain.to_owned(), settings: "{}".to_owned() };
    let environment = registry.build(&task).unwrap();
    let policy = PolicySpec::dense(environment.spec(), &[8]);
    let parameters = Parameters::initialize(&policy, 1).unwrap();
    let weights = parameters.to_safetensors(&std::collections::BTreeMap::new()).unwrap();
    let topics = ["ascend", "shift_left", "shift_right", "descend"];
    let plan = FlightPlan {
        make: Arc::new(move || registry.build(&task)),
        policy,
        choice: Choice::Sample,
        voice: Voice::shipped(domain, &topics),
        seed: 5,
    };
    (plan, weights)
}

#[test]
fn an_episode_is_told_from_its_beginning_moment_by_moment() {
    let audience = Audience::new(12);
    let flight = FlightThread::start(Arc::clone(&audience) as Arc<dyn FlightWatcher>).unwrap();
    let (plan, weights) = plan("lander");
    flight.plan(Ok(plan));
    flight.policy(7, weights);
    let told = audience.wait();
    let (kind, beginning) = &told[0];
    assert_eq!(
        (*kind, &beginning["flight"], &beginning["version"]),
        (EventKind::Flight, &json!(1), &json!(7))
    );
    assert!(beginning["still"].as_array().unwrap().len() > 1, "ground and zones stand still");
    for (step, (kind, frame)) in told[1..].iter().enumerate() {
        assert_eq!((*kind, &frame["step"]), (EventKind::Frame, &json!(step)));
        assert!(frame.to_string().len() <= 2_048, "{}", frame.to_string().len());
        assert!(!frame["shapes"].as_array().unwrap().is_empty(), "the lander moves");
    }
    // An untrained notifier speaks a lot.
    let said = told.iter().filter_map(|(_, frame)| frame["said"]["words"].as_str());
    assert!(said.clone().count() > 0);
}

#[test]
fn two_watchers_see_the_same_flights() {
    let told = [(); 2].map(|()| {
        let audience = Audience::new(5);
        let flight = FlightThread::start(Arc::clone(&audience) as Arc<dyn FlightWatcher>).unwrap();
        let (plan, weights) = plan("lander");
        flight.plan(Ok(plan));
        flight.policy(7, weights);
        audience.wait()
    });
    assert_eq!(told[0][..5], told[1][..5]);
}

#[test]
fn what_cannot_be_played_is_told() {
    for (plan, weights, problem) in [
        (Err("another release".to_owned()), Vec::new(), "another release"),
        (Ok(plan("lander").0), b"no weights".to_vec(), "cannot be read"),
        (Ok(plan("cue_recall").0), plan("cue_recall").1, "nothing to draw"),
    ] {
        let audience = Audience::new(1);
        let flight = FlightThread::start(Arc::clone(&audience) as Arc<dyn FlightWatcher>).unwrap();
        flight.plan(plan);
        flight.policy(1, weights);
        let told = audience.wait();
        let told = told[0].1["problem"].as_str().unwrap();
        assert!(told.contains(problem), "{told}");
    }
}

#[test]
fn the_thread_ends_with_its_owner() {
    let audience = Audience::new(usize::MAX);
    let flight = FlightThread::start(Arc::clone(&audience) as Arc<dyn FlightWatcher>).unwrap();
    let (plan, weights) = plan("lander");
    flight.plan(Ok(plan));
    flight.policy(1, weights);
    let asked = Instant::now();
    drop(flight);
    assert!(asked.elapsed() < Duration::from_secs(5), "{:?}", asked.elapsed());
}

#[test]
fn what_is_missing_is_waited_for_until_it_is_given_and_no_longer() {
    let (sender, inputs) = flume::bounded(QUEUED);
    let mut flight = FlightLoop::new(inputs, Audience::new(usize::MAX));
    let (plan, weights) = plan("lander");
    sender.send(FlightInput::Plan(Box::new(Ok(plan)))).unwrap();
    sender.send(FlightInput::Policy(1, weights)).unwrap();
    // The end of the test is the end of the wait, were it one.
    let long = Duration::from_mins(10);
    assert!(flight.wait(long).is_ok() && flight.plan.is_some());
    assert!(flight.wait(long).is_ok() && flight.weights.is_some());
    drop(sender);
    assert!(flight.wait(long).is_err());
}
