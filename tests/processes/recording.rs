//! Recordings of a notifier at work, through the program: nothing is lost to a kill, and a replay says the same.

use std::fs;

use leadtime_link::live::LiveTopic;
use leadtime_recording::{RecordedTopic, RecordingFile, RecordingWriter};
use serde_json::{Value, json};

use crate::notifier::{link, policy, serve};
use crate::support::{
    FAILED, PACE, PATIENCE, PEER_LOST, Place, Running, WRONG_INPUT, gaps, repository, signal,
    wait_for_words, wait_until,
};

/// Starts a recorder and waits until it takes everything.
fn record(place: &Place, file: &str, more: &str) -> Running {
    let recorder = place.start(&["record --connect", &place.endpoint("n"), "-o", file, more]);
    wait_for_words(&recorder, "recording notifier");
    recorder
}

/// Returns the sessions of a replay that found no difference.
#[track_caller]
fn replayed(place: &Place, file: &str) -> Vec<Value> {
    let out = place.finish(&["replay", file, "--json"]).with_code(0).json();
    let sessions = out["sessions"].as_array().unwrap().clone();
    for session in &sessions {
        assert_eq!(session["is_same_policy"], true, "{session}");
        assert_eq!(session["difference"], Value::Null, "{session}");
        assert_eq!(session["events_lost"], 0, "{session}");
    }
    sessions
}

/// Waits until what a recorder has written so far holds something.
#[track_caller]
fn wait_for_sessions(place: &Place, file: &str, holds: impl Fn(&[Value]) -> bool) {
    wait_until("the recording holds it", PATIENCE, || {
        let out = place.finish(&["replay", file, "--json"]);
        let sessions = serde_json::from_str::<Value>(&out.stdout).unwrap_or_default();
        sessions["sessions"].as_array().is_some_and(|sessions| holds(sessions))
    });
}

fn of<'a>(sessions: &'a [Value], client: &str) -> Option<&'a Value> {
    sessions.iter().find(|it| it["client"] == format!("notifier/{client}"))
}

