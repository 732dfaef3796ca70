//! The highway against recorded scenes of highway-env: same start, same actions, same traffic.

use std::io::Read as _;

use flate2::read::GzDecoder;
use leadtime_conformance::highway::{HighwayReplayError, HighwayReport, replay};

fn traces() -> String {
    let packed = include_bytes!("../../../tests/data/highway_traces.json.gz");
    let mut text = String::new();
    GzDecoder::new(packed.as_slice()).read_to_string(&mut text).expect("the traces are gzip");
    text
}

fn failed(report: &HighwayReport) -> Vec<&'static str> {
    let failed = report.scenarios.iter().filter(|scenario| !scenario.passed);
    failed.map(|scenario| scenario.name).collect()
}

#[test]
fn the_traffic_moves_like_the_original() {
    let report = replay(&traces()).unwrap();
    assert!(report.passed, "{report:#?}");
    assert_eq!(report.scenarios.len(), 12);
    let n_states: usize = report.scenarios.iter().map(|scenario| scenario.n_states).sum();
    let n_decisions: usize = report.scenarios.iter().map(|scenario| scenario.n_decisions).sum();
    assert!(n_states > 15_000 && n_decisions > 150, "{n_states} states, {n_decisions} decisions");
}

#[test]
fn another_start_action_or_gap_does_not_pass() {
    let text = traces();
    let wrong = text.replacen(
        r#""speed":15.0,"lane":1,"target_lane":1"#,
        r#""speed":15.5,"lane":1,"target_lane":1"#,
        1,
    );
    assert_eq!(failed(&replay(&wrong).unwrap()), ["c_mobil"]);
    let wrong = text.replacen(r#""45":"LANE_RIGHT""#, r#""45":"LANE_LEFT""#, 1);
    assert_eq!(failed(&replay(&wrong).unwrap()), ["d2_meta_actions"]);
    let wrong = text.replacen(r#""intersecting":true"#, r#""intersecting":false"#, 1);
    assert_eq!(failed(&replay(&wrong).unwrap()), ["unit_collisions"]);
    let wrong = text.replacen(r#""terminated":true"#, r#""terminated":false"#, 1);
    assert_eq!(failed(&replay(&wrong).unwrap()), ["e_merge"]);
    let wrong = text.replacen(r#""acceleration":1.553240741"#, r#""acceleration":1.553240841"#, 1);
    assert_eq!(failed(&replay(&wrong).unwrap()), ["unit_idm"]);
}

#[test]
fn what_is_no_trace_says_so() {
    assert!(matches!(replay("{}"), Err(HighwayReplayError::Format(_))));
    let empty = r#"{"meta": {"highway_env": "0", "dt": 0.1}}"#;
    assert!(matches!(replay(empty), Err(HighwayReplayError::Empty)));
    let impossible = traces().replacen(r#""45":"LANE_RIGHT""#, r#""45":"U_TURN""#, 1);
    let error = replay(&impossible).unwrap_err();
    assert_eq!(error.to_string(), "scenario `d2_meta_actions` has the unknown action `U_TURN`");
}
