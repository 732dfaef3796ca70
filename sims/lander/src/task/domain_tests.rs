//! The task with the scripted pilot, so that nothing here depends on trained weights.

use leadtime_proto::EnvId;
use leadtime_sims::Environment as _;

use super::*;
use crate::task::LanderTaskSettings;
use crate::task::maneuver::Maneuver;

/// Everything above y = 1: where every episode starts.
const SKY: Zone = Zone { x0: -2.0, x1: 2.0, y0: 1.0, y1: 3.0 };

fn settings(change: impl FnOnce(&mut LanderWorldSettings)) -> LanderWorldSettings {
    let mut settings = LanderWorldSettings {
        pilot: PilotKind::Heuristic,
        zones: Vec::new(),
        near_penalty: NearPenalty::Off,
        ..LanderWorldSettings::default()
    };
    change(&mut settings);
    settings
}

/// The same without a cost of fuel.
fn free(change: impl FnOnce(&mut LanderWorldSettings)) -> LanderWorldSettings {
    LanderWorldSettings { main_fuel: 0.0, side_fuel: 0.0, ..settings(change) }
}

fn start(settings: &LanderWorldSettings, episode: u64) -> LanderDomain {
    let mut task = LanderDomain::new(settings).unwrap();
    task.reset(EpisodeSeed { run_seed: 11, env_id: EnvId(2), episode });
    task
}

/// Flies to the end of the episode; returns the last step and the return.
fn fly(task: &mut LanderDomain, reaction: Option<ReactionStep>) -> (Advance, f64) {
    let mut total = 0.0;
    loop {
        let advance = task.advance(reaction);
        total += advance.reward;
        if advance.end.is_some() {
            return (advance, total);
        }
    }
}

fn metric(task: &LanderDomain, name: &str) -> f32 {
    let mut metrics = vec![f32::NAN; task.metric_names().len()];
    task.metrics(&mut metrics);
    metrics[task.metric_names().iter().position(|metric| *metric == name).unwrap()]
}

#[test]
fn a_landing_pays_its_reward_less_the_fuel() {
    let settings = settings(|s| s.landing_reward = 250.0);
    let landings = (0..20).filter(|&episode| {
        let mut task = start(&settings, episode);
        let (last, total) = fly(&mut task, None);
        let landed = metric(&task, "landed_on_pad") == 1.0;
        assert_eq!(task.success(), landed);
        if landed {
            let expected = 250.0 - task.progress.fuel;
            assert!((total - expected).abs() < 1e-9, "{total} {expected}");
            assert_eq!(last.end, Some(End::Terminated));
        }
        landed
    });
    // The scripted pilot lands safely in nine of ten episodes, mostly on the pad.
    assert!(landings.count() >= 12);
}

/// Checkpoints are planned with this bound before a run begins.
#[test]
fn a_snapshot_on_the_ground_is_within_what_one_in_the_air_plans_for() {
    let n_bytes = |task: &LanderDomain| {
        let mut snapshot = Vec::new();
        task.snapshot(&mut snapshot);
        snapshot.len()
    };
    let (mut in_the_air, mut largest) = (0, 0);
    for episode in 0..20 {
        let mut task = start(&settings(|_| {}), episode);
        in_the_air = in_the_air.max(n_bytes(&task));
        while task.advance(None).end.is_none() {
            largest = largest.max(n_bytes(&task));
        }
    }
    assert!(largest > in_the_air, "{in_the_air} bytes in the air, {largest} on the ground");
    let bound = 2 * in_the_air + SNAPSHOT_MARGIN;
    assert!(largest <= bound, "{largest} bytes, {bound} planned");
}

