//! Traces: the timeline of a run, as a viewer would read it.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::support::{
    PATIENCE, Place, family, is_alive, record, signal, updates, wait_for_updates, wait_until,
};

const RUN: &str = "-c cartpole --set learner.n_steps=32 --set run.checkpoint_every=8 --set evaluation.during_training=2";
/// A run of 40 updates.
const SHORT: &str = "up --actors 2 --steps 5120";
/// A run that does not end by itself while a test looks at it.
const LONG: &str = "up --actors 2 --set learner.total_steps=100000000";

/// One span on a thread's line; times in nanoseconds.
struct Span {
    process: String,
    thread: String,
    name: String,
    category: String,
    start: i64,
    end: i64,
    /// The whole event.
    event: Value,
}

impl Span {
    fn seconds(&self) -> f64 {
        (self.end - self.start) as f64 * 1e-9
    }

    fn arg(&self, name: &str) -> u64 {
        self.event["args"][name].as_u64().unwrap_or_else(|| panic!("{name}: {}", self.event))
    }
}

/// Reads every event of a trace, and the spans on threads with the names of their processes and threads.
fn read(text: &str) -> (Vec<Value>, Vec<Span>) {
    let events: Vec<Value> = serde_json::from_str(text).unwrap();
    let name = |wanted: &str, of: &Value| {
        let is_it = |event: &&Value| {
            event["name"] == wanted
                && event["pid"] == of["pid"]
                && (wanted == "process_name" || event["tid"] == of["tid"])
        };
        let named = events.iter().find(is_it).unwrap_or_else(|| panic!("{wanted}: {of}"));
        named["args"]["name"].as_str().unwrap().to_owned()
    };
    let ns = |value: &Value| (value.as_f64().unwrap() * 1e3).round() as i64;
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    let spans = events.iter().filter(|event| event["ph"] == "X").map(|event| Span {
        process: name("process_name", event),
        thread: name("thread_name", event),
        name: text(&event["name"]),
        category: text(&event["cat"]),
        start: ns(&event["ts"]),
        end: ns(&event["ts"]) + ns(&event["dur"]),
        event: event.clone(),
    });
    let spans = spans.collect();
    (events, spans)
}

/// Asserts that the spans of every thread lie one after the other or one inside another, and that waits and work never overlap.
fn are_nested(spans: &[Span]) {
    let mut lines: BTreeMap<String, Vec<&Span>> = BTreeMap::new();
    for span in spans {
        let line = format!("{} {}", span.event["pid"], span.event["tid"]);
        lines.entry(line).or_default().push(span);
    }
    for mut line in lines.into_values() {
        line.sort_by_key(|span| (span.start, -span.end));
        let mut open: Vec<&Span> = Vec::new();
        for span in line {
            open.retain(|outer| outer.end > span.start);
            for outer in &open {
                let (a, b) = (&outer.event, &span.event);
                assert!(span.end <= outer.end, "overlap: {a} {b}");
                assert!([outer, &span].iter().any(|it| it.category == "detail"), "twice: {a} {b}");
            }
            open.push(span);
        }
    }
}

fn sum<'a>(spans: impl Iterator<Item = &'a Span>) -> f64 {
    spans.map(Span::seconds).sum()
}

/// Sums a number over all updates of a run.
fn in_metrics(run: &Path, name: &str) -> f64 {
    let journal = fs::read_to_string(run.join("metrics.jsonl")).unwrap();
    let lines = journal.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    lines.map(|line| line[name].as_f64().unwrap()).sum()
}

#[track_caller]
fn agree(what: &str, trace: f64, metrics: f64) {
    // Every span is rounded to a nanosecond.
    assert!(
        (trace - metrics).abs() < 1e-6,
        "{what}: {trace} s in the trace, {metrics} s in the metrics"
    );
}

