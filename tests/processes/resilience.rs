//! Killing processes changes nothing: the same seed gives the same weights, and the books balance.
//!
//! Every test compares the digest of the final weights with that of one undisturbed run, made once.

use std::sync::OnceLock;
use std::time::Duration;

use crate::support::{PATIENCE, Place, Running, result, updates, wait_until};
use serde_json::Value;

const SECOND: Duration = Duration::from_secs(1);

/// A CartPole run of a few seconds; 40 updates.
const RUN: &[&str] = &[
    "-c",
    "cartpole",
    "--seed",
    "3",
    "--set",
    "learner.n_steps=64",
    "--set",
    "learner.total_steps=10240",
    "--set",
    "learner.anneal=false",
    "--set",
    "run.checkpoint_every=4",
];

fn learner(place: &Place, extra: &[&str]) -> Running {
    let endpoint = place.endpoint("learner");
    place.start(&[&["learner", "--name", "r", "--listen", &endpoint], RUN, extra].concat())
}

fn actor(place: &Place, id: &str) -> Running {
    let endpoint = place.endpoint("learner");
    place.start(&["actor", "--connect", &endpoint, "--id", id, "--connect-timeout", "10s"])
}

/// Returns the result of a finished run after asserting that its books balance.
#[track_caller]
fn balanced(place: &Place) -> Value {
    let result = result(&place.run("r"));
    let books = &result["books"];
    let count = |name: &str| books[name].as_u64().unwrap_or_else(|| panic!("{name}: {books}"));
    let fates = ["trained", "dropped_stale", "refused", "superseded", "unused_at_end"];
    let accounted: u64 = fates.into_iter().map(count).sum();
    assert_eq!(count("published") - count("rolled_back"), accounted, "{books}");
    assert_eq!(result["reproducible"], true);
    result
}

fn digest(place: &Place) -> String {
    balanced(place)["weights_sha256"].as_str().expect("the result has a digest").to_owned()
}

/// The digest of the undisturbed run with one actor.
fn undisturbed() -> &'static str {
    static DIGEST: OnceLock<String> = OnceLock::new();
    DIGEST.get_or_init(|| {
        let place = Place::new();
        let (learner, actor) = (learner(&place, &[]), actor(&place, "a"));
        learner.finish(PATIENCE).with_code(0);
        actor.finish(PATIENCE).with_code(0);
        assert_eq!(updates(&place.run("r")), 40);
        digest(&place)
    })
}

#[test]
fn three_actors_give_the_same_weights_as_one() {
    let place = Place::new();
    let learner = learner(&place, &["--set", "run.actors_min=3"]);
    let actors = ["a", "b", "c"].map(|id| actor(&place, id));
    learner.finish(PATIENCE).with_code(0);
    for actor in actors {
        actor.finish(PATIENCE).with_code(0);
    }
    assert_eq!(digest(&place), undisturbed());
}

#[test]
fn an_actor_killed_and_replaced_changes_nothing() {
    let place = Place::new();
    let learner = learner(&place, &["--set", "run.actors_min=2"]);
    let (victim, survivor) = (actor(&place, "a"), actor(&place, "b"));
    wait_until("the run is under way", PATIENCE, || updates(&place.run("r")) >= 5);
    victim.kill();
    let replacement = actor(&place, "c");
    learner.finish(PATIENCE).with_code(0);
    survivor.finish(PATIENCE).with_code(0);
    replacement.finish(PATIENCE);
    assert_eq!(digest(&place), undisturbed());
}

#[test]
fn a_name_is_taken_while_its_actor_lives_and_free_once_it_is_killed() {
    let place = Place::new();
    let learner = learner(&place, &["--set", "run.actors_min=2"]);
    let first = actor(&place, "a");
    wait_until("the first is in", PATIENCE, || learner.stderr().contains("actor joined"));
    let taken = actor(&place, "a").finish(PATIENCE).with_code(2);
    taken.saying(&["`a` is already here; choose another --id"]);
    first.kill();
    let (again, other) = (actor(&place, "a"), actor(&place, "b"));
    learner.finish(PATIENCE).with_code(0);
    again.finish(PATIENCE).with_code(0);
    other.finish(PATIENCE).with_code(0);
    assert_eq!(digest(&place), undisturbed());
}

#[test]
fn a_learner_killed_and_restarted_changes_nothing() {
    let place = Place::new();
    let first = learner(&place, &[]);
    let actor = actor(&place, "a");
    wait_until("a checkpoint has been passed", PATIENCE, || updates(&place.run("r")) >= 9);
    first.kill();
    let second = learner(&place, &[]);
    second.finish(PATIENCE).with_code(0).saying(&["resumed"]);
    actor.finish(PATIENCE).with_code(0);
    assert_eq!(digest(&place), undisturbed());
    let journal = std::fs::read_to_string(place.run("r").join("metrics.jsonl")).unwrap();
    let numbers: Vec<u64> = journal
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).unwrap()["update"].as_u64().unwrap())
        .collect();
    assert_eq!(numbers, (1..=40).collect::<Vec<u64>>(), "every update is there once");
}

#[test]
fn training_twice_as_long_through_a_resume_equals_training_straight() {
    let place = Place::new();
    let half = ["--set", "learner.total_steps=5120"];
    let (first, helper) = (learner(&place, &half), actor(&place, "a"));
    first.finish(PATIENCE).with_code(0);
    helper.finish(PATIENCE).with_code(0);
    learner(&place, &half).finish(10 * SECOND).with_code(0).saying(&["finished"]);
    let (second, helper) = (learner(&place, &[]), actor(&place, "b"));
    second.finish(PATIENCE).with_code(0).saying(&["resumed"]);
    helper.finish(PATIENCE).with_code(0);
    assert_eq!(digest(&place), undisturbed());
}

#[test]
fn an_interrupted_learner_leaves_a_checkpoint_within_five_seconds() {
    let place = Place::new();
    let first = learner(&place, &[]);
    let helper = actor(&place, "a");
    wait_until("the run is under way", PATIENCE, || updates(&place.run("r")) >= 6);
    crate::support::signal("TERM", first.id());
    first.finish(5 * SECOND).with_code(130);
    helper.finish(PATIENCE);
    assert!(result(&place.run("r")).is_null(), "an interrupted run is unfinished");
    let (second, helper) = (learner(&place, &[]), actor(&place, "b"));
    second.finish(PATIENCE).with_code(0).saying(&["resumed"]);
    helper.finish(PATIENCE).with_code(0);
    assert_eq!(digest(&place), undisturbed());
}
