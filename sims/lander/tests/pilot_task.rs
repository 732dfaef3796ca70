//! The pilot's training task as any environment: episodes, variants, time limit, snapshots.

use leadtime_lander::pilot::{PilotTask, PilotTaskSettings};
use leadtime_proto::EnvId;
use leadtime_sims::{End, Environment as _, EpisodeSeed, StepOutcome};

fn seed(env: u32, episode: u64) -> EpisodeSeed {
    EpisodeSeed { run_seed: 5, env_id: EnvId(env), episode }
}

fn task(settings: &PilotTaskSettings) -> PilotTask {
    PilotTask::new(settings).expect("the settings are possible")
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
    let mut task = task(&PilotTaskSettings { wind_share: 0.5, ..PilotTaskSettings::default() });
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
    let mut task = task(&PilotTaskSettings { max_frames: 30, ..PilotTaskSettings::default() });
    task.reset(seed(0, 0), &mut [0.0; 8]);
    let ends: Vec<_> = steps(&mut task, 30).iter().map(|(outcome, _)| outcome.end).collect();
    assert!(ends[..29].iter().all(Option::is_none));
    assert_eq!(ends[29], Some(End::Truncated));
    assert_eq!(metrics(&task), [0.0, 0.0, 0.0, 1.0]);
}

#[test]
fn wind_and_wide_starts_come_in_their_shares() {
    let first_speeds = |settings: &PilotTaskSettings| -> Vec<f32> {
        let mut task = task(settings);
        let speed = |episode| {
            let mut observation = [0.0; 8];
            task.reset(seed(1, episode), &mut observation);
            observation[2].abs()
        };
        (0..200).map(speed).collect()
    };
    let narrow = PilotTaskSettings { wide_start_share: 0.0, ..PilotTaskSettings::default() };
    let share = |speeds: &[f32]| speeds.iter().filter(|&&v| v > 0.83).count() as f64 / 200.0;
    assert_eq!(share(&first_speeds(&narrow)), 0.0);
    // A wide start is uniform to 2200 N, and 1025 N give the speed 0.83: half of the episodes times 1175/2200.
    let wide = share(&first_speeds(&PilotTaskSettings::default()));
    assert!((wide - 0.27).abs() < 0.1, "{wide}");
}

#[test]
fn an_episode_can_move_to_another_process() {
    let mut here = task(&PilotTaskSettings::default());
    here.reset(seed(2, 9), &mut [0.0; 8]);
    for n in [25, 120] {
        steps(&mut here, n);
        let (mut snapshot, mut observation) = (Vec::new(), [0.0; 8]);
        here.snapshot(&mut snapshot);
        let mut there = task(&PilotTaskSettings::default());
        there.restore(&snapshot, &mut observation).unwrap();
        assert_eq!(steps(&mut here, 40), steps(&mut there, 40));
        assert_eq!(metrics(&here), metrics(&there));
        snapshot.pop();
        assert!(there.restore(&snapshot, &mut observation).is_err());
    }
}

#[test]
fn resting_engines_stay_off_on_the_ground() {
    let mut task = task(&PilotTaskSettings {
        wind_share: 0.0,
        wide_start_share: 0.0,
        engines_off: true,
        ..PilotTaskSettings::default()
    });
    for episode in 0..20 {
        task.reset(seed(3, episode), &mut [0.0; 8]);
        let mut observation = [0.0; 8];
        for _ in 0..1000 {
            let mut action = [0];
            task.baseline_action("heuristic", &mut action);
            // A pilot that cannot leave its engine alone once it stands.
            let stands = leadtime_lander::pilot::engines_off(&observation);
            let outcome = task.step(if stands { &[2] } else { &action }, &mut observation);
            if outcome.end.is_some() {
                break;
            }
        }
        if metrics(&task)[0] == 1.0 {
            return;
        }
    }
    panic!("no episode landed although the engines rest");
}

#[test]
fn a_picture_shows_ground_pad_and_lander() {
    let mut task = task(&PilotTaskSettings::default());
    task.reset(seed(0, 0), &mut [0.0; 8]);
    let scene = task.scene().unwrap();
    assert_eq!(scene.shapes.len(), 5);
    assert!(scene.outcome.is_empty());
}
