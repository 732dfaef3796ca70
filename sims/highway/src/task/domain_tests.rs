//! The task: who comes, what a reaction does, what a step pays, how an episode ends.

use leadtime_proto::EnvId;
use leadtime_sims::Environment as _;
use leadtime_sims::human::HumanSettings;
use leadtime_sims::notifier::{NotifierEnv, NotifierSettings};

use super::*;
use crate::task::UnsafeChanges;
use crate::task::reaction::{MERGE_LEFT, MERGE_RIGHT, SLOW_DOWN, SPEED_UP};
use crate::world::{RoadSettings, Side};

fn seed(episode: u64) -> EpisodeSeed {
    EpisodeSeed { run_seed: 11, env_id: EnvId(2), episode }
}

fn settings(change: impl FnOnce(&mut HighwayWorldSettings)) -> HighwayWorldSettings {
    let mut settings = HighwayWorldSettings::default();
    change(&mut settings);
    settings
}

/// A road without ramps and traffic.
fn empty(s: &mut HighwayWorldSettings) {
    s.road = RoadSettings::merges(&[]);
    s.road.lanes.iter_mut().for_each(|lane| lane.end[0] = 1080.0);
    s.traffic.cars.clear();
}

fn start(settings: &HighwayWorldSettings, episode: u64) -> HighwayDomain {
    let mut task = HighwayDomain::new(settings).unwrap();
    task.reset(seed(episode));
    task
}

/// Starts on the right lane of an empty road.
fn on_the_right(change: impl FnOnce(&mut HighwayWorldSettings)) -> HighwayDomain {
    let mut settings = settings(empty);
    settings.ego.lane = Some(1);
    change(&mut settings);
    start(&settings, 0)
}

/// Drives to the end of the episode; returns the last step, the return and the number of steps.
fn drive(task: &mut HighwayDomain) -> (Advance, f64, u32) {
    let mut total = 0.0;
    loop {
        let advance = task.advance(None);
        total += advance.reward;
        if advance.end.is_some() {
            return (advance, total, task.progress.n_steps);
        }
    }
}

fn react(task: &mut HighwayDomain, topic: usize, first: bool) -> Option<ReactionStatus> {
    task.advance(Some(ReactionStep { topic, first })).reaction
}

fn metric(task: &HighwayDomain, name: &str) -> f32 {
    let mut metrics = vec![f32::NAN; task.metric_names().len()];
    task.metrics(&mut metrics);
    metrics[task.metric_names().iter().position(|metric| *metric == name).unwrap()]
}

#[test]
fn an_episode_starts_as_drawn() {
    let mut lanes = [0; 2];
    for episode in 0..40 {
        let task = start(&HighwayWorldSettings::default(), episode);
        let [ego, cars @ ..] = &task.traffic.vehicles[..] else { panic!("there is an ego") };
        assert_eq!((ego.position[0], ego.speed, ego.target_speed), (30.0, 30.0, 30.0));
        lanes[usize::from(ego.position[1] == 4.0)] += 1;
        assert_eq!(cars.len(), 3);
        for (car, (x, speed)) in cars.iter().zip([(90.0, 29.0), (70.0, 31.0), (5.0, 31.5)]) {
            assert!((car.position[0] - x).abs() <= 5.0 && (car.speed - speed).abs() <= 1.0);
            assert_eq!(car.target_speed, car.speed);
        }
    }
    assert!(lanes.iter().all(|&n| n > 8), "{lanes:?}");
    let task = start(&settings(|s| s.ego.lane = Some(0)), 0);
    assert_eq!(task.ego().position[1], 0.0);
}