#[test]
fn a_killed_recorder_loses_no_message_before_its_last_second_and_the_same_is_said_again() {
    let place = Place::new();
    let notifier = serve(&place, "");
    let to = place.endpoint("n");
    let recorder = record(&place, "r.mcap", "");
    let drive = format!("--connect {to} {PACE} --episodes 4 --messages-to");
    place.finish(&["drive", &policy(), &drive, "m.jsonl"]).with_code(0);
    let drive = format!("--connect {to} {PACE} --episodes 2 --binary --client brief");
    place.finish(&["drive", &policy(), &drive]).with_code(0);
    // Another client, as raw numbers, without an end; the recorder is killed while it is spoken to.
    let raw = format!("--connect {to} {PACE} --binary --client raw --episodes 100000");
    let driving = place.start(&["drive", &policy(), &raw]);
    let n_fed = |it: &Value| it["observations"].as_u64().unwrap_or(0);
    wait_for_sessions(&place, "r.mcap", |all| of(all, "raw").is_some_and(|it| n_fed(it) > 60));
    recorder.kill();
    drop((driving, notifier));

    let sessions = replayed(&place, "r.mcap");
    let driven = of(&sessions, "drive").unwrap();
    let messages = fs::read_to_string(place.path().join("m.jsonl")).unwrap();
    assert_eq!(driven["recorded"]["messages"], messages.lines().count());
    assert_eq!(driven["replayed"], driven["recorded"]);
    assert_eq!(driven["observations_not_compared"], 0);
    let raw = of(&sessions, "raw").unwrap();
    // An observation and the line that it was taken in come on two ways: of the very last, a kill may leave the line alone.
    let told = raw["gaps"].as_object().unwrap();
    assert!(told.keys().all(|gap| gap == "an observation is missing"), "{raw}");
    assert_eq!(gaps(raw), [""; 0]);
    assert!(n_fed(raw) > 60, "{raw}");

    // Every message, in the words and in the order in which it was heard.
    place.finish(&["play r.mcap -o said.txt"]).with_code(0);
    let said = fs::read_to_string(place.path().join("said.txt")).unwrap();
    let mut rest = said.as_str();
    for line in messages.lines() {
        let message: Value = serde_json::from_str(line).unwrap();
        let text = message["text"].as_str().unwrap();
        let (_, after) = rest.split_once(text).unwrap_or_else(|| panic!("no {line} in {said}"));
        rest = after;
    }
    // Time is counted in steps.
    place.finish(&["play r.mcap -o part.txt --frames 0..1"]).with_code(0);
    let part = fs::read_to_string(place.path().join("part.txt")).unwrap();
    let times = |text: &str| -> Vec<f64> {
        text.lines().filter_map(|line| line.split_once("s  ")?.0.trim().parse().ok()).collect()
    };
    let (all, part) = (times(&said), times(&part));
    assert!(part.iter().all(|time| *time < 1.0) && part.len() < all.len(), "{part:?} of {all:?}");
    assert_eq!(part.len(), all.iter().filter(|time| **time < 1.0).count());
    place.finish(&["play r.mcap -o said.svg --frames 0..24"]).with_code(0);
    let drawn = fs::read_to_string(place.path().join("said.svg")).unwrap();
    assert!(drawn.contains("what was said when") && drawn.contains(">says<"), "{drawn}");

    // The same over the network, and what another policy would have said.
    let notifier = serve(&place, "");
    let sent = format!("replay r.mcap --connect {to} --live drive --json");
    let sent = place.finish(&[&sent]).with_code(0).json();
    assert_eq!(sent["sessions"][0]["replayed"], driven["recorded"]);
    // One that took raw events is compared as well, though it is told less.
    let sent = format!("replay r.mcap --connect {to} --live brief --json");
    let sent = place.finish(&[&sent]).with_code(0).json();
    let brief = of(&sessions, "brief").unwrap();
    assert_eq!(sent["sessions"][0]["is_same_policy"], true, "{sent}");
    assert_eq!(sent["sessions"][0]["replayed"], brief["recorded"]);
    write_with_another_raw_event(&place, "r.mcap", "other.mcap");
    let sent = format!("replay other.mcap --connect {to} --live brief");
    let found = place.finish(&[&sent]).with_code(FAILED);
    found.saying(&["in 1 session, something else is said than was recorded"]);
    drop(notifier);
    let other = repository("deploy/policies/piloting_hard.safetensors");
    let beside = place.finish(&["replay r.mcap --live drive --policy", &other]).with_code(0).stdout;
    assert!(beside.contains("messages") && beside.contains("recorded (k, l)"), "{beside}");
    assert!(beside.lines().all(|line| line.chars().count() <= 80), "{beside}");
    let own = place.finish(&["replay r.mcap --live drive --policy", &policy()]).with_code(0).stdout;
    assert!(own.contains("the same is said, event by event"), "{own}");
}

/// Writes a recording again, where one silence that was put as raw bytes is the end of something.
fn write_with_another_raw_event(place: &Place, from: &str, to: &str) {
    let read = RecordingFile::read(&*fs::read(place.path().join(from)).unwrap()).unwrap();
    let mut bytes = Vec::new();
    let mut changed = RecordingWriter::new(&mut bytes, "a test").unwrap();
    let mut n_changed = 0;
    for client in &read.clients {
        for message in &client.messages {
            let mut json: Value = serde_json::from_slice(&message.json).unwrap();
            let is_raw = json["x_raw"].is_string() && client.name == "notifier/brief";
            let is_first = n_changed == 0 && json["event"] == "silent";
            if is_raw && is_first {
                // The fifth byte says what happens.
                let original = json["x_raw"].as_str().unwrap();
                json["x_raw"] = format!("{}03{}", &original[..8], &original[10..]).into();
                n_changed += 1;
            }
            let key = format!("leadtime/live/1/{}/{}", client.name, message.topic.as_str());
            let text = if is_raw { json.to_string().into_bytes() } else { message.json.clone() };
            changed.write(&key, message.topic, message.at, &text).unwrap();
        }
    }
    assert_eq!(n_changed, 1, "there is silence in some step");
    changed.finish().unwrap();
    drop(changed);
    fs::write(place.path().join(to), bytes).unwrap();
}

