//! Killing and halting processes changes nothing: the same seed gives the same weights, and the books balance.
//!
//! Most tests compare the final weights, the best ones and the evaluations on the way with those of one undisturbed run, made
//! once.

use std::fs;
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::path::Path;
use std::process::Command;
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use crate::support::{
    Finished, PATIENCE, PEER_LOST, Place, Running, SOON, checkpoints, journal, outcome, record,
    result, signal, updates, wait_for_updates, wait_for_words, wait_until,
};
use serde_json::Value;

/// A CartPole run of a few seconds; 40 updates.
const RUN: &str = "learner --name r -c cartpole --seed 3 --set learner.n_steps=64 --set learner.total_steps=10240 \
                   --set learner.anneal=false --set run.checkpoint_every=4 --listen";
/// Makes a run so long that it ends by a signal only.
pub(crate) const LONG: &str = "--set learner.total_steps=1000000000";

fn learner(place: &Place, extra: &str) -> Running {
    place.start(&[RUN, &place.endpoint("learner"), extra])
}

fn actor(place: &Place, id: &str) -> Running {
    let endpoint = place.endpoint("learner");
    place.start(&["actor --connect-timeout 10s --connect", &endpoint, "--id", id])
}

/// Starts a router, at the address of the one before if that was killed.
pub(crate) fn router(place: &Place) -> Running {
    let router = place.start(&["router --listen", &place.endpoint("router")]);
    wait_for_words(&router, "router listens");
    router
}

/// Starts a learner that listens nowhere.
pub(crate) fn learner_below(router: &str, place: &Place, extra: &str) -> Running {
    place.start(&[&RUN.replace("--listen", "--connect"), router, extra])
}

/// Lets a learner and its actors run to their ends.
#[track_caller]
fn finish<const N: usize>(learner: Running, actors: [Running; N]) -> Finished {
    let learner = learner.finish(PATIENCE).with_code(0);
    for actor in actors {
        actor.finish(PATIENCE).with_code(0);
    }
    learner
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

/// The digest of the final weights.
fn weights(place: &Place) -> String {
    balanced(place)["weights_sha256"].as_str().expect("the result has a digest").to_owned()
}

/// What must be equal: the final weights, the best ones, and every evaluation on held-out episodes.
fn digest(place: &Place) -> String {
    let last = weights(place);
    let file = |name: &str| fs::read(place.run("r").join(name)).expect("the run has the file");
    let held_out = String::from_utf8(file("held_out.jsonl")).expect("it is text");
    assert_eq!(held_out.lines().count(), 4, "{held_out}");
    let best = file("best.safetensors");
    // Behind the header, which holds settings that change no weight, such as the number of actors to wait for.
    let header = u64::from_le_bytes(best[..8].try_into().expect("a length")) as usize;
    let mut hasher = DefaultHasher::new();
    best[8 + header..].hash(&mut hasher);
    format!("{last}\nbest {:x}\n{held_out}", hasher.finish())
}

/// The digest of the undisturbed run with one actor.
fn undisturbed() -> &'static str {
    static DIGEST: OnceLock<String> = OnceLock::new();
    DIGEST.get_or_init(|| {
        let place = Place::new();
        finish(learner(&place, ""), [actor(&place, "a")]);
        assert_eq!(updates(&place.run("r")), 40);
        digest(&place)
    })
}

#[test]
fn an_actor_killed_and_replaced_changes_nothing() {
    let place = Place::new();
    // It must not be over before the replacement has taken part.
    let learner = learner(&place, &format!("{LONG} --set run.actors_min=2"));
    let (victim, survivor) = (actor(&place, "a"), actor(&place, "b"));
    let run = place.run("r");
    wait_for_updates(&run, 5);
    victim.kill();
    wait_for_words(&learner, "actor left: a");
    let replacement = actor(&place, "c");
    wait_for_words(&learner, "actor joined: c");
    wait_for_updates(&run, updates(&run) + 3);
    end_as_undisturbed(learner);
    drop((survivor, replacement));
}

#[test]
fn an_actor_looks_for_its_learner_for_as_long_as_it_is_told_and_then_says_that_it_is_lost() {
    let place = Place::new();
    let (learner, endpoint) = (learner(&place, LONG), place.endpoint("learner"));
    let helper = place.start(&["actor --reconnect-timeout 1s --connect", &endpoint]);
    wait_for_updates(&place.run("r"), 1);
    learner.kill();
    let looked = "the learner is gone; looking for it (--reconnect-timeout 1s)";
    let lost = "the learner of run `r` was lost and did not come back within 1s";
    helper.finish(PATIENCE).with_code(PEER_LOST).saying(&[looked, lost]);
}

