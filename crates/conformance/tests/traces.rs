//! Our worlds against recordings of their originals: same start, same actions, same trajectory.

use std::io::Read as _;

use flate2::read::GzDecoder;
use leadtime_conformance::highway::{self, HighwayReport};
use leadtime_conformance::steakhouse::{self, RecordingReport, SteakhouseReport};
use leadtime_conformance::{ReplayError, lander};
use leadtime_lander::world::Physics;

fn unpack(packed: &[u8]) -> String {
    let mut text = String::new();
    GzDecoder::new(packed).read_to_string(&mut text).expect("the recordings are gzip");
    text
}

/// Replaces the first occurrence, which must be there.
fn changed(text: &str, from: &str, to: &str) -> String {
    assert!(text.contains(from), "{from} is in the recording");
    text.replacen(from, to, 1)
}

fn highway_traces() -> String {
    unpack(include_bytes!("../../../tests/data/highway_traces.json.gz"))
}

fn lander_traces() -> String {
    unpack(include_bytes!("../../../tests/data/lander_traces.json.gz"))
}

fn public() -> String {
    unpack(include_bytes!("../../../tests/data/steak_traces.json.gz"))
}

fn golden() -> String {
    unpack(include_bytes!("../../../tests/data/steak_golden.json.gz"))
}

fn failed(report: &HighwayReport) -> Vec<&'static str> {
    let failed = report.scenarios.iter().filter(|scenario| !scenario.passed);
    failed.map(|scenario| scenario.name).collect()
}

#[test]
fn the_traffic_moves_like_the_original() {
    let report = highway::replay(&highway_traces()).unwrap();
    assert!(report.passed, "{report:#?}");
    assert_eq!(report.scenarios.len(), 12);
    let n_states: usize = report.scenarios.iter().map(|scenario| scenario.n_states).sum();
    let n_decisions: usize = report.scenarios.iter().map(|scenario| scenario.n_decisions).sum();
    assert!(n_states > 15_000 && n_decisions > 150, "{n_states} states, {n_decisions} decisions");
}