#[test]
fn single_messages_may_be_missing_in_a_recording_and_no_more() {
    let session = |gap: &str, n: u64| json!({"observations": 30, "observations_not_compared": 10, "gaps": {gap: n}});
    let missing = "an observation is missing";
    assert_eq!(gaps(&session(missing, 2)), [""; 0]);
    assert_eq!(gaps(&session(missing, 3)), [missing]);
    assert_eq!(gaps(&session("the notifier was started again", 1)).len(), 1);
}

#[test]
fn sentences_said_by_the_clock_are_replayed_exactly_and_a_late_recorder_is_told() {
    let place = Place::new();
    let notifier = serve(&place, "");
    let to = place.endpoint("n");
    let recorder = record(&place, "whole.mcap", "");
    let drive = format!("--connect {to} --seconds-per-step 0.02 --episodes 1000");
    let driving = place.start(&["drive", &policy(), &drive]);
    let is_long =
        |all: &[Value]| of(all, "drive").is_some_and(|it| it["events"].as_u64() > Some(40));
    wait_for_sessions(&place, "whole.mcap", is_long);
    let late = record(&place, "late.mcap", "--live drive");
    // It can be compared from the next episode on.
    wait_for_sessions(&place, "late.mcap", is_long);
    for recorder in [recorder, late] {
        signal("INT", recorder.id());
        let ended = recorder.finish(PATIENCE).with_code(0);
        assert!(ended.stdout.contains("messages of 1 session"), "{}", ended.stdout);
    }
    drop((driving, notifier));
    let whole = replayed(&place, "whole.mcap");
    let whole = of(&whole, "drive").unwrap();
    assert_eq!(gaps(whole), [""; 0]);
    let is_whole = whole["gaps"] == json!({});
    assert!(!is_whole || whole["observations_not_compared"] == 0, "{whole}");
    let late = replayed(&place, "late.mcap");
    let late = of(&late, "drive").unwrap();
    assert_eq!(gaps(late), ["the recording begins in the middle of an episode"]);
    assert!(late["observations_not_compared"].as_u64() > Some(0), "{late}");
    // A notifier over the network has a clock of its own.
    let refused = place.finish(&["replay whole.mcap --connect", &to, "--connect-timeout 1s"]);
    refused.with_code(PEER_LOST);
}