#[test]
fn a_merging_car_appears_when_the_ego_comes_near() {
    let mut task = start(&settings(|s| s.traffic.cars.clear()), 0);
    // The ego starts exactly 200 m before the first merge, and has moved on after a frame.
    assert_eq!(task.traffic.vehicles.len(), 1);
    task.advance(None);
    let car = task.traffic.vehicles[1];
    assert_eq!((car.role, car.target_speed), (CarRole::Merging, 30.0));
    // 20 m/s * 200 m / 30 m/s before the merge, less a lead of at most 30 m; after at most 5 frames.
    assert!((230.0 - 133.4..230.0 - 103.3 + 20.0 / 3.0).contains(&car.position[0]), "{car:?}");
    assert_eq!(car.position[1], 14.5);
    for (n_cars, side, merge_x) in [(2, Side::Left, 540.0), (3, Side::Right, 850.0)] {
        // Slowly, or the ego might meet a car before the next one comes.
        while task.traffic.vehicles.len() == n_cars {
            assert_eq!(react(&mut task, SLOW_DOWN, false), Some(ReactionStatus::Followed));
            assert!(!task.ego().crashed);
        }
        let (ego, car) = (task.ego().position[0], task.traffic.vehicles[n_cars].position);
        assert!((merge_x - 200.0..merge_x - 200.0 + 13.0).contains(&ego), "{ego}");
        assert_eq!(car[1] < 0.0, side == Side::Left);
    }
}

#[test]
fn merging_cars_and_the_ego_do_not_see_each_other_until_they_settle() {
    let mut task = start(&settings(|s| s.traffic.cars.clear()), 3);
    task.advance(None);
    assert!(!task.traffic.sees(0, 1) && !task.traffic.sees(1, 0));
    let settled = (0..100).find(|_| {
        task.advance(None);
        task.traffic.sees(0, 1)
    });
    assert!(settled.is_some(), "the car never settles");
    let car = task.traffic.vehicles[1];
    let lane = task.traffic.network().lane(car.lane);
    assert!(!lane.forbidden && lane.local(car.position)[1].abs() < 0.5);
}

/// Who sees whom is the listener's business: what the notifier's script and its numbers tell of a ramp is the same.
#[test]
fn a_merging_car_is_one_whoever_sees_it() {
    use crate::world::Blindness::{Always, Never, UntilOnCarriageway, UntilSettled};
    let lead = |task: &HighwayDomain| {
        let names = task.script_quantities();
        let mut numbers = vec![f32::NAN; names.len()];
        task.observe_for_scripts(&mut numbers);
        numbers[names.iter().position(|it| it.name == "merger.lead").unwrap()]
    };
    for blindness in [UntilSettled, UntilOnCarriageway, Always, Never] {
        let mut task = start(
            &settings(|s| {
                s.traffic.cars.clear();
                (s.ego.lane, s.merging.blindness) = (Some(1), blindness);
            }),
            0,
        );
        let warned = (0..6).any(|_| {
            task.advance(None);
            task.heuristic().is_some()
        });
        assert!(warned && lead(&task).abs() < 100.0, "{blindness:?}: {}", lead(&task));
        assert_eq!(task.traffic.sees(0, 1), blindness == Never, "{blindness:?}");

        // Both are beyond the first ramp, the car in the middle of a lane: it comes from no ramp that lies ahead.
        let network = task.traffic.network();
        let car =
            |place, role| Vehicle::new(network, place, 0.0, 30.0).with_idm(30.0).with_role(role);
        let cars = [car([350.0, 0.0], CarRole::Ego), car([400.0, 4.0], CarRole::Merging)];
        task.traffic.vehicles = cars.to_vec();
        task.traffic.step(1.0 / 15.0);
        assert_eq!((lead(&task), task.heuristic()), (1000.0, None), "{blindness:?}");
        assert_eq!(task.traffic.sees(0, 1), blindness != Always, "{blindness:?}");
        assert_eq!(task.traffic.sees(1, 0), blindness != Always, "{blindness:?}");
        let mut bytes = Vec::new();
        task.snapshot(&mut bytes);
        task.traffic.vehicles.truncate(1);
        task.restore(&bytes).unwrap();
        assert_eq!(task.traffic.sees(0, 1), blindness != Always, "{blindness:?}");
    }
}