#[test]
fn a_name_is_taken_while_its_actor_lives_and_free_once_it_is_killed() {
    let place = Place::new();
    let learner = learner(&place, "--set run.actors_min=2");
    let first = actor(&place, "a");
    wait_for_words(&learner, "actor joined");
    let taken = actor(&place, "a").finish(PATIENCE).with_code(2);
    taken.saying(&["`a` is already here; choose another --id"]);
    first.kill();
    finish(learner, [actor(&place, "a"), actor(&place, "b")]);
    assert_eq!(digest(&place), undisturbed());
}

#[test]
fn a_learner_killed_and_restarted_changes_nothing() {
    let place = Place::new();
    let (first, helper) = (learner(&place, ""), actor(&place, "a"));
    // A checkpoint has been passed.
    wait_for_updates(&place.run("r"), 9);
    first.kill();
    finish(learner(&place, ""), [helper]).saying(&["resumed"]);
    assert_eq!(digest(&place), undisturbed());
    assert!(journal(&place.run("r")).into_iter().eq(1..=40), "every update is there once");
}

#[test]
fn a_router_killed_and_restarted_finds_learner_and_actors_again_and_changes_nothing() {
    let place = Place::new();
    let endpoint = place.endpoint("router");
    let first = router(&place);
    let learner = learner_below(&endpoint, &place, "");
    let helper = place.start(&["actor --id a --connect", &endpoint]);
    wait_for_updates(&place.run("r"), 5);
    first.kill();
    wait_for_words(&learner, "actor left");
    let second = router(&place);
    finish(learner, [helper]);
    assert_eq!(digest(&place), undisturbed());
    assert!(journal(&place.run("r")).into_iter().eq(1..=40), "every update is there once");
    signal("TERM", second.id());
    second.finish(PATIENCE).with_code(0);
}

/// Ends a run that does not end by itself, and asserts that it has the weights of an undisturbed one of as many updates.
#[track_caller]
pub(crate) fn end_as_undisturbed(learner: Running) {
    signal("TERM", learner.id());
    let disturbed = learner.finish(PATIENCE).with_code(130);
    assert!(disturbed.stdout.contains("all accounted for"), "{}", disturbed.stdout);
    let (_, n_updates) = outcome(&disturbed);
    let place = Place::new();
    let calm = self::learner(&place, &format!("{LONG} --stop-after {n_updates}"));
    let helper = actor(&place, "a");
    // The other one was under way for as long as its test waited.
    let calm = calm.finish(3 * PATIENCE).with_code(0);
    helper.finish(PATIENCE);
    assert_eq!(outcome(&calm), outcome(&disturbed));
}

#[test]
fn a_learner_that_listens_and_dials_finds_its_router_again_and_has_actors_on_both_sides() {
    let place = Place::new();
    let above = place.endpoint("router");
    let first = router(&place);
    let both = format!("{LONG} --set run.actors_min=2 --connect {above}");
    let learner = learner(&place, &both);
    let near = actor(&place, "near");
    let far = place.start(&["actor --connect-timeout 10s --id far --connect", &above]);
    let run = place.run("r");
    wait_for_updates(&run, 5);
    first.kill();
    wait_for_words(&learner, "actor left: far");
    let _second = router(&place);
    wait_until("the actor behind the router is back", PATIENCE, || {
        learner.n_said("actor joined: far") >= 2
    });
    // From here on rollouts, credit and weights have only the way through the router that is new.
    near.kill();
    wait_for_words(&learner, "actor left: near");
    wait_for_updates(&run, updates(&run) + 5);
    end_as_undisturbed(learner);
    drop(far);
}

#[test]
fn an_actor_and_a_learner_that_stand_still_for_longer_than_a_connection_may_change_nothing() {
    let place = Place::new();
    let learner = learner(&place, &format!("{LONG} --set run.actors_min=2"));
    let (first, second) = (actor(&place, "a"), actor(&place, "b"));
    let run = place.run("r");
    wait_for_updates(&run, 5);
    signal("STOP", second.id());
    wait_for_words(&learner, "actor left: b");
    wait_for_updates(&run, updates(&run) + 3);
    signal("CONT", second.id());
    wait_until("it is back", PATIENCE, || learner.n_said("actor joined: b") >= 2);
    wait_for_updates(&run, updates(&run) + 3);

    // An actor whose rollouts wait may ask its learner before it counts as gone: a second later than that.
    let n_missed = || {
        let words = ["the learner is gone", "the learner does not acknowledge"];
        words.into_iter().map(|words| first.n_said(words)).sum::<usize>()
    };
    let n_before = n_missed();
    signal("STOP", learner.id());
    wait_until("the learner is missed", PATIENCE, || n_missed() > n_before);
    let n_updates = updates(&run);
    signal("CONT", learner.id());
    wait_for_updates(&run, n_updates + 5);
    // One of them may still be looking for its learner, and would go on doing so.
    end_as_undisturbed(learner);
    drop((first, second));
}