#[test]
fn another_word_in_a_recording_is_found() {
    let place = Place::new();
    let notifier = serve(&place, "");
    let to = place.endpoint("n");
    let recorder = record(&place, "r.mcap", "--stop-after 1m");
    let drive = format!("--connect {to} {PACE} --episodes 2");
    place.finish(&["drive", &policy(), &drive]).with_code(0);
    signal("TERM", recorder.id());
    recorder.finish(PATIENCE).with_code(0);
    drop(notifier);
    replayed(&place, "r.mcap");
    // What was said is told at its time, but not where a program reads the results.
    let paced = "replay r.mcap --speed 1";
    assert!(place.finish(&[paced]).with_code(0).stdout.contains(" s  "), "{paced}");
    place.finish(&[paced, "--json"]).with_code(0).json();
    // One sentence is another, in a file that is sound.
    let read = RecordingFile::read(&*fs::read(place.path().join("r.mcap")).unwrap()).unwrap();
    let (mut other, mut whole) = (Vec::new(), Vec::new());
    let mut changed = RecordingWriter::new(&mut other, "a test").unwrap();
    let mut same = RecordingWriter::new(&mut whole, "a test").unwrap();
    let mut n_changed = 0;
    for client in &read.clients {
        for message in &client.messages {
            let text = String::from_utf8(message.json.clone()).unwrap();
            let is_first = n_changed == 0 && message.topic == RecordedTopic::Live(LiveTopic::Say);
            let is_silent = is_first && text.contains("\"event\":\"silent\"");
            n_changed += usize::from(is_silent);
            let other = if is_silent { "\"event\":\"end\"" } else { "\"event\":\"silent\"" };
            let text = text.replace("\"event\":\"silent\"", other);
            let key = format!("leadtime/live/1/{}/{}", client.name, message.topic.as_str());
            changed.write(&key, message.topic, message.at, text.as_bytes()).unwrap();
            same.write(&key, message.topic, message.at, &message.json).unwrap();
            if same.n_messages() % 30 == 0 {
                same.flush().unwrap();
            }
        }
    }
    assert_eq!(n_changed, 1, "there is silence in some step");
    changed.finish().unwrap();
    drop(changed);
    fs::write(place.path().join("other.mcap"), other).unwrap();
    let found = place.finish(&["replay other.mcap"]).with_code(FAILED);
    assert!(found.stdout.contains("the first difference: observation "), "{}", found.stdout);
    let line = |who: &str| {
        let line = found.stdout.lines().find(|line| line.trim_start().starts_with(who));
        line.unwrap_or_else(|| panic!("{}", found.stdout)).to_owned()
    };
    assert!(line("recorded").contains(": end "), "{}", found.stdout);
    assert!(line("replayed").ends_with(": silent"), "{}", found.stdout);
    found.saying(&["in 1 session, something else is said than was recorded"]);

    // A file that was cut is read as far as it goes; one that is damaged up to there.
    same.finish().unwrap();
    drop(same);
    fs::write(place.path().join("cut.mcap"), &whole[..whole.len() * 2 / 3]).unwrap();
    place.finish(&["replay cut.mcap"]).with_code(0).saying(&["ends in the middle"]);
    fs::write(place.path().join("start.mcap"), &whole[..8]).unwrap();
    let nothing = place.finish(&["replay start.mcap"]).with_code(WRONG_INPUT);
    nothing.saying(&["start.mcap: it holds no messages: "]);
    let mut odd = whole.clone();
    let half = whole.len() / 2;
    let in_chunk = whole[half..].windows(5).position(|bytes| bytes == b"\"obs\"").unwrap();
    odd[half + in_chunk] ^= 0x20;
    fs::write(place.path().join("odd.mcap"), odd).unwrap();
    place.finish(&["replay odd.mcap"]).with_code(0).saying(&["is damaged and is read up to there"]);
    let nobody = place.finish(&["replay r.mcap --live nobody"]).with_code(WRONG_INPUT);
    nobody.saying(&["holds no session of `nobody`; it is about: notifier/drive"]);
}

/// Made anew by `examples/live/record_flight.sh` where this fails because its policy was replaced.
#[test]
fn the_flight_that_was_recorded_for_the_documentation_is_said_again() {
    let place = Place::new();
    // The recording names its policy from the root of the repository.
    std::os::unix::fs::symlink(repository("deploy"), place.path().join("deploy")).unwrap();
    let sessions = replayed(&place, &repository("examples/live/flight.mcap"));
    let flight = of(&sessions, "flight").unwrap();
    assert!(flight["events"].as_u64() > Some(20), "{flight}");
    assert_eq!(flight["observations_not_compared"], 0);
}

#[test]
fn names_that_somebody_invents_keep_nobody_out_of_a_recording() {
    let place = Place::new();
    let _notifier = serve(&place, "");
    let recorder = record(&place, "r.mcap", "");
    let (runtime, somebody) = link(&place);
    for i in 0..100 {
        let key = format!("leadtime/live/1/notifier/invented-{i}/status");
        let status = br#"{"session":"s","state":"silent","taken":0}"#;
        somebody.put_at(&key, status, None).unwrap();
    }
    let drive = format!("--connect {} --max-speed --episodes 2 --client real", place.endpoint("n"));
    place.finish(&["drive", &policy(), &drive]).with_code(0);
    wait_for_sessions(&place, "r.mcap", |all| {
        of(all, "real").is_some_and(|it| it["is_same_policy"] == true)
    });
    signal("INT", recorder.id());
    recorder.finish(PATIENCE).with_code(0);
    runtime.block_on(somebody.close()).unwrap();
    let recorded = fs::read(place.path().join("r.mcap")).unwrap();
    let recorded = RecordingFile::read(&*recorded).unwrap();
    let invented = recorded.clients.iter().filter(|it| it.name.starts_with("notifier/invented-"));
    assert_eq!(invented.count(), 100, "the recorder has heard of all of them");
}