#[test]
fn entering_a_zone_ends_the_episode_or_costs_per_step_or_once() {
    let mut task = start(&settings(|s| s.zones = vec![SKY]), 0);
    let advance = task.advance(None);
    assert_eq!((advance.end, advance.reward), (Some(End::Terminated), -300.0 - task.progress.fuel));
    assert_eq!((metric(&task, "enter_danger"), task.success()), (1.0, false));
    assert_eq!(task.scene().outcome, "entered a danger zone");

    for (entry_charged, second) in [(EntryPenalty::PerStep, -20.0), (EntryPenalty::Once, 0.0)] {
        let settings = free(|s| {
            s.zones = vec![SKY];
            s.zone_ends_episode = false;
            s.entry_charged = entry_charged;
        });
        let mut task = start(&settings, 0);
        assert_eq!((task.advance(None).reward, task.advance(None).reward), (-20.0, second));
        assert_eq!(metric(&task, "danger_steps"), 2.0);
    }
}

#[test]
fn a_landing_after_a_zone_is_not_a_success() {
    let settings = settings(|s| (s.zones, s.zone_ends_episode) = (vec![SKY], false));
    let landed = (0..20).find_map(|episode| {
        let mut task = start(&settings, episode);
        fly(&mut task, None);
        (metric(&task, "landed_on_pad") == 1.0).then_some(task)
    });
    assert!(!landed.unwrap().success());
}

#[test]
fn being_near_costs_by_depth_by_side_or_by_distance() {
    let cost = |near_penalty| {
        // A narrow pillar to the right of the start, reaching far up and down.
        let pillar = Zone { x0: 0.1, x1: 0.14, y0: -5.0, y1: 5.0 };
        let settings = LanderWorldSettings { near_penalty, zones: vec![pillar], ..free(|_| {}) };
        let mut task = start(&LanderWorldSettings { start_impulse: 0.0, ..settings }, 0);
        let reward = task.advance(None).reward;
        (reward, 0.1 - task.place()[0])
    };
    let (off, distance) = cost(NearPenalty::Off);
    assert!(off == 0.0 && (0.0..0.16).contains(&distance), "{off} {distance}");
    for (near_penalty, expected) in [
        (NearPenalty::Depth, 0.2 - distance),
        (NearPenalty::Sides, 0.4 - distance - (distance + 0.04)),
        (NearPenalty::Literal, distance),
    ] {
        let (reward, _) = cost(near_penalty);
        assert!((reward + 10.0 * expected).abs() < 1e-9, "{near_penalty:?}: {reward}");
    }
}

#[test]
fn zones_can_be_charged_in_every_frame_as_fuel_is() {
    // A zone of everything, whose border is nowhere near: the near penalty of a frame is its greatest.
    let everything = Zone { x0: -9.0, x1: 9.0, y0: -9.0, y1: 9.0 };
    let charged = |n_frames, entry_charged, near_charged| {
        let mut task = start(
            &free(|s| {
                s.zones = vec![everything];
                s.zone_ends_episode = false;
                s.frames_per_step = n_frames;
                s.near_penalty = NearPenalty::Depth;
                (s.entry_charged, s.near_charged) = (entry_charged, near_charged);
            }),
            0,
        );
        let reward = task.advance(None).reward;
        assert_eq!(metric(&task, "danger_steps"), 1.0);
        let said = |what: &str| task.reward_terms().iter().any(|term| term.when.contains(what));
        assert_eq!(said("a frame in a zone"), entry_charged == EntryPenalty::PerFrame);
        assert_eq!(said(", a frame"), near_charged == NearCharge::PerFrame);
        reward
    };
    let near = 10.0 * 0.2;
    for (entry_charged, near_charged, expected) in [
        (EntryPenalty::PerStep, NearCharge::PerStep, 20.0 + near),
        (EntryPenalty::PerFrame, NearCharge::PerStep, 15.0 * 20.0 + near),
        (EntryPenalty::PerStep, NearCharge::PerFrame, 20.0 + 15.0 * near),
        (EntryPenalty::PerFrame, NearCharge::PerFrame, 15.0 * (20.0 + near)),
    ] {
        let reward = charged(15, entry_charged, near_charged);
        assert!((reward + expected).abs() < 1e-9, "{entry_charged:?}, {near_charged:?}: {reward}");
    }
    // A step of one frame costs the same either way.
    let [frame, step] = [
        charged(1, EntryPenalty::PerFrame, NearCharge::PerFrame),
        charged(1, EntryPenalty::PerStep, NearCharge::PerStep),
    ];
    assert_eq!(frame, step);
}

