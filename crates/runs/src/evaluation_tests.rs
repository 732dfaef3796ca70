use super::*;
use crate::test_support::config;

/// Training goes on after the arrival, where a car stands and is paid; nothing that is measured or shown does.
#[test]
fn a_drive_is_evaluated_and_shown_up_to_its_arrival() {
    let runs = tempfile::tempdir().unwrap();
    let config = config(runs.path(), "highway", "road", &[]);
    let (tasks, players) = (Tasks::new(), [Player::baseline("unaided")]);
    let evaluations = evaluate_all(&tasks, &config, &players, 8, 3).unwrap();
    let lengths: Vec<u64> = evaluations[0].episodes.iter().map(|episode| episode.n_steps).collect();
    let arrived = evaluations[0].column("arrived").unwrap();
    let first = arrived.iter().position(|arrived| *arrived == 1.0).unwrap();
    assert!(lengths.iter().all(|length| *length < 130), "{lengths:?}");
    let shown = record(&tasks, &config, &players[0], None, 3, first as u64).unwrap();
    assert!(shown.played.scenes.len() < 130, "{}", shown.played.scenes.len());
}