#[test]
fn speeds_climb_the_grid_from_the_actual_speed() {
    let mut task = start(&settings(empty), 0);
    assert_eq!(react(&mut task, SLOW_DOWN, true), Some(ReactionStatus::Followed));
    assert_eq!(task.ego().target_speed, 26.5);
    // The controller brakes by (26.5 - 30) / 0.6, which is 5.83 m/s².
    assert!((30.0 - task.ego().speed - 1.74).abs() < 0.3, "{}", task.ego().speed);
    for _ in 0..30 {
        react(&mut task, SLOW_DOWN, false);
    }
    assert!((task.ego().speed - 15.0).abs() < 0.1);
    for _ in 0..60 {
        react(&mut task, SPEED_UP, false);
    }
    assert!(task.ego().speed > 33.0, "{}", task.ego().speed);
    task.advance(None);
    assert_eq!(task.ego().target_speed, 30.0);
}

#[test]
fn a_lane_change_acts_once_and_mobil_rests_meanwhile() {
    let mut task = on_the_right(|_| {});
    let can_think = |task: &HighwayDomain| match task.ego().driver {
        Driver::Idm(idm) => idm.changes_lanes,
        _ => panic!("the ego has a driver"),
    };
    let step = |first| Some(ReactionStep { topic: MERGE_LEFT, first });
    let (first, second) = (task.advance(step(true)), task.advance(step(false)));
    assert_eq!([first, second].map(|step| step.reaction), [Some(ReactionStatus::Followed); 2]);
    // -0.05 / 1.8 in the first step only; at 30 m/s both are otherwise alike.
    assert!((second.reward - first.reward).abs() > 0.02, "{first:?} {second:?}");
    assert_eq!(task.ego().target_lane, 0);
    assert!(!can_think(&task));
    for _ in 0..10 {
        task.advance(None);
    }
    assert!(can_think(&task) && task.ego().position[1].abs() < 0.2);
}

#[test]
fn an_impossible_lane_change_is_refused_and_charged() {
    let mut task = on_the_right(|_| {});
    let step = |first| Some(ReactionStep { topic: MERGE_RIGHT, first });
    let (refused, later) = (task.advance(step(true)), task.advance(step(false)));
    assert_eq!([refused, later].map(|step| step.reaction), [Some(ReactionStatus::Refused); 2]);
    assert!((later.reward - refused.reward - 0.05 / 1.8).abs() < 1e-9);
    assert_eq!((task.ego().target_lane, metric(&task, "refused_changes")), (1, 1.0));
    // Towards a ramp as well.
    let mut task = start(&settings(|s| (s.traffic.cars.clear(), s.ego.lane = Some(1)).1), 0);
    while task.ego().position[0] < 240.0 {
        task.advance(None);
    }
    assert_eq!(task.traffic.network().n_abreast(task.ego().lane), 3);
    assert_eq!(react(&mut task, MERGE_RIGHT, true), Some(ReactionStatus::Refused));
}

#[test]
fn an_unsafe_lane_change_is_executed_or_refused() {
    let with = |unsafe_changes| {
        let mut task = on_the_right(|s| s.ego.unsafe_changes = unsafe_changes);
        // Somebody fast, close behind on the left.
        let car = Vehicle::new(task.traffic.network(), [22.0, 0.0], 0.0, 38.0).with_idm(38.0);
        task.traffic.vehicles.push(car);
        react(&mut task, MERGE_LEFT, true)
    };
    assert_eq!(with(UnsafeChanges::Execute), Some(ReactionStatus::Followed));
    assert_eq!(with(UnsafeChanges::Refuse), Some(ReactionStatus::Refused));
}

