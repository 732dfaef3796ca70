//! Robots that ask for nothing, through the program: keys of their own, and topics of ROS 2.

use std::time::{Duration, Instant};

use leadtime_link::live::{LiveClientLink, TakenAt};
use leadtime_serve::robot::cdr;
use leadtime_serve::robot::ros2::{ATTACHMENT, Distro, Ros2Names, SourceMark};
use leadtime_serve::{HeardSay, SayEvent};
use serde_json::{Value, json};
use tokio::runtime::Runtime;

use crate::notifier::{self, coming_down, link, policy};
use crate::support::{PATIENCE, Place, Running, WRONG_INPUT, gaps, signal, wait_for_words};

/// Time between two observations.
const PAUSE: Duration = Duration::from_millis(20);
const STATUS: &str = "leadtime/live/1/notifier/arm-1/status";

fn serve(place: &Place, more: &str) -> Running {
    let more = format!("{more} --seconds-per-step 0.05 --client arm-1");
    notifier::serve(place, &more)
}

/// What a lander sees, as numbers alone.
fn numbers(step: i64) -> Vec<u8> {
    coming_down(step as f32).iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// The same as our JSON, with more keys.
fn json_of(step: i64, more: &Value) -> Message {
    let mut observation = json!({"obs": coming_down(step as f32)});
    observation.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
    (observation.to_string().into_bytes(), None)
}

/// The same as a message of ROS 2.
fn array(step: i64) -> Vec<u8> {
    [&[0, 1, 0, 0][..], &[0; 8], &[8, 0, 0, 0], &numbers(step)].concat()
}

/// A message and what is beside it.
type Message = (Vec<u8>, Option<Vec<u8>>);

/// A robot, or anybody else on the network.
struct Robot {
    runtime: Runtime,
    link: LiveClientLink,
    status: TakenAt,
    statuses: Vec<Value>,
}

impl Robot {
    fn connect(place: &Place) -> Self {
        let (runtime, link) = link(place);
        let status = link.take_at(STATUS).unwrap();
        Self { runtime, link, status, statuses: Vec::new() }
    }

    /// Sends observations until enough sentences were started; returns everything that was told.
    fn talk(
        &self,
        from: i64,
        to: (&str, &TakenAt),
        observe: impl Fn(i64) -> Message,
        read: impl Fn(&Message) -> HeardSay,
    ) -> Vec<Message> {
        let deadline = Instant::now() + PATIENCE;
        let (mut told, mut n_started, mut step) = (Vec::new(), 0, from);
        while n_started < 3 {
            assert!(Instant::now() < deadline, "{n_started} sentences: {told:?}");
            let (bytes, beside) = observe(step);
            self.link.put_at(to.0, &bytes, beside.as_deref()).unwrap();
            step += 1;
            let next = Instant::now() + PAUSE;
            while let Some(message) = to.1.next(next.saturating_duration_since(Instant::now())) {
                n_started += usize::from(read(&message).event == SayEvent::Start);
                told.push(message);
            }
        }
        told
    }

    /// Takes statuses until one holds.
    #[track_caller]
    fn wait(&mut self, what: &str, holds: impl Fn(&Value) -> bool) {
        let deadline = Instant::now() + PATIENCE;
        loop {
            assert!(Instant::now() < deadline, "{what}: {:?}", self.statuses.last());
            if let Some((status, _)) = self.status.next(PAUSE) {
                self.statuses.push(serde_json::from_slice(&status).unwrap());
                if holds(self.statuses.last().unwrap()) {
                    return;
                }
            }
        }
    }
}

fn event(message: &Message) -> HeardSay {
    HeardSay::read(&message.0).expect("an event")
}

fn text_event(message: &Message) -> HeardSay {
    HeardSay::read(cdr::string(&message.0).expect("a String of ROS 2").as_bytes())
        .expect("an event")
}

#[test]
fn a_robot_with_keys_of_its_own_is_told_what_to_say_and_is_never_given_up() {
    let place = Place::new();
    let arguments = "--obs-key robot1/obs --say-key robot1/say --state state";
    let notifier = serve(&place, arguments);
    let mut robot = Robot::connect(&place);
    let said = robot.link.take_at("robot1/say").unwrap();
    let to = ("robot1/obs", &said);
    let told = robot.talk(0, to, |step| (numbers(step), None), event);
    let seqs: Vec<u64> = told.iter().map(|message| event(message).seq).collect();
    assert!(seqs.is_sorted() && *seqs.last().unwrap() > 3, "{seqs:?}");
    // Nobody else may take its place.
    let (service, client) = ("notifier".parse().unwrap(), "arm-1".parse().unwrap());
    let port = robot.link.port(&service, &client, leadtime_proto::Incarnation(1)).unwrap();
    let question = br#"{"protocol":1,"domain":"lander"}"#.to_vec();
    let refusal = robot.runtime.block_on(port.ask(question)).unwrap_err().to_string();
    assert!(refusal.contains("a client named `arm-1` is here already"), "{refusal}");
    // What it cannot use it says, with the option that helps; more of it than ends anybody else's session.
    for n in 1..=40 {
        robot.link.put_at("robot1/obs", br#"{"obs":[1]}"#, None).unwrap();
        robot.wait("refused", |status| status["refused"].as_u64() >= Some(n));
    }
    // So does the log, once a minute.
    wait_for_words(&notifier, "refused; of the last one:");
    let is_told = |status: &Value| {
        status["told"].as_str().unwrap().ends_with("it looks like JSON: --obs-form json")
    };
    assert!(robot.statuses.iter().any(is_told), "{:?}", robot.statuses.last());
    robot.wait("lost", |status| status["state"] == "lost");
    robot.talk(0, to, |step| (numbers(step), None), event);
    // Killed and started again, the notifier goes on with the same session, whose numbers go on.
    robot.wait("kept", |status| status["state"] == "lost");
    let kept = robot.statuses.last().unwrap().clone();
    notifier.kill();
    drop((robot, said));
    let again = serve(&place, arguments);
    let robot = Robot::connect(&place);
    let said = robot.link.take_at("robot1/say").unwrap();
    let told = robot.talk(0, ("robot1/obs", &said), |step| (numbers(step), None), event);
    assert!(event(&told[0]).seq > kept["last_seq"].as_u64().unwrap(), "{kept}: {told:?}");
    let (status, _) = robot.status.next(PATIENCE).unwrap();
    let status: Value = serde_json::from_slice(&status).unwrap();
    assert_eq!(status["session"], kept["session"]);
    again.kill();
    drop((robot, said));
    // Another robot does not go on with what this one was told.
    let _other = serve(&place, "--obs-key robot2/obs --say-key robot2/say --state state");
    let robot = Robot::connect(&place);
    let (status, _) = robot.status.next(PATIENCE).unwrap();
    let status: Value = serde_json::from_slice(&status).unwrap();
    assert_ne!(status["session"], kept["session"]);
    assert_eq!(status["last_seq"], 0, "{status}");
}

#[test]
fn what_a_robot_observes_on_its_own_key_is_recorded_and_a_restart_of_the_notifier_is_a_gap() {
    let place = Place::new();
    let to = place.endpoint("n");
    let router = place.start(&["router --listen", &to]);
    wait_for_words(&router, "router listens");
    let start = || {
        let arguments = "--obs-key robot1/obs --obs-form json --say-key robot1/say --client arm-1 \
                         --state state --seconds-per-step 0.05";
        let notifier = place.start(&["serve", &policy(), arguments, "--connect", &to]);
        wait_for_words(&notifier, "is at work");
        notifier
    };
    let observe = |step: i64| json_of(step, &json!({"episode": step / 20}));
    let notifier = start();
    let recorder = place.start(&["record -o r.mcap --connect", &to]);
    wait_for_words(&recorder, "recording notifier");
    let mut robot = Robot::connect(&place);
    let said = robot.link.take_at("robot1/say").unwrap();
    // The recorder is told of the session before the robot comes.
    robot.wait("at work", |status| status["state"] == "waiting");
    robot.talk(0, ("robot1/obs", &said), observe, event);
    robot.wait("lost", |status| status["state"] == "lost");
    robot.wait("kept", |status| status["state"] == "lost");
    notifier.kill();
    let notifier = start();
    robot.talk(1, ("robot1/obs", &said), observe, event);
    robot.talk(20, ("robot1/obs", &said), observe, event);
    signal("INT", recorder.id());
    recorder.finish(PATIENCE).with_code(0);
    drop((notifier, router));
    let out = place.finish(&["replay r.mcap --json"]).with_code(0).json();
    let [before, after] = &out["sessions"].as_array().unwrap()[..] else { panic!("{out}") };
    assert_eq!(before["session"], after["session"]);
    assert_ne!(before["notifier_start"], after["notifier_start"]);
    for session in [before, after] {
        assert_eq!(session["client"], "notifier/arm-1");
        assert_eq!(session["difference"], Value::Null);
        assert!(session["replayed"]["messages"].as_u64() > Some(1), "{session}");
    }
    assert_eq!(gaps(before), [""; 0]);
    assert_eq!(gaps(after), ["the notifier was started again, and what came before is not told"]);
    assert!(after["observations_not_compared"].as_u64() > Some(0), "{after}");
}

#[test]
fn a_robot_may_send_json_or_cdr_and_be_told_in_24_bytes() {
    let place = Place::new();
    let keys = "--obs-key robot1/obs --say-key robot1/say";
    let json = |step: i64| json_of(step, &json!({"facts": ["zone_below"]}));
    {
        let _notifier = serve(&place, &format!("{keys} --obs-form json --say-form binary"));
        let robot = Robot::connect(&place);
        let said = robot.link.take_at("robot1/say").unwrap();
        let told = robot.talk(0, ("robot1/obs", &said), json, event);
        assert!(told.iter().all(|(bytes, _)| bytes.len() == 24));
    }
    let place = Place::new();
    let _notifier = serve(&place, &format!("{keys} --obs-form cdr"));
    let robot = Robot::connect(&place);
    let said = robot.link.take_at("robot1/say").unwrap();
    robot.talk(0, ("robot1/obs", &said), |step| (array(step), None), text_event);
}

#[test]
fn a_node_of_ros_is_spoken_to_as_rmw_zenoh_speaks() {
    let place = Place::new();
    let _notifier = serve(&place, "--ros2 7 --ros2-topic /car_1/leadtime");
    let mut robot = Robot::connect(&place);
    let names = Ros2Names::new(7, Distro::Jazzy, "car_1/leadtime", "notifier").unwrap();
    // It shows itself and its topics.
    let mut tokens = robot.runtime.block_on(robot.link.presence_at("@ros2_lv/7/**")).unwrap();
    let zid = tokens[0].split('/').nth(2).unwrap().to_owned();
    let mut expected = names.tokens(&zid).to_vec();
    tokens.sort();
    expected.sort();
    assert_eq!(tokens, expected);
    let (obs, say) = (names.observations(), names.say());
    let said = robot.link.take_at(&say).unwrap();
    let state = robot.link.take_at(&names.status()).unwrap();
    let observe = |gid: u8| {
        move |number: i64| {
            let time = 1_796_000_000_000_000_000 + number * 20_000_000;
            let mark = SourceMark { number, time, gid: [gid; 16] };
            (array(number), Some(mark.write().to_vec()))
        }
    };
    let told = robot.talk(1, (&obs, &said), observe(1), text_event);
    // What ROS demands beside every message, or its node gives up.
    let marks: Vec<SourceMark> = told
        .iter()
        .map(|(_, beside)| SourceMark::read(beside.as_ref().expect("something beside")).unwrap())
        .collect();
    assert_eq!(told[0].1.as_ref().map(Vec::len), Some(ATTACHMENT));
    let numbers: Vec<i64> = marks.iter().map(|mark| mark.number).collect();
    assert_eq!(numbers, (1..=numbers.len() as i64).collect::<Vec<_>>());
    assert!(
        marks.windows(2).all(|pair| pair[0].gid == pair[1].gid && pair[0].time <= pair[1].time)
    );
    assert!(marks[0].time > 1_700_000_000_000_000_000, "{:?}", marks[0]);
    let (status, beside) = state.next(PATIENCE).unwrap();
    assert!(cdr::string(&status).unwrap().contains(r#""state":"#), "{status:?}");
    assert!(beside.is_some());
    // A second node at the same time is refused; once the first is silent it is listened to, and counts from 1.
    let (bytes, beside) = observe(2)(1);
    robot.link.put_at(&obs, &bytes, beside.as_deref()).unwrap();
    robot.wait("refused", |status| status["told"].as_str().unwrap().contains("two sources"));
    robot.wait("lost", |status| status["state"] == "lost");
    robot.talk(1, (&obs, &said), observe(2), text_event);
}

#[test]
fn arguments_about_a_robot_that_cannot_be_are_told_in_one_sentence() {
    let place = Place::new();
    let listen = format!("--listen {}", place.endpoint("n"));
    for (arguments, told) in [
        ("--obs-key robot/*", "`robot/*` cannot be a robot's key: it has to be one key"),
        ("--obs-key leadtime/x", "keys below `leadtime/` are ours"),
        ("--obs-key a --say-key a", "observations and what is said need a key each"),
        ("--say-key a", "--obs-key"),
        ("--obs-key a --ros2 1", "cannot be used with"),
        ("--ros2 233", "233 is not in 0..=232"),
        ("--ros2 0 --ros2-topic 1a", "--ros2-topic: `1a` is no name of a ROS topic"),
        ("--ros2-distro humble", "--ros2"),
        ("--clock observation", "--obs-key"),
        ("--obs-key a --seconds-per-step 9", "`seconds_per_step` is 9; allowed: 0.001 to 5"),
        ("--obs-key a --seconds-per-step nan", "write a number of seconds"),
        ("--obs-key a --stale-after inf", "write a number of seconds"),
        ("--obs-key a --client Arm", "not a valid client name"),
    ] {
        place
            .finish(&["serve", &policy(), &listen, arguments])
            .with_code(WRONG_INPUT)
            .saying(&[told]);
    }
}