#[test]
fn running_out_of_time_is_a_costly_end() {
    let mut task = start(&free(|s| s.max_steps = 3), 0);
    let (last, total) = fly(&mut task, None);
    assert_eq!((last.end, total), (Some(End::Terminated), -300.0));
    assert_eq!((metric(&task, "timed_out"), task.progress.n_steps), (1.0, 3));
}

#[test]
fn shifting_left_for_ever_leaves_the_view_and_costs_as_a_crash() {
    let mut task = start(&free(|_| {}), 0);
    let (_, total) =
        fly(&mut task, Some(ReactionStep { topic: Maneuver::ShiftLeft.topic(), first: true }));
    assert_eq!((metric(&task, "out"), total), (1.0, -300.0));
    assert!(task.place()[0] <= -1.0);
}

#[test]
fn near_the_ground_the_pilot_does_not_listen() {
    let mut task = start(&settings(|_| {}), 0);
    let descend = Some(ReactionStep { topic: Maneuver::Descend.topic(), first: false });
    assert_eq!(task.advance(descend).reaction, Some(Followed));
    assert_eq!(task.advance(None).reaction, None);
    let refused = loop {
        let before = *task.lander.observation();
        let advance = task.advance(descend);
        if advance.reaction == Some(Refused) {
            break before;
        }
        assert_eq!(advance.end, None);
    };
    assert!(refused[1] < 0.1, "{refused:?}");
}

#[test]
fn zones_that_move_are_observed_and_stay_in_reach() {
    let settings =
        LanderWorldSettings { zone_jitter: [0.1, 0.05], ..LanderWorldSettings::default() };
    let mut first_sides = Vec::new();
    for episode in 0..5 {
        let task = start(&settings, episode);
        let mut observation = vec![f32::NAN; task.obs_dim()];
        task.observe(&mut observation);
        assert_eq!(observation.len(), 8 + 12);
        for (zone, original) in task.zones.iter().zip(&settings.zones) {
            assert!((zone.x0 - original.x0).abs() <= 0.1 && (zone.y1 - original.y1).abs() <= 0.05);
        }
        assert_eq!(observation[8], task.zones[0].x0 as f32);
        first_sides.push(observation[8]);
    }
    assert!(first_sides.iter().any(|&side| side != first_sides[0]));
}

#[test]
fn the_time_that_is_left_is_observed_where_it_is_asked_for() {
    let settings = free(|s| (s.observe_time, s.max_steps) = (true, 4));
    let mut task = start(&settings, 0);
    let time_left = |task: &LanderDomain| {
        let mut observation = vec![f32::NAN; task.obs_dim()];
        task.observe(&mut observation);
        assert_eq!(observation.len(), task.quantities().len());
        assert_eq!(observation[..8], *task.lander.observation());
        observation[8..].to_vec()
    };
    assert_eq!(time_left(&task), [1.0]);
    task.advance(None);
    let mut snapshot = Vec::new();
    task.snapshot(&mut snapshot);
    for expected in [0.75, 0.5, 0.25, 0.0] {
        assert_eq!(time_left(&task), [expected]);
        task.advance(None);
    }
    task.restore(&snapshot).unwrap();
    assert_eq!(time_left(&task), [0.75]);

    // After the sides of the zones, where these are observed too.
    let both = LanderWorldSettings {
        observe_time: true,
        zone_jitter: [0.1, 0.0],
        ..LanderWorldSettings::default()
    };
    let task = start(&both, 0);
    assert_eq!(task.quantities().last().unwrap().name, "time_left");
    assert_eq!(time_left(&task)[12..], [1.0]);
}