#[test]
fn two_learners_of_one_run_name_are_told_of_each_other_and_count_what_is_their_own() {
    let (place, other) = (Place::new(), Place::new());
    let endpoint = place.endpoint("router");
    let router = router(&place);
    let first = learner_below(&endpoint, &place, LONG);
    let helper = place.start(&["actor --id a --connect", &endpoint]);
    wait_for_updates(&place.run("r"), 3);
    let second = learner_below(&endpoint, &other, LONG);
    for learner in [&first, &second] {
        wait_for_words(learner, "another learner of this run name is on the same network");
    }
    signal("TERM", second.id());
    let told = second.finish(PATIENCE).with_code(130).stdout;
    assert!(told.contains("0 rollouts, all accounted for"), "{told}");
    let n_updates = updates(&place.run("r"));
    wait_for_updates(&place.run("r"), n_updates + 3);
    signal("TERM", first.id());
    first.finish(PATIENCE).with_code(130);
    helper.finish(PATIENCE);
    drop(router);
}

#[test]
fn a_learner_killed_before_its_first_checkpoint_begins_anew_with_every_update_once() {
    let place = Place::new();
    let late = "--set run.checkpoint_every=1000";
    let (first, helper) = (learner(&place, late), actor(&place, "a"));
    wait_for_updates(&place.run("r"), 5);
    first.kill();
    finish(learner(&place, late), [helper]);
    assert!(journal(&place.run("r")).into_iter().eq(1..=40), "every update is there once");
    assert_eq!(digest(&place), undisturbed());
}

#[test]
fn a_run_whose_directory_is_moved_away_is_taken_up_from_the_new_one_and_has_one_learner() {
    let place = Place::new();
    let (first, helper) = (learner(&place, LONG), actor(&place, "a"));
    let run = place.run("r");
    wait_for_updates(&run, 6);
    fs::rename(&run, place.run("away")).unwrap();
    wait_for_words(&first, "was moved or removed");
    wait_for_updates(&run, 9);
    let second = learner(&place, LONG).finish(PATIENCE);
    second.with_code(2).saying(&["in use by another learner"]);
    signal("TERM", first.id());
    first.finish(PATIENCE).with_code(130);
    helper.finish(PATIENCE);
    let more = format!("{LONG} --stop-after {}", updates(&run) + 4);
    let (again, helper) = (learner(&place, &more), actor(&place, "b"));
    again.finish(PATIENCE).with_code(0).saying(&["resumed from update"]);
    helper.finish(PATIENCE);
    assert!(place.run("away").join("config.toml").is_file(), "what was moved stays as it was");
}

#[test]
fn a_run_that_another_build_resumes_is_not_called_reproducible() {
    let place = Place::new();
    let (first, helper) = (learner(&place, "--stop-after 8"), actor(&place, "a"));
    first.finish(PATIENCE).with_code(0);
    helper.finish(PATIENCE);
    let other = place.copy_of_program("other");
    let append = ["-c", "printf x >> other"];
    let appended = Command::new("sh").args(append).current_dir(place.path()).status();
    assert!(appended.unwrap().success());
    let endpoint = place.endpoint("learner");
    let second = place.program_at(&other, &[RUN, &endpoint, "--stop-after 16"]);
    let second = place.start_with(second);
    let helper = place.start_with(place.program_at(&other, &["actor --connect", &endpoint]));
    let told = "another build of the program, or class of CPU, than before";
    second.finish(PATIENCE).with_code(0).saying(&["resumed", told]);
    helper.finish(PATIENCE);
    let record = record(&place.run("r"));
    assert_eq!(record["builds"].as_array().map(Vec::len), Some(2), "{record}");
    // Nor is it ever again.
    finish(learner(&place, ""), [actor(&place, "b")]);
    assert_eq!(result(&place.run("r"))["reproducible"], false);
}

#[test]
fn a_closed_terminal_leaves_a_checkpoint_and_does_not_end_what_was_to_outlive_it() {
    let place = Place::new();
    // Tests that are themselves run by `nohup` hand on that the signal is ignored.
    let start = |handling: &str| {
        let mut shell = place.program_at(Path::new("sh"), &["-c"]);
        shell.args([handling, env!("CARGO_BIN_EXE_leadtime")]);
        shell.args(RUN.split(' ')).arg(place.endpoint("learner")).args(LONG.split(' '));
        place.start_with(shell)
    };
    let first = start("exec env --default-signal=HUP \"$0\" \"$@\"");
    let helper = actor(&place, "a");
    wait_for_updates(&place.run("r"), 2);
    signal("HUP", first.id());
    first.finish(PATIENCE).with_code(130);
    helper.finish(PATIENCE);
    let n_updates = updates(&place.run("r"));
    let second = start("trap '' HUP; exec \"$0\" \"$@\"");
    wait_for_words(&second, "listening");
    signal("HUP", second.id());
    let helper = actor(&place, "b");
    wait_for_updates(&place.run("r"), n_updates + 3);
    signal("INT", second.id());
    second
        .finish(PATIENCE)
        .with_code(130)
        .saying(&["resumed", &format!("from update {n_updates}:")]);
    helper.finish(PATIENCE);
    let journal = journal(&place.run("r"));
    assert!(journal.iter().copied().eq(1..=journal.len() as u64), "every update is there once");
}