#[test]
fn an_undisturbed_drive_arrives_and_waits_until_its_time_is_over() {
    let mut task = on_the_right(|_| {});
    let (last, total, n_steps) = drive(&mut task);
    assert_eq!((last.end, n_steps, task.success()), (Some(End::Terminated), 200, true));
    // 960 m at 30 m/s are 32 s or 96 steps at (0.1 + 0.2 * 15 / 23 + 1.5) / 1.8, then 1 per step; the last step of
    // the drive crosses the goal.
    let expected = 96.0 * 0.961_352_657 + 104.0;
    assert!((total - expected).abs() < 0.1, "{total} {expected}");
    assert!((metric(&task, "mean_speed") - 30.0).abs() < 1e-3);
    assert_eq!(metric(&task, "hardest_braking"), 0.0);
    let mut task = start(&settings(|s| (empty(s), s.absorb_until = 0).1), 0);
    let (last, _, n_steps) = drive(&mut task);
    assert!(last.end == Some(End::Terminated) && (96..=97).contains(&n_steps), "{n_steps}");
    assert_eq!(task.scene().outcome, "arrived");
}

#[test]
fn time_runs_out_as_a_truncation() {
    let mut task = start(&settings(|s| (s.max_steps, s.absorb_until) = (5, 0)), 0);
    let (last, _, n_steps) = drive(&mut task);
    assert_eq!((last.end, n_steps, task.success()), (Some(End::Truncated), 5, false));
    assert_eq!(metric(&task, "timed_out"), 1.0);
}

#[test]
fn a_crash_ends_the_episode_and_costs() {
    let crashed = (0..40).find_map(|episode| {
        let mut task = start(&HighwayWorldSettings::default(), episode);
        let (last, ..) = drive(&mut task);
        (metric(&task, "crashed") == 1.0).then_some((task, last))
    });
    let (task, last) = crashed.expect("one of forty unaided episodes ends in a crash");
    assert_eq!((last.end, task.success()), (Some(End::Terminated), false));
    assert!(last.reward < 0.5 && task.crash_ramp().is_some(), "{last:?}");
    assert_eq!(task.scene().outcome, "crashed");
    assert!((metric(&task, "return_collision") + 1.0 / 1.8).abs() < 1e-6);
}

#[test]
fn the_pieces_of_the_return_add_up() {
    let mut task = start(&settings(|s| s.absorb_until = 0), 1);
    let (_, total, n_steps) = drive(&mut task);
    let pieces: f64 = task.progress.pieces.iter().sum();
    assert!((total - pieces - f64::from(n_steps) * 1.5 / 1.8).abs() < 1e-9);
}

#[test]
fn the_scripted_notifier_warns_before_a_merge_and_not_far_from_one() {
    let mut task = start(&settings(|s| s.ego.lane = Some(1)), 0);
    let mut warned = Vec::new();
    while task.advance(None).end.is_none() && !task.has_arrived() {
        if let Some(message) = task.heuristic() {
            assert!(message.comprehension <= message.conveyance);
            warned.push(task.ego().position[0]);
        }
    }
    assert!(!warned.is_empty());
    let near = |x: f64| {
        [230.0, 540.0, 850.0].iter().any(|merge| (merge - 200.0..merge + 80.0).contains(&x))
    };
    assert!(warned.iter().all(|&x| near(x)), "{warned:?}");
    assert_eq!(start(&settings(empty), 0).heuristic(), None);
}

#[test]
fn a_scene_shows_road_cars_and_ego() {
    use leadtime_sims::scene::{Shape, Tone};
    let mut task = start(&HighwayWorldSettings::default(), 0);
    while task.ego().position[0] < 200.0 {
        task.advance(None);
    }
    let scene = task.scene();
    let polygon = |wanted| {
        let is_it =
            move |shape: &Shape| matches!(shape, Shape::Polygon { tone, .. } if *tone == wanted);
        scene.shapes.iter().position(is_it)
    };
    assert_eq!(polygon(Tone::Own), Some(scene.shapes.len() - 1));
    assert!(polygon(Tone::Ground) < polygon(Tone::Other));
    // What is on the right of the road is below in the picture.
    let (min, max) = ([309.0, -9.0], [311.0, -7.0]);
    assert!(scene.shapes.contains(&Shape::Rectangle { min, max, tone: Tone::Danger }));
}