#[test]
fn a_snapshot_of_another_map_or_of_a_flight_that_cannot_have_been_is_refused() {
    let still = LanderWorldSettings::default();
    let moving = LanderWorldSettings { zone_jitter: [0.1, 0.05], ..still.clone() };
    for settings in [still, moving] {
        let mut task = start(&settings, 3);
        task.advance(None);
        let mut bytes = Vec::new();
        task.snapshot(&mut bytes);
        let refused = |change: fn(&mut LanderTaskSnapshot)| {
            let mut snapshot: LanderTaskSnapshot = read_snapshot(&bytes).unwrap();
            change(&mut snapshot);
            let mut changed = Vec::new();
            write_snapshot(&snapshot, &mut changed);
            match start(&settings, 4).restore(&changed) {
                Ok(()) => None,
                Err(SnapshotError::Mismatch { what }) => Some(what),
                Err(other) => panic!("{other}"),
            }
        };
        assert_eq!(refused(|_| {}), None);
        assert_eq!(refused(|s| s.zones[1] = s.zones[1].moved(0.3, 0.0)), Some("danger zones"));
        assert_eq!(refused(|s| s.zones[2].y1 += 0.2), Some("danger zones"));
        assert_eq!(refused(|s| s.zones.truncate(2)), Some("danger zones"));
        // As a metric this is no number any more.
        assert_eq!(refused(|s| s.progress.fuel = 1e300), Some("progress"));
        assert_eq!(refused(|s| s.progress.n_steps = 201), Some("progress"));
    }
}

/// What an honest snapshot holds is never refused: in the air, on the ground, at rest, at the end.
#[test]
fn every_step_can_be_restored() {
    for (zone_jitter, main_fuel) in [([0.0, 0.0], 0.3), ([0.3, 0.2], 0.1), ([0.0, 1.0], 0.0)] {
        let settings = LanderWorldSettings {
            zone_jitter,
            main_fuel,
            side_fuel: 0.7,
            zone_ends_episode: false,
            wind: main_fuel == 0.1,
            ..settings(|s| s.zones = crate::task::DEFAULT_ZONES.to_vec())
        };
        let mut other = start(&settings, 99);
        for episode in 0..8 {
            let mut task = start(&settings, episode);
            loop {
                let end = task.advance(None).end;
                let mut bytes = Vec::new();
                task.snapshot(&mut bytes);
                other.restore(&bytes).unwrap();
                assert_eq!(other.zones, task.zones);
                if end.is_some() {
                    break;
                }
            }
        }
    }
}

#[test]
fn the_scripted_notifier_speaks_near_zones_only() {
    let task = start(&settings(|s| s.zones = vec![SKY]), 0);
    assert!(task.heuristic().is_some());
    let far = Zone { x0: 1.5, x1: 2.0, y0: 0.0, y1: 0.1 };
    assert_eq!(start(&settings(|s| s.zones = vec![far]), 0).heuristic(), None);
}

#[test]
fn a_scene_shows_zones_ground_and_lander() {
    let task = start(&LanderWorldSettings::default(), 0);
    let shapes = task.scene().shapes;
    let is = |wanted, shape: &Shape| match shape {
        Shape::Rectangle { tone, .. } | Shape::Polygon { tone, .. } => *tone == wanted,
        _ => false,
    };
    let count = |wanted| shapes.iter().filter(|shape| is(wanted, shape)).count();
    assert_eq!([Tone::Danger, Tone::Ground, Tone::Own].map(count), [3, 1, 3]);
}

#[test]
fn the_documented_input_width_is_right() {
    let mut settings = LanderTaskSettings::default();
    settings.notifier.observe_utterance = false;
    assert_eq!(settings.build().unwrap().spec().obs_dim, 84);
}
