use super::*;
use crate::test_support::config;

/// Training goes on after the arrival, where a car stands and is paid; nothing that is measured or shown does.
#[test]
fn a_drive_is_evaluated_and_shown_up_to_its_arrival() {
    let runs = tempfile::tempdir().unwrap();
    let config = config(runs.path(), "highway", "road", &["world.merging.blindness=\"never\""]);
    let (tasks, players) = (Tasks::new(), [Player::baseline("unaided")]);
    let evaluations = evaluate_all(&tasks, &config, &players, 8, 3).unwrap();
    let [lengths, arrived] = ["length", "arrived"].map(|name| evaluations[0].column(name).unwrap());
    let first = arrived.iter().position(|arrived| *arrived == 1.0).unwrap();
    assert!(lengths.iter().all(|length| *length < 130.0), "{lengths:?}");
    let shown = record(&tasks, &config, &players[0], None, 3, first as u64).unwrap();
    assert!(shown.played.scenes.len() < 130, "{}", shown.played.scenes.len());
}