#[test]
fn broken_snapshots_are_refused() {
    let mut task = start(&HighwayWorldSettings::default(), 0);
    for _ in 0..10 {
        task.advance(None);
    }
    let mut bytes = Vec::new();
    task.snapshot(&mut bytes);
    let fewer = settings(|s| s.traffic.cars.truncate(1));
    let error = HighwayDomain::new(&fewer).unwrap().restore(&bytes).unwrap_err();
    assert!(matches!(error, SnapshotError::Mismatch { what: "cars" }), "{error}");
    assert!(task.restore(&bytes[..bytes.len() - 1]).is_err());
    for at in 0..bytes.len() {
        let mut flipped = bytes.clone();
        flipped[at] ^= 0x41;
        if task.restore(&flipped).is_ok() {
            task.advance(None);
            task.observe(&mut vec![0.0; task.obs_dim()]);
        }
    }
}

/// Another number under one schema would make an ego of a merging car.
#[test]
fn roles_keep_their_numbers_in_snapshots() {
    let roles = [CarRole::Traffic, CarRole::Ego, CarRole::Merging, CarRole::Merged];
    let written = roles.map(|role| {
        let mut bytes = Vec::new();
        write_snapshot(&role, &mut bytes);
        bytes
    });
    assert_eq!(written, [[0], [1], [2], [3]]);
}

/// Finite they are, and no rollout may hold what becomes of them.
#[test]
fn a_snapshot_of_a_drive_that_cannot_have_been_is_refused() {
    let mut task = start(&HighwayWorldSettings::default(), 0);
    task.advance(None);
    let mut bytes = Vec::new();
    task.snapshot(&mut bytes);
    let mut refused = |change: fn(&mut HighwaySnapshot)| {
        let mut snapshot: HighwaySnapshot = read_snapshot(&bytes).unwrap();
        change(&mut snapshot);
        let mut changed = Vec::new();
        write_snapshot(&snapshot, &mut changed);
        match task.restore(&changed) {
            Ok(()) => None,
            Err(SnapshotError::Mismatch { what }) => Some(what),
            Err(other) => panic!("{other}"),
        }
    };
    assert_eq!(refused(|_| {}), None);
    assert_eq!(refused(|s| s.progress.pieces[4] = -1e300), Some("progress"));
    assert_eq!(refused(|s| s.progress.penalties[1] = 1e10), Some("progress"));
    assert_eq!(refused(|s| s.progress.hardest_braking = 1e300), Some("progress"));
    assert_eq!(refused(|s| s.vehicles[EGO].speed = 1e8), Some("cars"));
    assert_eq!(refused(|s| s.vehicles[1].target_speed = f64::NAN), Some("cars"));
    assert_eq!(refused(|s| s.vehicles[1].position[0] = -1e12), Some("cars"));
    assert_eq!(refused(|s| s.vehicles[1].impact = Some([0.0, 1e9])), Some("cars"));
    assert_eq!(refused(|s| s.vehicles[1].driver = Driver::Controller), Some("cars"));
}

#[test]
fn a_drive_that_is_let_in_is_let_in_after_every_further_step() {
    let mut task = start(&HighwayWorldSettings::default(), 0);
    let [ego, wreck, turned, ..] = &mut task.traffic.vehicles[..] else { panic!("four cars") };
    // At the bounds, and on the way outwards.
    for (car, place, heading) in [
        (ego, [-1e9, 1e9], std::f64::consts::PI),
        (wreck, [1e9, -1e9], 0.0),
        (turned, [1e9, 1e9], 1e9),
    ] {
        (car.position, car.speed) = (place, 1e3);
        car.face(heading);
    }
    let wreck = &mut task.traffic.vehicles[1];
    (wreck.crashed, wreck.impact) = (true, Some([1e4, -1e4]));
    if let Driver::Idm(idm) = &mut wreck.driver {
        idm.timer = 1e9;
    }
    for step in 0..50 {
        let mut bytes = Vec::new();
        task.snapshot(&mut bytes);
        task.restore(&bytes).unwrap_or_else(|error| panic!("step {step}: {error}"));
        assert!(task.advance(None).end.is_none(), "step {step}");
    }
}

