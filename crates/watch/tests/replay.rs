//! A recorded run, replayed: what its page knows at the end is the same every time.
//!
//! `run.jsonl` was recorded with the example `record`: a learner and two actors on CartPole, one of which was killed; then
//! the learner was killed and started again.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on says where")]

use leadtime_watch::{RunView, screen};
use serde_json::Value;

const RECORDED: &str = include_str!("data/run.jsonl");

/// Takes in one recorded event.
fn take_in(view: &mut RunView, line: &Value) {
    let now = 1_000.0 + line["at"].as_f64().unwrap();
    let start = line["start"].as_str().unwrap();
    let (role, id) = line["member"].as_str().unwrap_or("learner/learner").split_once('/').unwrap();
    let told = line["told"].clone();
    match (line["event"].as_str().unwrap(), role) {
        ("about", _) => view.about(told, now),
        ("metrics", "learner") => {
            view.learner_says(start, told, now);
        }
        ("metrics", _) => view.actor_says(id, start, &told, now),
        ("joined", "learner") => {
            view.learner_joined(start, now);
        }
        ("joined", _) => view.actor_joined(id, start, now),
        ("left", "learner") => view.learner_left(start, now),
        ("left", _) => view.actor_left(id, start, now),
        other => panic!("{other:?}"),
    }
}

fn events() -> Vec<Value> {
    RECORDED.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn replayed(events: &[Value]) -> (RunView, f64) {
    let mut view = RunView::new("recorded");
    for event in events {
        take_in(&mut view, event);
    }
    (view, 1_000.0 + events.last().unwrap()["at"].as_f64().unwrap())
}

#[test]
fn a_recorded_run_becomes_the_page_that_it_was() {
    let (view, now) = replayed(&events());
    let mut told = view.json(now);
    // The curves are long; what matters of them stands in their first and last points.
    let history = told["history"].take();
    let x: Vec<u64> =
        history["x"].as_array().unwrap().iter().map(|x| x.as_u64().unwrap()).collect();
    assert!(x.is_sorted_by(|a, b| a < b), "no update twice");
    told["about"]["config"] = "left out".into();
    insta::assert_snapshot!(serde_json::to_string_pretty(&told).unwrap());
    insta::assert_snapshot!(screen(&view, now));
}
