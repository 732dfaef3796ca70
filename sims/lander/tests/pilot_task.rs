//! The pilot's training task as any environment: episodes, variants, time limit, snapshots.

use leadtime_lander::pilot::{PilotTask, PilotTaskSettings};
use leadtime_proto::EnvId;
use leadtime_sims::{End, Environment as _, EpisodeSeed, SnapshotError, StepOutcome};

fn seed(env: u32, episode: u64) -> EpisodeSeed {
    EpisodeSeed { run_seed: 5, env_id: EnvId(env), episode }
}

fn task(change: impl FnOnce(&mut PilotTaskSettings)) -> PilotTask {
    let mut settings = PilotTaskSettings::default();
    change(&mut settings);
    PilotTask::new(&settings).expect("the settings are possible")
}

/// Lets the heuristic fly `n` steps; returns what each step gave.
fn steps(task: &mut PilotTask, n: usize) -> Vec<(StepOutcome, [f32; 8])> {
    let (mut action, mut observation) = ([0], [0.0; 8]);
    (0..n)
        .map(|_| {
            assert!(task.baseline_action("heuristic", &mut action));
            (task.step(&action, &mut observation), observation)
        })
        .collect()
}

fn metrics(task: &PilotTask) -> [f32; 4] {
    let mut metrics = [f32::NAN; 4];
    task.metrics(&mut metrics);
    metrics
}

#[test]
fn episodes_end_in_one_of_four_ways() {
    let mut task = task(|_| {});
    assert_eq!(task.spec().metrics, ["success", "crashed", "out", "timed_out"]);
    let mut seen = [0.0; 4];
    for episode in 0..30 {
        task.reset(seed(0, episode), &mut [0.0; 8]);
        let end = (0..1000).find_map(|_| steps(&mut task, 1)[0].0.end).expect("a time limit");
        let ways = metrics(&task);
        assert_eq!(ways.iter().sum::<f32>(), 1.0);
        assert_eq!(end == End::Truncated, ways[3] == 1.0);
        (0..4).for_each(|i| seen[i] += ways[i]);
    }
    assert!(seen[0] > 5.0 && seen[1] > 2.0, "{seen:?}");
}

#[test]
fn the_time_limit_truncates() {
    let mut task = task(|s| s.max_frames = 30);
    task.reset(seed(0, 0), &mut [0.0; 8]);
    let ends: Vec<_> = steps(&mut task, 30).iter().map(|(outcome, _)| outcome.end).collect();
    assert!(ends[..29].iter().all(Option::is_none));
    assert_eq!(ends[29], Some(End::Truncated));
    assert_eq!(metrics(&task), [0.0, 0.0, 0.0, 1.0]);
    // The picture shows ground, pad and lander.
    let scene = task.scene().unwrap();
    assert_eq!((scene.shapes.len(), scene.outcome.as_str()), (5, ""));
}

#[test]
fn a_snapshot_from_beyond_the_time_limit_is_refused() {
    let mut longer = task(|s| s.max_frames = 40);
    longer.reset(seed(0, 0), &mut [0.0; 8]);
    steps(&mut longer, 31);
    let (mut snapshot, mut observation) = (Vec::new(), [0.0; 8]);
    longer.snapshot(&mut snapshot);
    let error = task(|s| s.max_frames = 30).restore(&snapshot, &mut observation).unwrap_err();
    assert!(matches!(error, SnapshotError::Mismatch { what: "frames" }), "{error}");
    task(|s| s.max_frames = 31).restore(&snapshot, &mut observation).unwrap();
}

#[test]
fn wind_and_wide_starts_come_in_their_shares() {
    let fast_starts = |mut task: PilotTask| {
        let is_fast = |episode: &u64| {
            let mut observation = [0.0; 8];
            task.reset(seed(1, *episode), &mut observation);
            observation[2].abs() > 0.83
        };
        (0..200).filter(is_fast).count() as f64 / 200.0
    };
    assert_eq!(fast_starts(task(|s| s.wide_start_share = 0.0)), 0.0);
    // A wide start is uniform to 2200 N, and 1025 N give the speed 0.83: half of the episodes times 1175/2200.
    let wide = fast_starts(task(|_| {}));
    assert!((wide - 0.27).abs() < 0.1, "{wide}");
}

#[test]
fn resting_engines_stay_off_on_the_ground() {
    let mut task = task(|s| {
        (s.wind_share, s.wide_start_share, s.engines_off) = (0.0, 0.0, true);
    });
    let mut lands = |episode| {
        let (mut action, mut observation) = ([0], [0.0; 8]);
        task.reset(seed(3, episode), &mut observation);
        (0..1000).find(|_| {
            task.baseline_action("heuristic", &mut action);
            // A pilot that cannot leave its engine alone once it stands.
            let stands = leadtime_lander::pilot::engines_off(&observation);
            task.step(if stands { &[2] } else { &action }, &mut observation).end.is_some()
        });
        metrics(&task)[0] == 1.0
    };
    assert!((0..20).any(&mut lands), "no episode landed although the engines rest");
}