#[test]
fn every_step_of_a_drive_can_be_restored() {
    for (episode, topic) in [(0, None), (1, None), (2, Some(SLOW_DOWN)), (3, Some(SPEED_UP))] {
        let mut task = start(&HighwayWorldSettings::default(), episode);
        let mut other = start(&HighwayWorldSettings::default(), 99);
        loop {
            let reaction = topic.map(|topic| ReactionStep { topic, first: false });
            let end = task.advance(reaction).end;
            let mut bytes = Vec::new();
            task.snapshot(&mut bytes);
            other.restore(&bytes).unwrap();
            assert_eq!(other.progress, task.progress);
            if end.is_some() {
                break;
            }
        }
    }
}

#[test]
fn the_notifiers_observation_is_a_history_of_entities() {
    let task = HighwayDomain::new(&HighwayWorldSettings::default()).unwrap();
    let mut env =
        NotifierEnv::new(task, &HumanSettings::default(), &NotifierSettings::default()).unwrap();
    let history = env.entity_history().unwrap();
    let attention = history.attention(64, 2);
    assert_eq!((attention.n_frames, attention.n_entities, attention.n_features), (4, 10, 7));
    // Initiate 1, topics 4, k 4, l 4; behind the frames: words spoken and topic of the own utterance.
    assert_eq!((attention.action_dim, env.spec().obs_dim), (13, 4 * (70 + 13) + 5));
    attention.check(env.spec().obs_dim).unwrap();
    let mut observation = vec![0.0; env.spec().obs_dim];
    env.reset(seed(0), &mut observation);
    for frame in observation.chunks_exact(attention.frame_dim()).take(4) {
        assert_eq!(frame[0], 1.0);
    }
}

#[test]
fn an_unknown_topic_is_named() {
    let mut settings = HighwayTaskSettings::default();
    settings.notifier.topics = Some(vec!["overtake".to_owned()]);
    let expected = "`notifier.topics` is [\"overtake\"]; allowed: at least one of slow_down, speed_up, \
                    merge_left, merge_right, none twice";
    assert_eq!(settings.build().unwrap_err().to_string(), expected);
}

/// The number of a step's metric after a whole drive on the right lane of an empty road.
fn driven(change: impl FnOnce(&mut HighwayWorldSettings), topic: Option<usize>) -> HighwayDomain {
    let mut task = on_the_right(|s| {
        s.absorb_until = 0;
        change(s);
    });
    let reaction = topic.map(|topic| ReactionStep { topic, first: false });
    while task.advance(reaction).end.is_none() {}
    task
}

#[test]
fn a_success_arrives_in_time() {
    // 960 m at 30 m/s are 32 s or 96 steps; the goal is passed in step 97.
    let time = |s: &mut HighwayWorldSettings, within| s.arrive_within = within;
    let task = driven(|s| time(s, 97.0 / 96.0), None);
    assert!(task.success() && metric(&task, "in_time") == 1.0);
    assert!((metric(&task, "drive_time") - 97.0 / 3.0).abs() < 1e-4);
    let late = driven(|s| time(s, 96.5 / 96.0), None);
    assert_eq!([late.has_arrived(), late.is_in_time(), late.success()], [true, false, false]);
    assert_eq!([metric(&late, "arrived"), metric(&late, "in_time")], [1.0, 0.0]);
    // At the least speed, 15 m/s, the way takes twice as long.
    assert!(driven(|_| {}, Some(SLOW_DOWN)).success());
    assert!(!driven(|s| time(s, 1.25), Some(SLOW_DOWN)).success());
    // What comes after the arrival takes no time.
    let mut task = on_the_right(|s| time(s, 1.25));
    assert_eq!((drive(&mut task).2, task.success()), (200, true));
}

