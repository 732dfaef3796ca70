//! What a page knows after what happened.

use super::*;

fn line(update: u64) -> Value {
    json!({
        "kind": "update", "update": update, "steps": update * 64, "made": 1000.0 + update as f64,
        "time": "2026-01-31T12:00:00Z", "staleness": {"0": 3, "1": 29}, "refusals": {},
        "episodes/success": update as f64 / 100.0, "episodes/return": 1.0, "train/entropy": 2.0 - update as f64 / 100.0,
        "system/steps_per_second": 64.0, "system/wait_seconds": 0.62, "system/train_seconds": 0.3,
        "system/queued": 4, "books/published": update * 8 + 4, "books/trained": update * 8,
        "books/dropped_stale": 0, "books/refused": 0, "books/superseded": 0, "books/rolled_back": 0,
    })
}

#[expect(clippy::needless_pass_by_value, reason = "it reads as what it is: an object")]
fn object(line: Value) -> Map<String, Value> {
    line.as_object().unwrap().clone()
}

fn about() -> Value {
    json!({"run": "r", "domain": "lander", "config": "seed = 1", "total_updates": 100, "steps_per_update": 64})
}

/// A run at this update, one a second.
fn at_update(n: u64) -> RunView {
    let mut view = RunView::new("r");
    view.learner_joined("01", 1000.0);
    view.about(about(), 1000.0);
    (1..=n).for_each(|update| view.learner_says("01", line(update), 1000.0 + update as f64));
    view
}

#[test]
fn the_head_line_says_how_far_a_run_is_and_how_long_it_takes() {
    let view = at_update(40);
    let state = view.state_json(1040.0);
    assert_eq!((&state["state"], &state["update"]), (&json!("training"), &json!(40)));
    assert_eq!(state["seconds_left"], 60.0, "an update a second");
    assert_eq!(state["steps_per_second"], 64.0);
    assert_eq!(state["success"], 0.4);
    assert_eq!(view.about_json()["domain"], "lander");
}

#[test]
fn phases_books_and_staleness_come_with_an_update() {
    let update = at_update(40).update_json(1040.25);
    assert_eq!(update["phases"]["wait"], 0.62);
    assert_eq!(
        update["phases"]["sentence"],
        "the learner waits 62 % of the time: more actors would help"
    );
    assert_eq!(update["books"]["balanced"], true);
    assert_eq!(update["books"]["entries"][5], json!(["on_their_way", 4]));
    assert_eq!(
        (&update["staleness"]["1"], &update["staleness_100"]["1"]),
        (&json!(29), &json!(29 * 40))
    );
    assert_eq!(update["age_ms"], 250.0);
    let mut view = at_update(3);
    let mut broken = object(line(4));
    broken.insert("books/trained".to_owned(), json!(1));
    view.update(broken, 1004.0);
    assert_eq!(view.update_json(1004.0)["books"]["balanced"], false);
}

#[test]
fn who_comes_late_sees_the_whole_history_and_no_update_twice() {
    let early = at_update(50);
    let mut late = RunView::new("r");
    late.learner_joined("01", 1050.0);
    late.about(about(), 1050.0);
    // Two updates arrive while the history is on its way.
    (49..=50).for_each(|update| late.learner_says("01", line(update), 1050.0));
    let mut history = at_update(48).history_json(0);
    history["last"] = line(48);
    late.history(&history, 1050.5);
    assert_eq!(late.history_json(0)["x"], early.history_json(0)["x"]);
    assert_eq!(late.newest(), 50);
    assert_eq!(late.history_json(45)["x"].as_array().unwrap().len(), 6);
    // One that was on its way for longer is old news.
    late.learner_says("01", line(30), 1051.0);
    assert_eq!((late.newest(), late.history_json(0)["x"].as_array().unwrap().len()), (50, 50));
}

#[test]
fn after_a_resume_what_was_rolled_back_is_gone() {
    let mut view = at_update(30);
    view.learner_left("01", 1031.0);
    assert_eq!(view.phase(1040.0), RunPhase::Lost);
    assert!(view.sentence(1040.0).ends_with("lost since 9 s"), "{}", view.sentence(1040.0));
    assert!(view.learner_joined("02", 1045.0) && view.generation() == 1);
    let mut history = at_update(20).history_json(0);
    history["last"] = line(20);
    view.history(&history, 1045.5);
    assert_eq!(view.history_json(0)["to"], 20, "updates 21 to 30 are made again");
    view.learner_says("02", line(21), 1046.0);
    assert_eq!((view.newest(), view.phase(1046.0)), (21, RunPhase::Training));
    view.learner_left("01", 1047.0);
    assert!(view.has_learner(), "the end of the older start is old news");
}

#[test]
fn a_run_has_one_of_these_phases() {
    let mut view = RunView::new("r");
    assert_eq!(view.phase(0.0), RunPhase::Unknown);
    view.learner_says("01", json!({"kind": "roster", "n_needed": 3, "actors": []}), 0.0);
    assert_eq!(
        (view.phase(0.0), view.sentence(0.0)),
        (RunPhase::Gathering, "waiting for actors: 0 of 3".to_owned())
    );
    view.learner_says("01", json!({"kind": "roster", "actors": [], "checkpoint": 5}), 0.0);
    assert_eq!(view.sentence(0.0), "waiting for the first update");
    view.learner_says("01", line(1), 1.0);
    assert_eq!(view.phase(31.0), RunPhase::Training);
    assert_eq!(view.phase(32.0), RunPhase::Stalled);
    view.learner_says("01", json!({"kind": "end", "how": "stopped"}), 40.0);
    assert_eq!(view.phase(99.0), RunPhase::Stopped);
    let mut finished = at_update(100);
    finished.learner_left("01", 1101.0);
    assert_eq!(finished.phase(1200.0), RunPhase::Finished, "its last word was lost");
    let log: Vec<&str> = view.log_after(0).map(|line| line.text.as_str()).collect();
    assert_eq!(
        log,
        ["the learner is there", "checkpoint of update 5 written", "the learner was asked to stop"]
    );
}

#[test]
fn what_is_no_message_changes_nothing() {
    let mut view = at_update(3);
    let before = view.json(1003.0);
    for told in [
        json!(null),
        json!([]),
        json!({}),
        json!({"kind": "update"}),
        json!({"kind": 7}),
        json!({"kind": "update", "update": "x"}),
    ] {
        view.learner_says("01", told, 1003.0);
    }
    view.history(&json!({"x": "no"}), 1003.0);
    assert_eq!(view.json(1003.0), before);
}

#[test]
fn refusals_are_logged_once_by_cause() {
    let mut view = at_update(1);
    for (update, n) in [(2, 1), (3, 5)] {
        let mut told = line(update);
        told["refusals"] = json!({"non_finite": n});
        view.learner_says("01", told, 1002.0);
    }
    let warned = view.log_after(0).filter(|line| line.level == "warn");
    assert_eq!(
        warned.map(|line| line.text.as_str()).collect::<Vec<_>>(),
        ["messages are refused: non finite"]
    );
}

#[test]
fn many_events_take_little_room_and_time() {
    let started = std::time::Instant::now();
    let mut view = at_update(20_000);
    for n in 0..1_000 {
        view.actor_joined(&format!("a{n}"), "01", 30_000.0);
    }
    assert!(started.elapsed().as_secs() < 20, "{:?}", started.elapsed());
    let text = view.json(30_000.0).to_string();
    assert!(text.len() < 2 << 20, "{}", text.len());
    assert_eq!(view.log_after(0).count(), N_LOG);
}