#[test]
fn a_trace_agrees_with_the_metrics_and_changes_no_bit() {
    let place = Place::new();
    let plain = place.finish(&[SHORT, RUN, "--name plain"]).with_code(0);
    assert!(!plain.stderr.contains("Trace:"), "{}", plain.stderr);
    let traced = place.finish(&[SHORT, RUN, "--name traced --trace flight.json"]).with_code(0);
    let of = |name: &str| record(&place.run(name))["result"]["weights_sha256"].clone();
    assert_eq!(of("plain"), of("traced"));
    let traced = traced.saying(&[
        "Trace: flight.json has ",
        "2 actors  collect ",
        "learner   train ",
        "Both wait, in turn",
    ]);
    assert!(traced.stderr.contains("update "), "{}", traced.stderr);

    let (events, spans) = read(&fs::read_to_string(place.file("flight.json")).unwrap());
    let processes: BTreeSet<&str> = spans.iter().map(|span| &*span.process).collect();
    assert_eq!(processes, BTreeSet::from(["actor-1", "actor-2", "learner"]));
    are_nested(&spans);
    let on = |thread: &'static str| spans.iter().filter(move |span| span.thread == thread);
    let named = |name: &'static str| spans.iter().filter(move |span| span.name == name);
    let versions: Vec<u64> = named("update").map(|span| span.arg("version")).collect();
    assert_eq!(versions, (1..=40).collect::<Vec<_>>());
    assert_eq!(named("evaluate").count(), 2);

    // What came after the last update is in no line of the metrics.
    let last = named("update").map(|span| span.end).max().unwrap();
    let run = place.run("traced");
    let before = |span: &&Span| span.start < last;
    agree("train", sum(named("update")), in_metrics(&run, "system/train_seconds"));
    let waits = on("train").filter(|span| span.category == "wait");
    let waits = waits.filter(before).filter(|span| span.name != "wait for the checkpoint");
    agree("wait", sum(waits), in_metrics(&run, "system/wait_seconds"));
    let weights = on("loop").filter(|span| span.name == "weights" && span.arg("version") > 0);
    agree("weights", sum(weights), in_metrics(&run, "system/weights_seconds"));
    let checkpoints = on("loop").filter(|span| span.name == "checkpoint");
    agree(
        "checkpoint",
        sum(checkpoints.filter(before)),
        in_metrics(&run, "system/checkpoint_seconds"),
    );

    // Of the actors: what each rollout's parts took is what it took, and all that was trained on was made and sent.
    let parts = on("collect").filter(|span| span.category == "work" && span.name != "adopt");
    agree("parts", sum(parts), sum(named("rollouts")));
    let n_sent = named("publish").count() as u64;
    assert!(n_sent >= named("update").map(|span| span.arg("rollouts")).sum());
    assert!(on("collect").any(|span| span.name == "wait for weights"));
    // Arrows lead from a rollout to the update that had waited for it, and from weights to the rollouts that had.
    let ends = |end: &'static str| {
        let ends = events.iter().filter(move |event| event[end] == true);
        ends.map(|event| event["bind_id"].as_u64().unwrap()).collect::<BTreeSet<u64>>()
    };
    let (from, to) = (ends("flow_out"), ends("flow_in"));
    let nowhere: Vec<_> = to.difference(&from).collect();
    assert!(to.len() > 20 && nowhere.is_empty(), "{} ends, from nowhere: {nowhere:?}", to.len());
}

#[test]
fn an_interrupted_trace_is_whole_and_a_killed_one_readable() {
    let place = Place::new();
    let supervisor = place.start(&[LONG, RUN, "--name a --trace a.json"]);
    family(supervisor.id());
    wait_for_updates(&place.run("a"), 20);
    signal("INT", supervisor.id());
    supervisor.finish(PATIENCE).with_code(130).saying(&["Trace: a.json has "]);
    let (_, spans) = read(&fs::read_to_string(place.file("a.json")).unwrap());
    are_nested(&spans);
    assert!(spans.iter().filter(|span| span.name == "update").count() >= 20);

    let supervisor = place.start(&[LONG, RUN, "--name b --trace b.json"]);
    let (learner, actors) = family(supervisor.id());
    let text = || fs::read_to_string(place.file("b.json")).unwrap();
    // What a process did in its last second may be lost with it.
    wait_until("updates are in the trace", PATIENCE, || text().contains("\"update\""));
    signal("KILL", learner);
    wait_until("it is gone", PATIENCE, || !is_alive(learner));
    let (second, _) = family(supervisor.id());
    wait_for_updates(&place.run("b"), updates(&place.run("b")) + 20);
    supervisor.kill();
    for process in actors.into_iter().chain([second]) {
        wait_until("every process is gone", PATIENCE, || !is_alive(process));
    }
    let (_, spans) = read(&format!("{}]", text()));
    are_nested(&spans);
    let learners: BTreeSet<String> = spans
        .iter()
        .filter(|span| span.name == "update")
        .map(|span| span.event["pid"].to_string())
        .collect();
    assert_eq!(learners, BTreeSet::from([learner.to_string(), second.to_string()]));
}

#[test]
fn learner_and_actor_write_traces_of_their_own_and_overwrite_nothing() {
    let place = Place::new();
    let endpoint = place.endpoint("learner");
    let learner =
        place.start(&["learner --steps 5120", RUN, "--trace learner.json --listen", &endpoint]);
    let actor = place.finish(&["actor --json --trace actor.json --id box-7 --connect", &endpoint]);
    let actor = actor.with_code(0).saying(&["Trace: actor.json has "]);
    assert_eq!(actor.json()["acknowledged"], actor.json()["published"]);
    learner.finish(PATIENCE).with_code(0).saying(&["Trace: learner.json has "]);
    for (file, process) in [("learner.json", "learner"), ("actor.json", "box-7")] {
        let spans = read(&fs::read_to_string(place.file(file)).unwrap()).1;
        assert!(!spans.is_empty() && spans.iter().all(|span| span.process == process), "{file}");
    }

    let before = fs::read(place.file("actor.json")).unwrap();
    let refused = place.finish(&[SHORT, RUN, "--name other --trace actor.json"]).with_code(2);
    refused.saying(&["cannot write a trace to actor.json: it is there already"]);
    assert_eq!(fs::read(place.file("actor.json")).unwrap(), before);
    assert!(!place.run("other").exists());
    // A run that does not begin leaves no file.
    let hopeless = "--set run.actors_min=9 --trace hopeless.json";
    place.finish(&[SHORT, RUN, hopeless]).with_code(2);
    assert!(!Path::new(&place.file("hopeless.json")).exists());
}