#[test]
fn a_success_brakes_gently() {
    let bound = |s: &mut HighwayWorldSettings| s.hardest_braking = 4.5;
    let hard = driven(bound, Some(SLOW_DOWN));
    assert!(metric(&hard, "hardest_braking") > 5.9);
    assert_eq!([hard.has_arrived(), hard.is_comfortable(), hard.success()], [true, false, false]);
    assert_eq!([metric(&hard, "in_time"), metric(&hard, "comfortable")], [1.0, 0.0]);
    let gentle = driven(|s| (bound(s), s.ego.braking = 3.0).1, Some(SLOW_DOWN));
    assert!((metric(&gentle, "hardest_braking") - 3.0).abs() < 1e-3);
    assert!(gentle.success() && metric(&gentle, "comfortable") == 1.0);
}

#[test]
fn a_driver_asked_to_brake_gently_brakes_as_hard_as_needed_for_what_they_see() {
    let mut task = on_the_right(|s| s.ego.braking = 3.0);
    let car = Vehicle::new(task.traffic.network(), [60.0, 4.0], 0.0, 20.0).with_idm(20.0);
    task.traffic.vehicles.push(car);
    react(&mut task, SLOW_DOWN, true);
    assert!(metric(&task, "hardest_braking") > 5.9);
}

#[test]
fn a_violation_of_success_is_charged_when_it_happens() {
    let charged = |change: fn(&mut HighwayWorldSettings)| {
        let mut task = on_the_right(|s| {
            (s.arrive_within, s.hardest_braking) = (1.25, 4.5);
            (s.reward.late, s.reward.hard_braking) = (-2.0, -5.0);
            change(s);
        });
        let mut plain = on_the_right(|_| {});
        let slow = Some(ReactionStep { topic: SLOW_DOWN, first: false });
        let mut at = Vec::new();
        for step in 1..=200 {
            let difference = task.advance(slow).reward - plain.advance(slow).reward;
            if difference.abs() > 1e-9 {
                at.push((step, difference.round()));
            }
        }
        let sums = ["return_late", "return_hard_braking"].map(|name| metric(&task, name));
        (at, sums, task.progress.n_driven)
    };
    // In time is 1.25 times 96 steps; at 15 m/s it takes some 190.
    let (at, sums, n_driven) = charged(|_| {});
    assert!((180..195).contains(&n_driven), "{n_driven}");
    assert_eq!((at[0], at[1], at.last()), ((1, -5.0), (121, -2.0), Some(&(n_driven, -2.0))));
    let n_late = n_driven - 120;
    assert_eq!((at.len() as u32 - 1, sums), (n_late, [-2.0 * n_late as f32, -5.0]));
    let (at, sums, _) = charged(|s| s.hardest_braking = 0.0);
    assert_eq!((at[0].0, sums[1]), (121, 0.0));
    assert_eq!(charged(|s| s.arrive_within = 0.0).0, [(1, -5.0)]);
    assert_eq!(charged(|s| (s.reward.late, s.reward.hard_braking) = (0.0, 0.0)).0, []);
}

#[test]
fn a_car_may_start_beside_the_ego() {
    use crate::task::StartLane;
    for (lane, same) in [(StartLane::Own, true), (StartLane::Other, false)] {
        for episode in 0..20 {
            let task = start(&settings(|s| s.traffic.cars[0].lane = lane), episode);
            let [ego, car] = [0, 1].map(|i| task.traffic.vehicles[i].position[1]);
            assert_eq!(ego == car, same);
        }
    }
    // On a lane that is drawn, as ever, it is written as ever.
    let car = HighwayWorldSettings::default().traffic.cars[0];
    assert_eq!(serde_json::to_string(&car).unwrap(), r#"{"x":90.0,"speed":29.0}"#);
}
