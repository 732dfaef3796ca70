//! The lander against recorded episodes of Gymnasium's (Box2D): same seeds, same actions, same flight.

use std::io::Read as _;

use flate2::read::GzDecoder;
use leadtime_conformance::lander::{LanderReplayError, LanderReport, replay, replay_with};
use leadtime_lander::world::Physics;

fn traces() -> String {
    let packed = include_bytes!("../../../tests/data/lander_traces.json.gz");
    let mut text = String::new();
    GzDecoder::new(packed.as_slice()).read_to_string(&mut text).expect("the traces are gzip");
    text
}

fn assert_passed(report: &LanderReport) {
    assert!(report.passed, "{report:#?}");
    let winds: Vec<bool> = report.comparisons.iter().map(|comparison| comparison.wind).collect();
    assert_eq!(winds, [false, true]);
    let n_frames: usize = report.comparisons.iter().map(|comparison| comparison.n_frames).sum();
    assert!(n_frames > 1500, "only {n_frames} frames compared");
}

#[test]
fn the_lander_flies_like_the_original() {
    assert_passed(&replay(&traces()).unwrap());
}

#[test]
fn the_contact_world_alone_flies_like_the_original_unless_it_tumbles() {
    let report = replay_with(&traces(), Physics::Rapier).unwrap();
    assert!(report.comparisons[0].passed, "{report:#?}");
    // One windy episode turns over; there free flight is the better one.
    for error in report.comparisons.iter().flat_map(|comparison| &comparison.components) {
        assert!(error.median < 0.5 * error.bound, "{report:#?}");
    }
}

#[test]
fn a_wrong_action_does_not_pass() {
    let wrong = traces().replacen(r#"{"a":1,"#, r#"{"a":2,"#, 3);
    let report = replay(&wrong).unwrap();
    assert!(!report.passed && !report.comparisons[0].passed && report.comparisons[1].passed);
}

#[test]
fn another_seed_does_not_pass() {
    let report = replay(&traces().replace(r#""seed":0,"#, r#""seed":9,"#)).unwrap();
    assert!(!report.passed);
    assert!(report.comparisons[0].reset_error > 0.1);
}

#[test]
fn what_is_no_trace_says_so() {
    assert!(matches!(replay("{}"), Err(LanderReplayError::Format(_))));
    let empty = replay(r#"{"source": "nobody", "episodes": []}"#);
    assert!(matches!(empty, Err(LanderReplayError::Empty)));
    let impossible = traces().replacen(r#"{"a":1,"#, r#"{"a":7,"#, 1);
    let error = replay(&impossible).unwrap_err();
    assert_eq!(error.to_string(), "episode 0 of the traces has an impossible action");
}