#[test]
fn another_start_action_or_gap_of_the_traffic_does_not_pass() {
    let text = highway_traces();
    for (from, to, scenario) in [
        (
            r#""speed":15.0,"lane":1,"target_lane":1"#,
            r#""speed":15.5,"lane":1,"target_lane":1"#,
            "c_mobil",
        ),
        (r#""45":"LANE_RIGHT""#, r#""45":"LANE_LEFT""#, "d2_meta_actions"),
        (r#""intersecting":true"#, r#""intersecting":false"#, "unit_collisions"),
        (r#""terminated":true"#, r#""terminated":false"#, "e_merge"),
        (r#""acceleration":1.553240741"#, r#""acceleration":1.553240841"#, "unit_idm"),
    ] {
        assert_eq!(failed(&highway::replay(&changed(&text, from, to)).unwrap()), [scenario]);
    }
}

#[test]
fn a_file_that_is_not_a_trace_of_traffic_is_refused() {
    assert!(matches!(highway::replay("{}"), Err(ReplayError::Format { .. })));
    let empty = r#"{"meta": {"highway_env": "0", "dt": 0.1}}"#;
    assert!(matches!(highway::replay(empty), Err(ReplayError::Empty { .. })));
    let impossible = changed(&highway_traces(), r#""45":"LANE_RIGHT""#, r#""45":"U_TURN""#);
    let error = highway::replay(&impossible).unwrap_err();
    assert_eq!(error.to_string(), "scenario `d2_meta_actions` has the unknown action `U_TURN`");
    let lane = r#"{"from": "a", "to": "b", "start": [0, 0], "end": [500, 0], "width": 4.0, "speed_limit": 30.0,
                   "forbidden": false}"#;
    for commanded in [r#""actions": {"0": "IDLE"}"#, r#""speed_index": [[0, 1, 25.0]]"#] {
        let scene =
            format!(r#"{{"lanes": [{lane}], "vehicles": [], "states": [[], []], {commanded}}}"#);
        let text = format!(r#"{{"meta": {{"highway_env": "0", "dt": 0.1}}, "a_follow": {scene}}}"#);
        let error = highway::replay(&text).unwrap_err();
        assert_eq!(error.to_string(), "`a_follow` holds an impossible scene without cars");
    }
}

#[test]
fn the_lander_flies_like_the_original() {
    let report = lander::replay(&lander_traces(), Physics::default()).unwrap();
    assert!(report.passed, "{report:#?}");
    let winds: Vec<bool> = report.comparisons.iter().map(|comparison| comparison.wind).collect();
    assert_eq!(winds, [false, true]);
    let n_frames: usize = report.comparisons.iter().map(|comparison| comparison.n_frames).sum();
    assert!(n_frames > 1500, "only {n_frames} frames compared");
}

#[test]
fn the_contact_world_alone_flies_like_the_original_unless_it_tumbles() {
    let report = lander::replay(&lander_traces(), Physics::Rapier).unwrap();
    assert!(report.comparisons[0].passed, "{report:#?}");
    // One windy episode turns over; there free flight is the better one.
    for error in report.comparisons.iter().flat_map(|comparison| &comparison.components) {
        assert!(error.median < 0.5 * error.bound, "{report:#?}");
    }
}

#[test]
fn another_action_or_seed_of_the_lander_does_not_pass() {
    let fly = |text: String| lander::replay(&text, Physics::default()).unwrap();
    let report = fly(lander_traces().replacen(r#"{"a":1,"#, r#"{"a":2,"#, 3));
    assert!(!report.passed && !report.comparisons[0].passed && report.comparisons[1].passed);
    let report = fly(lander_traces().replace(r#""seed":0,"#, r#""seed":9,"#));
    assert!(!report.passed && report.comparisons[0].reset_error > 0.1);
}

#[test]
fn a_file_that_is_not_a_trace_of_the_lander_is_refused() {
    let refused = |text: &str| lander::replay(text, Physics::default()).unwrap_err();
    assert!(matches!(refused("{}"), ReplayError::Format { .. }));
    let empty = r#"{"source": "nobody", "episodes": []}"#;
    assert!(matches!(refused(empty), ReplayError::Empty { .. }));
    let error = refused(&changed(&lander_traces(), r#"{"a":1,"#, r#"{"a":7,"#));
    assert_eq!(error.to_string(), "episode 0 of the traces has an impossible action");
}

fn n_compared(report: &SteakhouseReport, counts: impl Fn(&RecordingReport) -> bool) -> usize {
    report.comparisons.iter().filter(|row| counts(row)).map(|row| row.n_compared).sum()
}

#[test]
fn the_kitchen_is_the_originals() {
    let report = steakhouse::replay(&public()).unwrap();
    assert!(report.passed, "{report:#?}");
    assert_eq!(n_compared(&report, |row| row.name == "interact_matrix"), 182);
    assert_eq!(n_compared(&report, |row| row.name == "fov"), 16);
    // 16 scripted runs of 359 steps, and one of a start alone; 12 of the original's own cook.
    assert_eq!(report.comparisons.len(), 16 + 12 + 2);
    let of_cook = |row: &RecordingReport| row.name.starts_with("source_cook");
    let runs = n_compared(&report, |row| row.name != "interact_matrix" && row.name != "fov");
    assert_eq!(runs - n_compared(&report, of_cook), 360);
    assert!(report.source.contains("FOV-aware-planner"), "{}", report.source);
}

#[test]
fn the_cook_is_the_recorded_one() {
    let report = steakhouse::replay(&golden()).unwrap();
    assert!(report.passed, "{report:#?}");
    assert_eq!((report.comparisons.len(), n_compared(&report, |_| true)), (15, 738));
}

#[test]
fn a_changed_recording_does_not_pass() {
    let differs = |text: &str, from: &str, to: &str| {
        let report = steakhouse::replay(&changed(text, from, to)).unwrap();
        assert!(!report.passed, "{from} may be {to}");
        report.comparisons.into_iter().find_map(|row| row.first_difference).unwrap()
    };
    let public = public();
    let difference = differs(&public, r#""actions":["W","_"]"#, r#""actions":["E","_"]"#);
    assert!(difference.starts_with("cooks of step 1: "), "{difference}");
    differs(&public, r#""meat_pickup:0""#, r#""onion_pickup:0""#);
    differs(&public, r#""orders_left":2"#, r#""orders_left":3"#);
    differs(&public, "[[-4,-4],", "[");
    let golden = golden();
    differs(&golden, r#""reward":-0.15"#, r#""reward":-0.1501"#);
    differs(&golden, r#""subtask":"pickup_meat""#, r#""subtask":"pickup_onion""#);
    differs(&golden, r#""belief":[6,6,"#, r#""belief":[5,6,"#);
    differs(&golden, r#""override":["DOWN",2]"#, r#""override":["DOWN",1]"#);
    differs(&golden, r#""t_ref":70"#, r#""t_ref":71"#);
}

#[test]
fn a_file_that_is_not_a_recording_is_refused() {
    assert!(matches!(steakhouse::replay("[]"), Err(ReplayError::Format { .. })));
    assert!(matches!(steakhouse::replay("{}"), Err(ReplayError::Empty { .. })));
    let impossible = |text: &str, from: &str, to: &str| {
        let error = steakhouse::replay(&changed(text, from, to)).unwrap_err();
        match std::error::Error::source(&error) {
            Some(source) => format!("{error}: {source}"),
            None => error.to_string(),
        }
    };
    let public = public();
    let error = impossible(&public, r#""actions":["W","_"]"#, r#""actions":["Q","_"]"#);
    assert_eq!(error, "`full_task_10_2_2` holds an impossible action");
    let error = impossible(&public, r#""XPBWSXX""#, r#""XPBW XX""#);
    assert_eq!(
        error,
        "the kitchen of `full_task_10_2_2` is impossible: row 1, column 5 on the border is floor"
    );
    let error = impossible(&golden(), r#""content":[5,5,1"#, r#""content":[5,5,3"#);
    assert_eq!(error, "`all_partial_silent` holds an impossible station state");
    let error = impossible(&golden(), r#""layout":"ring""#, r#""layout":"rind""#);
    assert!(error.starts_with("the settings of `empty_silent` are impossible: "), "{error}");
}