#[test]
fn training_twice_as_long_through_a_resume_equals_training_straight() {
    let place = Place::new();
    let half = "--set learner.total_steps=5120";
    finish(learner(&place, half), [actor(&place, "a")]);
    learner(&place, half).finish(PATIENCE).with_code(0).saying(&["finished"]);
    finish(learner(&place, ""), [actor(&place, "b")]).saying(&["resumed"]);
    // The half was evaluated at other updates.
    assert_eq!(Some(weights(&place).as_str()), undisturbed().lines().next());
}

/// Starts a run whose updates take longer than its end waits for one, and waits for the first. No checkpoint is due before the end.
fn in_a_long_update(place: &Place) -> (Running, Running) {
    // With a lag the rollouts of the next update are there already, so it begins at once.
    let passes = "--set learner.mode=lag --set learner.n_steps=1024 --set learner.n_epochs=1000 \
        --set learner.learning_rate=1e-6";
    let rare = "--set run.checkpoint_every=1000 --set run.checkpoint_seconds=3600";
    let learner = learner(place, &format!("{LONG} {passes} {rare}"));
    let helper = actor(place, "a");
    wait_for_updates(&place.run("r"), 1);
    (learner, helper)
}

#[test]
fn a_learner_stopped_during_a_long_update_saves_the_state_before_it() {
    let place = Place::new();
    let (first, helper) = in_a_long_update(&place);
    let asked = Instant::now();
    signal("TERM", first.id());
    first.finish(PATIENCE).with_code(130);
    assert!(asked.elapsed() > Duration::from_secs(2), "no update was under way");
    helper.finish(PATIENCE);
    assert_newest_checkpoint_is_of_the_end(&place);
}

#[test]
fn a_learner_that_is_asked_twice_ends_at_once_and_saves_nothing() {
    let place = Place::new();
    let (learner, helper) = in_a_long_update(&place);
    signal("STOP", learner.id());
    let status = format!("/proc/{}/status", learner.id());
    let stands_still = || fs::read_to_string(&status).is_ok_and(|it| it.contains("State:\tT"));
    wait_until("it stands still", PATIENCE, stands_still);
    // Both wait for it to go on, so the second comes right after the first, however busy the machine is.
    for name in ["TERM", "INT", "CONT"] {
        signal(name, learner.id());
    }
    learner.finish(PATIENCE).with_code(130);
    // Asked once, it waits for the update for two seconds, and saves the state before it.
    assert!(checkpoints(&place.run("r")).is_empty(), "it has taken its time");
    drop(helper);
}

/// Fails unless the last update that was made was saved.
#[track_caller]
fn assert_newest_checkpoint_is_of_the_end(place: &Place) {
    let newest = checkpoints(&place.run("r")).pop().expect("the end writes a checkpoint");
    let expected = format!("{:012}.checkpoint", updates(&place.run("r")));
    assert!(newest.ends_with(&expected), "{}, not {expected}", newest.display());
}

#[test]
fn an_interrupted_learner_leaves_a_checkpoint_in_time_and_its_actor_comes_back_to_the_next() {
    let place = Place::new();
    // It cannot end before the signal comes, and no checkpoint is due before.
    let rare = "--set run.checkpoint_every=1000";
    let first = learner(&place, &format!("{LONG} {rare}"));
    let helper = actor(&place, "a");
    let run = place.run("r");
    wait_for_updates(&run, 6);
    signal("TERM", first.id());
    first.finish(SOON).with_code(130);
    // Dismissed, it ends well: a service manager that starts only what failed again would leave it at that.
    helper.finish(PATIENCE).with_code(0);
    assert!(result(&run).is_null(), "an interrupted run is unfinished");
    assert_newest_checkpoint_is_of_the_end(&place);
    // Its service manager starts it again at once, before there is a learner.
    let helper = actor(&place, "a");
    wait_for_words(&helper, "looking for a learner");
    let longer = format!("{LONG} {rare} --stop-after {}", updates(&run) + 40);
    let resumed = finish(learner(&place, &longer), [helper]);
    let resumed = resumed.saying(&["resumed from update", "actor joined: a"]);
    let elsewhere = Place::new();
    let straight = finish(learner(&elsewhere, &longer), [actor(&elsewhere, "b")]);
    assert_eq!(outcome(&resumed), outcome(&straight));
}
