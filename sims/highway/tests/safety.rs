//! The road with three merges is dangerous without help, and a timely "slow down" makes it safe.

mod danger;

use danger::{Safety, measure};
use leadtime_highway::task::{EgoSettings, HighwayTaskSettings, HighwayWorldSettings};
use leadtime_highway::world::Blindness;
use leadtime_proto::EnvId;
use leadtime_sims::{Environment as _, EpisodeSeed};

const N_EPISODES: u64 = 100;

fn drive(slow_down_from: Option<f64>, change: impl FnOnce(&mut HighwayWorldSettings)) -> Safety {
    let mut settings = HighwayWorldSettings::default();
    change(&mut settings);
    measure(&settings, slow_down_from, 0..N_EPISODES)
}

#[test]
fn an_unaided_ego_crashes_in_about_half_of_the_episodes_at_every_merge() {
    let found = drive(None, |_| {});
    assert!((0.35..0.75).contains(&found.crash_rate()), "{found:?}");
    assert_eq!(found.n_arrived + found.n_crashed, found.n_episodes);
    // The merge from the left is as real as those from the right.
    assert!(found.crashes.iter().all(|&crashes| crashes >= 8), "{found:?}");
}

#[test]
fn slowing_down_early_saves_and_late_does_not() {
    let early = drive(Some(150.0), |_| {});
    assert!(early.crash_rate() < 0.05, "{early:?}");
    let late = drive(Some(70.0), |_| {});
    assert!(late.crash_rate() > 0.2, "{late:?}");
}

#[test]
fn an_ego_that_is_seen_and_sees_is_safer() {
    let blind = drive(None, |_| {});
    let seeing = drive(None, |s| s.merging.blindness = Blindness::Never);
    assert!(2 * seeing.n_crashed < blind.n_crashed, "{seeing:?} {blind:?}");
}

#[test]
fn lanes_matter() {
    let on_the_right = drive(None, |s| s.ego = EgoSettings { lane: Some(1), ..s.ego });
    assert!(on_the_right.crash_rate() > 0.35, "{on_the_right:?}");
    let stays = |s: &mut HighwayWorldSettings| {
        s.ego = EgoSettings { lane: Some(1), changes_lanes: false, ..s.ego };
    };
    let stays = drive(None, stays);
    assert!(stays.crashes[1] < on_the_right.crashes[1].max(3), "{stays:?} {on_the_right:?}");
}

/// Drives with a scripted notifier; returns the success rate and the notifications per episode.
fn notify(baseline: &str) -> (f32, f32) {
    let mut env = HighwayTaskSettings::default().build().expect("the default task can be built");
    let n_episodes: u16 = 100;
    let mut observation = vec![0.0; env.spec().obs_dim];
    let mut metrics = vec![0.0; env.spec().metrics.len()];
    let (mut n_success, mut n_messages) = (0.0, 0.0);
    for episode in 0..u64::from(n_episodes) {
        env.reset(EpisodeSeed { run_seed: 0, env_id: EnvId(0), episode }, &mut observation);
        let mut action = [0; 4];
        loop {
            assert!(env.baseline_action(baseline, &mut action));
            if env.step(&action, &mut observation).end.is_some() {
                break;
            }
        }
        env.metrics(&mut metrics);
        n_success += metrics[0];
        n_messages += metrics[1];
    }
    (n_success / f32::from(n_episodes), n_messages / f32::from(n_episodes))
}

#[test]
fn the_scripted_notifier_saves_most_of_those_who_would_crash() {
    let ((unaided, silence), (warned, messages)) = (notify("unaided"), notify("heuristic"));
    assert_eq!(silence, 0.0);
    assert!((0.25..0.65).contains(&unaided), "{unaided}");
    assert!(warned > unaided + 0.25, "{warned} {unaided}");
    // It says so again and again while a conflict is in sight, as it does not know what was understood.
    assert!((3.0..30.0).contains(&messages), "{messages}");
}