#[test]
fn a_recorder_that_cannot_record_says_so_and_overwrites_nothing() {
    let place = Place::new();
    let to = place.endpoint("n");
    let short = "--connect-timeout 1s -o";
    let nobody = place.finish(&["record --connect", &to, short, "a.mcap"]).with_code(PEER_LOST);
    nobody.saying(&["n.sock"]);
    assert!(!place.path().join("a.mcap").exists(), "nothing is left behind");
    let _notifier = serve(&place, "");
    let record =
        |more: &str| place.finish(&["record --connect", &to, "--connect-timeout 1s", more]);
    record("--service other -o a.mcap").with_code(PEER_LOST).saying(&["other", "notifier"]);
    let kept = place.write("kept.mcap", "something of value");
    record("-o kept.mcap").with_code(WRONG_INPUT).saying(&["kept.mcap", "is left as it is"]);
    assert_eq!(fs::read_to_string(kept).unwrap(), "something of value");
    record("-o no/where.mcap").with_code(WRONG_INPUT).saying(&["cannot record to no/where.mcap"]);
    record("-o /dev/full").with_code(WRONG_INPUT).saying(&["is left as it is"]);
    let wrong = place.finish(&["record --connect nowhere -o a.mcap"]).with_code(WRONG_INPUT);
    wrong.saying(&["--connect"]);

    let replay = |file: &str| place.finish(&["replay", file]).with_code(WRONG_INPUT);
    replay("none.mcap").saying(&["none.mcap"]);
    for given in ["--service other", "--client me", "--connect-timeout 9s", "--tls pki/me"] {
        let alone = place.finish(&["replay none.mcap", given]).with_code(WRONG_INPUT);
        alone.saying(&["--connect"]);
    }
    replay("kept.mcap").saying(&["kept.mcap", "it is no MCAP file"]);
    record("-o empty.mcap --stop-after 10ms").with_code(0);
    replay("empty.mcap").saying(&["empty.mcap"]);
    let drawn = place.finish(&["play kept.mcap -o a.png"]).with_code(WRONG_INPUT);
    drawn.saying(&["it is no MCAP file"]);
    for given in
        ["--words lander", "--baseline unaided", "--set a=1", "--action greedy", "--eval-seed 3"]
    {
        let refused = place.finish(&["play kept.mcap -o a.png", given]).with_code(WRONG_INPUT);
        refused.saying(&[given.split_once(' ').unwrap().0, "changes nothing in a recording"]);
    }
}

#[test]
fn a_recorder_says_that_its_notifier_is_gone_and_that_it_is_back() {
    let place = Place::new();
    let notifier = serve(&place, "");
    let recorder = record(&place, "r.mcap", "");
    notifier.kill();
    wait_for_words(&recorder, "notifier `notifier` is gone");
    let _notifier = serve(&place, "");
    wait_for_words(&recorder, "notifier `notifier` is back");
}

#[test]
fn what_is_told_of_a_run_is_recorded_until_it_is_finished() {
    let place = Place::new();
    let there = place.endpoint("l");
    let start = || place.start(&["learner -c cartpole --steps 4096 --name r --listen", &there]);
    let learner = start();
    let recorder =
        place.start(&["record --run r --connect-timeout 60s -o run.mcap --connect", &there]);
    wait_for_words(&recorder, "recording run `r`");
    learner.kill();
    wait_for_words(&recorder, "the learner of run `r` is gone");
    let learner = start();
    wait_for_words(&recorder, "the learner of run `r` is back");
    let actor = place.start(&["actor --id a1 --connect", &there]);
    let recorded = recorder.finish(PATIENCE).with_code(0);
    assert!(recorded.stdout.starts_with("run.mcap: "), "{}", recorded.stdout);
    learner.finish(PATIENCE).with_code(0);
    actor.finish(PATIENCE).with_code(0);
    let bytes = fs::read(place.file("run.mcap")).unwrap();
    let holds = |text: &str| bytes.windows(text.len()).any(|window| window == text.as_bytes());
    for text in [
        "leadtime/1/r/metrics/learner/learner",
        "leadtime/1/r/metrics/actor/a1",
        "\"kind\":\"update\"",
        "\"how\":\"finished\"",
    ] {
        assert!(holds(text), "{text}");
    }
    place
        .finish(&["replay run.mcap"])
        .with_code(WRONG_INPUT)
        .saying(&["it holds no messages of a notifier at work"]);
}
