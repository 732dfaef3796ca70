//! What people ask of a long run: to stop, to go on with other settings, and to hand its metrics on.

use std::collections::BTreeSet;
use std::fs;
use std::process::Command;

use serde_json::Value;

use crate::support::{Place, record, result};

/// A CartPole run of 40 updates with a local actor.
const TRAIN: &str = "up -c cartpole --name r --actors 1 --set learner.n_steps=32 --set learner.total_steps=5120 \
                     --set run.checkpoint_every=4";

fn rates(place: &Place) -> Vec<f64> {
    let journal = fs::read_to_string(place.run("r").join("metrics.jsonl")).unwrap();
    let line = |line: &str| serde_json::from_str::<Value>(line).unwrap();
    journal.lines().map(|text| line(text)["train/learning_rate"].as_f64().unwrap()).collect()
}

#[test]
fn a_run_goes_on_with_another_learning_rate_and_says_so() {
    let place = Place::new();
    let constant = "--set learner.anneal=false --set learner.learning_rate=1e-3";
    place.finish(&[TRAIN, constant, "--stop-after 8"]).with_code(0);
    let refused = place.finish(&[TRAIN, constant, "--set learner.learning_rate=5e-4"]);
    refused.with_code(2).saying(&["learner.learning_rate", "--change KEY=VALUE"]);
    let change = "--change learner.learning_rate=5e-4";
    // Stopped again before it is done: the same command finds its own change in place.
    place.finish(&[TRAIN, constant, change, "--stop-after 2048steps"]).with_code(0);
    place.finish(&[TRAIN, constant, change]).with_code(0);
    let found = rates(&place);
    assert_eq!(found.len(), 40);
    assert!(found[..8].iter().all(|rate| (rate - 1e-3).abs() < 1e-9), "{found:?}");
    assert!(found[8..].iter().all(|rate| (rate - 5e-4).abs() < 1e-9), "{found:?}");
    let record = record(&place.run("r"));
    let changes = record["changes"].as_array().unwrap();
    assert_eq!(changes.len(), 1, "{changes:?}");
    assert_eq!((&changes[0]["after_update"], &changes[0]["after"]), (&8.into(), &"0.0005".into()));
    assert_eq!(result(&place.run("r"))["reproducible"], false);
    let page = fs::read_to_string(place.run("r").join("report.html")).unwrap();
    assert!(page.contains("learner.learning_rate: 0.001 -&gt; 0.0005 after update 8"), "{page}");
    // From then on the new value is the run's own.
    let own = "up -c runs/r/config.toml --name r --actors 1 --steps 5248";
    place.finish(&[own]).with_code(0);
}

#[test]
fn a_setting_that_cannot_change_is_refused_before_anything_is_made() {
    let place = Place::new();
    let to = |change: &str| place.finish(&[TRAIN, "--change", change]).with_code(2);
    to("learner.n_envs=4").saying(&["learner.n_envs", "cannot change", "entropy_coef", "--fork"]);
    to("learner.clip=0.1").saying(&["there is no run `r`"]);
    let nameless = TRAIN.replace("--name r ", "");
    place.finish(&[&nameless, "--change learner.clip=0.1"]).with_code(2).saying(&["--name"]);
    place.finish(&[TRAIN, "--stop-after soon"]).with_code(2).saying(&["1e6steps", "2h"]);
    assert!(!place.run("r").exists());
}

#[test]
fn a_copy_of_a_run_is_a_run_of_its_own() {
    let place = Place::new();
    place.finish(&[TRAIN, "--stop-after 8"]).with_code(0);
    let copied = Command::new("cp").arg("-a").args([place.run("r"), place.run("copy")]).status();
    assert!(copied.unwrap().success());
    let before = fs::read_to_string(place.run("r").join("metrics.jsonl")).unwrap();
    let on = "up -c runs/copy/config.toml --actors 1 --stop-after 12";
    let refused = place.finish(&[on]).with_code(2);
    refused.saying(&["leads to runs/r: ", "by --runs runs --name copy,"]);
    let gone_on = place.finish(&[on, "--runs runs --name copy"]).with_code(0);
    // What the next command is takes up the copy, too.
    gone_on.saying(&["To go on from update 12", "-c runs/copy/config.toml --name copy --actors 1"]);
    assert_eq!(fs::read_to_string(place.run("r").join("metrics.jsonl")).unwrap(), before);
    let listed = place.finish(&["runs --json"]).with_code(0).json();
    let names: BTreeSet<&str> =
        listed.as_array().unwrap().iter().map(|run| run["name"].as_str().unwrap()).collect();
    assert_eq!(names, BTreeSet::from(["copy", "r"]));
    let pruned = place.finish(&["runs prune --older 1d --runs nothing"]).with_code(0);
    pruned.saying(&["there are no runs in nothing"]);
}

#[test]
fn a_run_stops_after_a_time_and_can_be_resumed() {
    let place = Place::new();
    // Without an actor nothing but time can end it.
    let learner = |more: &str| {
        let listen = place.endpoint("learner");
        place.finish(&["learner -c cartpole --name r --listen", &listen, more])
    };
    learner("--stop-after 200ms").with_code(0).saying(&["the time of --stop-after is over"]);
    assert_eq!(record(&place.run("r"))["result"], Value::Null);
    let up = || place.finish(&["up -c cartpole --name r --actors 1 --stop-after 1"]).with_code(0);
    up();
    up().saying(&["--stop-after is reached already"]);
}

#[test]
fn a_command_gets_the_metrics_of_every_update() {
    let place = Place::new();
    place.write("keep.sh", "cat > lines.jsonl");
    place.finish(&[TRAIN, "--metrics-to ./keep.sh"]).with_code(0);
    // Not executable: the shell says so, and the run goes on without it.
    assert_eq!(fs::read_to_string(place.file("lines.jsonl")).ok(), None);
    let first = TRAIN.replace("--name r ", "");
    let mut command = place.program(&[&first, "--name s --metrics-to"]);
    command.arg("sh keep.sh");
    place.start_with(command).finish(crate::support::PATIENCE).with_code(0);
    let lines = fs::read_to_string(place.file("lines.jsonl")).unwrap();
    let journal = fs::read_to_string(place.run("s").join("metrics.jsonl")).unwrap();
    assert_eq!(lines, journal);
}
