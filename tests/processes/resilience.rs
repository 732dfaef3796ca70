//! Killing processes changes nothing: the same seed gives the same weights, and the books balance.
//!
//! Most tests compare the digest of the final weights with that of one undisturbed run, made once.

use std::io::Write as _;
use std::sync::OnceLock;
use std::time::Duration;

use crate::support::{
    PATIENCE, Place, Running, journal, record, result, signal, updates, wait_until,
};
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
/// Makes a run so long that it ends by a signal only.
const LONG: &[&str] = &["--set", "learner.total_steps=1000000000"];

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
    assert!(journal(&place.run("r")).into_iter().eq(1..=40), "every update is there once");
}

#[test]
fn a_learner_killed_before_its_first_checkpoint_begins_anew_with_every_update_once() {
    let place = Place::new();
    let late = ["--set", "run.checkpoint_every=1000"];
    let (first, helper) = (learner(&place, &late), actor(&place, "a"));
    wait_until("the run is under way", PATIENCE, || updates(&place.run("r")) >= 5);
    first.kill();
    learner(&place, &late).finish(PATIENCE).with_code(0);
    helper.finish(PATIENCE).with_code(0);
    assert!(journal(&place.run("r")).into_iter().eq(1..=40), "every update is there once");
    assert_eq!(digest(&place), undisturbed());
}

#[test]
fn a_run_that_another_build_resumes_is_not_called_reproducible() {
    let place = Place::new();
    let (first, helper) = (learner(&place, &["--stop-after", "8"]), actor(&place, "a"));
    first.finish(PATIENCE).with_code(0);
    helper.finish(PATIENCE);
    let other = place.copy_of_program("other");
    let append = std::fs::File::options().append(true).open(&other);
    append.unwrap().write_all(b"x").unwrap();
    let endpoint = place.endpoint("learner");
    let args = [&["learner", "--name", "r", "--listen", &endpoint], RUN].concat();
    let second = place.start_with(place.program_at(&other, &args));
    let helper = place.start_with(place.program_at(&other, &["actor", "--connect", &endpoint]));
    second.finish(PATIENCE).with_code(0).saying(&["resumed"]);
    helper.finish(PATIENCE).with_code(0);
    let record = record(&place.run("r"));
    assert_eq!(record["result"]["reproducible"], false);
    assert_eq!(record["builds"].as_array().map(Vec::len), Some(2), "{record}");
}

#[test]
fn a_closed_terminal_leaves_a_checkpoint_and_does_not_end_what_was_to_outlive_it() {
    let place = Place::new();
    let endpoint = place.endpoint("learner");
    let args = [&["learner", "--name", "r", "--listen", &endpoint], RUN, LONG].concat();
    // Tests that are themselves run by `nohup` hand on that the signal is ignored.
    let mut as_in_a_terminal = std::process::Command::new("env");
    as_in_a_terminal.current_dir(place.path()).arg("--default-signal=HUP");
    as_in_a_terminal.arg(env!("CARGO_BIN_EXE_leadtime")).args(args);
    let first = place.start_with(as_in_a_terminal);
    let helper = actor(&place, "a");
    wait_until("the run is under way", PATIENCE, || updates(&place.run("r")) >= 2);
    signal("HUP", first.id());
    first.finish(PATIENCE).with_code(130);
    helper.finish(PATIENCE);
    let n_updates = updates(&place.run("r"));
    let mut shell = std::process::Command::new("sh");
    shell.current_dir(place.path()).args(["-c", "trap '' HUP; exec \"$0\" \"$@\""]);
    shell.args([env!("CARGO_BIN_EXE_leadtime"), "learner", "--name", "r", "--listen", &endpoint]);
    let second = place.start_with({
        shell.args(RUN).args(LONG);
        shell
    });
    wait_until("it listens", PATIENCE, || second.stderr().contains("listening"));
    signal("HUP", second.id());
    let helper = actor(&place, "b");
    wait_until("it goes on", PATIENCE, || updates(&place.run("r")) > n_updates + 2);
    signal("INT", second.id());
    second.finish(PATIENCE).with_code(130).saying(&["resumed", &format!("n_updates={n_updates}")]);
    helper.finish(PATIENCE);
    let journal = journal(&place.run("r"));
    assert!(journal.iter().copied().eq(1..=journal.len() as u64), "every update is there once");
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
    // Four times as long as the others, so that it is under way when the signal comes.
    let total = ["--set", "learner.total_steps=40960"];
    let first = learner(&place, &total);
    let helper = actor(&place, "a");
    wait_until("the run is under way", PATIENCE, || updates(&place.run("r")) >= 6);
    signal("TERM", first.id());
    first.finish(5 * SECOND).with_code(130);
    helper.finish(PATIENCE);
    assert!(result(&place.run("r")).is_null(), "an interrupted run is unfinished");
    let straight = Place::new();
    for place in [&place, &straight] {
        let (second, helper) = (learner(place, &total), actor(place, "b"));
        second.finish(PATIENCE).with_code(0);
        helper.finish(PATIENCE).with_code(0);
    }
    assert_eq!(digest(&place), digest(&straight));
}
