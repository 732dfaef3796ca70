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
    for update in 1..=n {
        view.learner_says("01", line(update), 1000.0 + update as f64);
    }
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
fn a_clock_that_is_set_back_leaves_speed_and_state_as_they_are() {
    let mut view = at_update(10);
    for update in 11..=20 {
        view.learner_says("01", line(update), 100.0 + update as f64);
    }
    let state = view.state_json(120.0);
    assert_eq!((&state["seconds_left"], &state["steps_per_second"]), (&json!(80.0), &json!(64.0)));
    // One that hangs is told of as soon as at any other time.
    let mut hanging = at_update(10);
    hanging.forget_gone(100.0);
    assert_eq!(hanging.phase(101.0), RunPhase::Training);
    assert_eq!(hanging.phase(100.0 + STALLED + 1.0), RunPhase::Stalled);
    let mut left = RunView::new("r");
    left.actor_joined("a", "01", 1000.0);
    left.actor_left("a", "01", 1000.0);
    left.forget_gone(100.0);
    assert_eq!(left.actors_json(130.0)[0]["gone_s"], 30.0);
}

#[test]
fn a_run_that_has_ended_has_no_speed_and_no_time_left() {
    let speed = |view: &RunView, now| view.state_json(now)["steps_per_second"].clone();
    for (how, phase) in [("finished", RunPhase::Finished), ("stopped", RunPhase::Stopped)] {
        let mut view = at_update(40);
        view.learner_says("01", json!({"kind": "end", "how": how}), 1040.0);
        assert_eq!((view.phase(1040.0), speed(&view, 1040.0)), (phase, Value::Null));
        assert_eq!(view.state_json(1040.0)["seconds_left"], Value::Null);
        assert_eq!(view.state_json(1040.0)["update"], 40, "what it came to stays");
    }
    let mut killed = at_update(40);
    killed.learner_left("01", 1040.0);
    assert_eq!((killed.phase(1041.0), speed(&killed, 1041.0)), (RunPhase::Lost, Value::Null));
    // After a single update it is the speed that its line says, and that too is over once nobody works in the directory.
    let mut one = at_update(1);
    assert_eq!(speed(&one, 1001.0), 64.0);
    one.on_disk(Some("stopped"), 1001.0);
    assert_eq!(speed(&one, 1001.0), Value::Null);
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
    for odd in [Value::Null, json!(3), json!([1])] {
        let mut line = object(line(5));
        line.insert("refusals".to_owned(), odd);
        view.update(line, 1005.0);
        assert_eq!(view.update_json(1005.0)["refusals"], json!({}), "what a page can read");
    }
}

#[test]
fn a_finished_run_has_the_books_of_its_record() {
    let mut view = at_update(2);
    let books = json!({
        "published": 26, "trained": 16, "dropped_stale": 1, "refused": 2, "superseded": 0, "rolled_back": 4,
        "unused_at_end": 3, "duplicates": 0, "steps_redone": 0, "balanced": true,
    });
    view.settle(Some(books));
    assert_eq!(view.update_json(1002.0)["books"]["published"], 20, "it is still at work");
    view.on_disk(Some("finished"), 1002.0);
    let shown = view.update_json(1002.0)["books"].clone();
    assert_eq!((&shown["published"], &shown["balanced"]), (&json!(26), &json!(true)));
    assert_eq!(shown["entries"][4], json!(["rolled_back", 4]));
    assert_eq!(shown["entries"][5], json!(["unused_at_end", 3]));
    // The record of an old release has none.
    view.settle(Some(Value::Null));
    assert_eq!(view.update_json(1002.0)["books"]["published"], 20);
}

