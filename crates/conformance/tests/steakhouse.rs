//! The kitchen against recorded states of the public original, and the cook against our own recorded episodes.

use std::io::Read as _;

use flate2::read::GzDecoder;
use leadtime_conformance::steakhouse::{
    RecordingReport, SteakhouseReplayError, SteakhouseReport, replay,
};

fn unpack(packed: &[u8]) -> String {
    let mut text = String::new();
    GzDecoder::new(packed).read_to_string(&mut text).expect("the recordings are gzip");
    text
}

fn public() -> String {
    unpack(include_bytes!("../../../tests/data/steak_traces.json.gz"))
}

fn golden() -> String {
    unpack(include_bytes!("../../../tests/data/steak_golden.json.gz"))
}

fn n_compared(report: &SteakhouseReport, counts: impl Fn(&RecordingReport) -> bool) -> usize {
    report.comparisons.iter().filter(|row| counts(row)).map(|row| row.n_compared).sum()
}

#[test]
fn the_kitchen_is_the_originals() {
    let report = replay(&public()).unwrap();
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
    let report = replay(&golden()).unwrap();
    assert!(report.passed, "{report:#?}");
    assert_eq!((report.comparisons.len(), n_compared(&report, |_| true)), (15, 738));
}

#[test]
fn a_changed_recording_does_not_pass() {
    let differs = |text: &str, from: &str, to: &str| {
        let changed = text.replacen(from, to, 1);
        assert_ne!(changed, text, "{from} is in the recording");
        let report = replay(&changed).unwrap();
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
fn what_is_no_recording_says_so() {
    assert!(matches!(replay("[]"), Err(SteakhouseReplayError::Format(_))));
    assert!(matches!(replay("{}"), Err(SteakhouseReplayError::Empty)));
    let impossible = |text: &str, from: &str, to: &str| {
        replay(&text.replacen(from, to, 1)).unwrap_err().to_string()
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
    assert!(
        error.starts_with("the settings of `empty_silent` are impossible: `world.layout`"),
        "{error}"
    );
}