#[test]
fn a_late_subscriber_sees_the_whole_history_and_no_update_twice() {
    let early = at_update(50);
    let mut late = RunView::new("r");
    late.learner_joined("01", 1050.0);
    late.about(about(), 1050.0);
    // Two updates arrive while the history is on its way.
    for update in 49..=50 {
        late.learner_says("01", line(update), 1050.0);
    }
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
fn curves_as_text_are_the_same_with_no_more_digits_than_they_have() {
    let mut view = at_update(0);
    let mut told = line(1);
    told["train/entropy"] = json!(0.123_456_789);
    view.learner_says("01", told, 1001.0);
    let text = view.history_text(0);
    assert!(text.contains(r#""train/entropy":{"min":[0.12346],"max":[0.12346]}"#), "{text}");
    let (text, value): (Value, _) = (serde_json::from_str(&text).unwrap(), view.history_json(0));
    let [text, value] = [text, value].map(|told| told_series(&told).unwrap());
    assert_eq!(text, value);
}

#[test]
fn updates_that_were_rolled_back_are_gone_after_a_resume() {
    let mut view = at_update(30);
    view.learner_left("01", 1031.0);
    assert_eq!(view.phase(1040.0), RunPhase::Lost);
    assert!(view.sentence(1040.0).ends_with("lost for 9 s"), "{}", view.sentence(1040.0));
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
fn a_run_on_the_disk_that_was_rewound_goes_on_from_there() {
    let mut view = RunView::new("r");
    view.about(about(), 1000.0);
    let mut history = at_update(10).history_json(0);
    history["last"] = line(10);
    view.history(&history, 1010.0);
    (11..=30).for_each(|update| view.update(object(line(update)), 1000.0 + update as f64));
    assert_eq!(view.history_json(0)["to"], 30);
    // A learner went on from update 20.
    let mut history = at_update(20).history_json(0);
    history["last"] = line(20);
    history["staleness"] = json!([[20, {"0": 32}]]);
    view.rewound(20, 1031.0);
    view.history(&history, 1031.0);
    assert_eq!((&view.history_json(0)["to"], view.newest()), (&json!(20), 20));
    assert_eq!(view.history_json(0)["marks"], json!([{"update": 20, "what": "resumed"}]));
    assert_eq!((view.generation(), view.staleness.len()), (1, 1));
    let mut again = line(21);
    again["train/entropy"] = json!(7.0);
    view.update(object(again), 1032.0);
    let history = view.history_json(0);
    assert_eq!((&history["to"], view.newest()), (&json!(21), 21));
    assert_eq!(history["scalars"]["train/entropy"]["max"][20], 7.0, "the one that was made again");
}

#[test]
fn a_restart_is_marked_where_the_learner_went_on() {
    let mut view = at_update(30);
    view.learner_joined("02", 1045.0);
    assert_eq!((view.newest(), view.state_json(1045.0)["update"].clone()), (0, json!(0)));
    let mut resumed = about();
    resumed["resumed_from"] = json!(20);
    view.about(resumed.clone(), 1045.5);
    let marks = json!([{"update": 20, "what": "learner restarted"}]);
    assert_eq!(view.history_json(0)["marks"], marks);
    // It is asked once more.
    view.about(resumed.clone(), 1046.0);
    assert_eq!((&view.history_json(0)["marks"], view.generation()), (&marks, 1));
    // A page that is opened after it shows the same.
    let mut late = RunView::new("r");
    late.about(resumed, 1050.0);
    assert_eq!(late.history_json(0)["marks"][0]["update"], 20);
}

#[test]
fn last_words_bring_no_learner_back() {
    let mut view = at_update(3);
    view.learner_left("01", 1004.0);
    view.learner_says("01", line(4), 1004.1);
    assert_eq!((view.phase(1004.1), view.newest()), (RunPhase::Lost, 4));
    view.learner_says("01", json!({"kind": "end", "how": "stopped"}), 1004.2);
    assert_eq!(view.phase(1004.2), RunPhase::Stopped);
    view.learner_joined("02", 1005.0);
    assert!(!view.learner_says("01", line(5), 1005.1), "the older start is old news");
    assert_eq!((view.generation(), view.newest(), view.has_learner()), (1, 0, true));
    view.learner_left("02", 1005.5);
    assert!(view.learner_says("03", line(4), 1006.0), "its presence was not told yet");
}

#[test]
fn an_end_that_is_none_is_taken_back() {
    let mut view = at_update(3);
    view.learner_says("01", json!({"kind": "end", "how": "error"}), 1003.1);
    assert_eq!(view.phase(1003.1), RunPhase::Failed);
    view.learner_says("01", line(4), 1004.0);
    assert_eq!((view.phase(1004.0), view.newest()), (RunPhase::Training, 4));
    let log: Vec<&str> = view.log_after(0).map(|line| line.text.as_str()).collect();
    let told = [
        "the learner ended with an error",
        "the learner is still at work: another process told of its end",
    ];
    assert_eq!(log[1..], told);
    // So it is while actors are missing and no update comes.
    view.learner_says("01", json!({"kind": "end", "how": "finished"}), 1004.1);
    view.learner_says("01", json!({"kind": "roster", "n_needed": 3, "actors": []}), 1005.0);
    assert_eq!(view.phase(1005.0), RunPhase::Gathering);
}

#[test]
fn nobody_takes_the_place_of_a_learner_that_is_there_and_says_something() {
    let mut view = at_update(30);
    assert!(!view.learner_joined("02", 1031.0), "anybody can show presence");
    assert!(!view.learner_says("02", line(999), 1031.0));
    view.learner_left("02", 1031.5);
    view.learner_says("01", line(31), 1032.0);
    assert_eq!((view.newest(), view.generation(), view.learner()), (31, 0, Some("01")));
    // One that begins while the old one's presence still lasts is followed once that is over.
    assert!(!view.learner_joined("03", 1032.5));
    view.learner_left("01", 1034.0);
    assert!(view.learner_says("03", line(32), 1034.2));
    // Presence that came first, and that nothing is behind, gives way to who says something.
    let mut late = RunView::new("r");
    assert!(late.learner_joined("stranger", 1000.0));
    assert!(!late.learner_says("01", line(1), 1000.0 + SILENT - 1.0));
    assert!(late.learner_says("01", line(2), 1000.0 + SILENT));
    assert_eq!((late.newest(), late.learner()), (2, Some("01")));
    // So does presence in whose favour the learner's own was lost.
    late.learner_left("01", 1010.5);
    assert!(late.learner_joined("stranger", 1011.0));
    assert!(!late.learner_says("01", line(3), 1012.0), "these may be its last words");
    assert!(late.learner_says("01", line(4), 1011.0 + SILENT));
}

#[test]
fn no_number_of_a_peer_is_too_large() {
    let mut view = at_update(1);
    let mut told = line(1);
    told["update"] = json!(u64::MAX);
    told["staleness"] = json!({"0": u64::MAX});
    for name in ["books/trained", "books/superseded", "system/queued"] {
        told[name] = json!(f64::MAX);
    }
    view.learner_says("01", told.clone(), 1002.0);
    view.history(&json!({"x": [u64::MAX], "scalars": {}, "last": told}), 1002.0);
    view.history(
        &json!({"x": [1], "scalars": {}, "staleness": [[1, {"0": u64::MAX}], [2, {"0": 9}]]}),
        1003.0,
    );
    let x: Vec<u64> = (1..=3_000).collect();
    view.history(&json!({"x": x, "scalars": {}, "stride": u64::MAX}), 1003.0);
    assert_eq!(view.json(1003.0)["update"]["staleness_100"]["0"], u64::MAX);
}

#[test]
fn messages_of_a_peer_have_limits() {
    let mut view = at_update(1);
    let many = |prefix: &str, n: usize| -> Map<String, Value> {
        (0..n).map(|i| (format!("{prefix}{i}"), json!(1))).collect()
    };
    let mut told = line(2);
    told.as_object_mut().unwrap().extend(many("x/", 1_000));
    told["refusals"] = many("cause", 1_000).into();
    told["staleness"] = many("", 1_000).into();
    view.learner_says("01", told, 1002.0);
    let mut next = line(3);
    next.as_object_mut().unwrap().extend(many("y/", 1_000));
    view.learner_says("01", next, 1003.0);
    let scalars = |view: &RunView| view.history_json(0)["scalars"].as_object().unwrap().clone();
    assert_eq!(scalars(&view).len(), MAX_CURVES);
    assert!(scalars(&view).contains_key("train/entropy"), "the first that came stay");
    let refused = view.log_after(0).filter(|line| line.text.contains("refused")).count();
    assert_eq!((refused, view.staleness[1].1.len()), (MAX_CAUSES, MAX_STALENESS));
    let extremes = json!({"min": [1.0], "max": [1.0]});
    let told: Map<String, Value> =
        many("x/", 1_000).into_iter().map(|it| (it.0, extremes.clone())).collect();
    view.history(&json!({"x": [9], "scalars": told}), 1004.0);
    assert_eq!(scalars(&view).len(), MAX_CURVES);
    for start in 0..1_000 {
        view.learner_joined(&start.to_string(), 1005.0 + SILENT * f64::from(start + 1));
    }
    let marks = view.history_json(0)["marks"].as_array().unwrap().len();
    assert_eq!((marks, view.generation()), (MAX_MARKS, 1_000));
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
fn bytes_that_are_not_a_message_change_nothing() {
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
fn many_events_take_little_room() {
    let mut view = at_update(20_000);
    for n in 0..1_000 {
        view.actor_joined(&format!("a{n}"), "01", 30_000.0);
    }
    let text = view.json(30_000.0).to_string();
    assert!(text.len() < 2 << 20, "{}", text.len());
    assert_eq!(view.log_after(0).count(), N_LOG);
}
