//! The task, alone and through the notifier environment.

use leadtime_proto::EnvId;
use leadtime_sims::Environment as _;
use leadtime_sims::human::SpeechAct;
use leadtime_sims::notifier::NotifierEnv;
use leadtime_sims::scene::{Shape, Tone};
use proptest::prelude::*;

use super::*;
use crate::task::DEMONSTRATION;
use crate::task::topics::DOWN;
use crate::world::{Content, Pose, StartFamily};

const UP: usize = 0;
const LEFT: usize = 2;

fn seed(episode: u64) -> EpisodeSeed {
    EpisodeSeed { run_seed: 11, env_id: EnvId(2), episode }
}

fn settings(change: impl FnOnce(&mut SteakhouseWorldSettings)) -> SteakhouseWorldSettings {
    let mut settings = golden().world;
    settings.start_families = vec![StartFamily::AllPartial];
    change(&mut settings);
    settings
}

fn start(settings: &SteakhouseWorldSettings, episode: u64) -> SteakhouseDomain {
    let mut task = SteakhouseDomain::new(settings).unwrap();
    task.reset(seed(episode));
    task
}

fn cook(task: &mut SteakhouseDomain) -> (Advance, f64) {
    let mut total = 0.0;
    loop {
        let advance = task.advance(None);
        total += advance.reward;
        if advance.end.is_some() {
            return (advance, total);
        }
    }
}

fn go_on(task: &mut SteakhouseDomain, n_steps: u32) {
    for _ in 0..n_steps {
        task.advance(None);
    }
}

fn metric(task: &SteakhouseDomain, name: &str) -> f32 {
    let mut metrics = vec![f32::NAN; task.metric_names().len()];
    task.metrics(&mut metrics);
    metrics[task.metric_names().iter().position(|metric| *metric == name).unwrap()]
}

fn env(
    world: &SteakhouseWorldSettings,
    change: impl FnOnce(&mut HumanSettings),
) -> NotifierEnv<SteakhouseDomain> {
    let mut settings = SteakhouseTaskSettings { world: world.clone(), ..golden() };
    change(&mut settings.human);
    begin(&settings)
}

fn begin(settings: &SteakhouseTaskSettings) -> NotifierEnv<SteakhouseDomain> {
    let mut env = settings.build().unwrap();
    let mut observation = vec![0.0; env.spec().obs_dim];
    env.reset(seed(0), &mut observation);
    env
}

fn message(topic: usize, comprehension: u32, conveyance: u32) -> Message {
    Message { topic, comprehension, conveyance }
}

/// Takes a step with a message, if any; returns the action of the cook, and what for if it is their own.
fn step(
    env: &mut NotifierEnv<SteakhouseDomain>,
    message: Option<Message>,
) -> (Action, Option<Subtask>) {
    let mut observation = vec![0.0; env.spec().obs_dim];
    env.step_with(message.map_or(SpeechAct::Continue, SpeechAct::Start), &mut observation);
    let last = env.domain().last_step.unwrap();
    (last.action, last.subtask)
}

fn belief(env: &NotifierEnv<SteakhouseDomain>) -> &[Content] {
    &env.domain().kitchen.mind.belief.contents
}

/// "Go down, all stations occupied": the paper's demonstration. By t = 2 the cook has already acted on the first words,
/// and at t = 5 knows the stations; words count from 0.
#[test]
fn go_down_all_stations_occupied() {
    let mut env = begin(&demonstration());
    let (first, subtask) = step(&mut env, Some(DEMONSTRATION));
    assert_eq!(subtask, Some(Subtask::FetchMeat), "the cook still follows its own plan: {first:?}");
    let down = Action::Go(Direction::South);
    for t in 1..4 {
        assert_eq!(step(&mut env, None), (down, None), "t = {t}");
        assert_eq!(belief(&env), [Content::Empty; 6]);
    }
    step(&mut env, None);
    assert_eq!(env.domain().kitchen.n_steps, 5);
    assert_eq!(belief(&env), env.domain().kitchen.world.contents());
    assert_eq!(env.domain().kitchen.mind.subtask, None, "the plan is dropped");
    let (_, subtask) = step(&mut env, None);
    assert!(matches!(subtask, Some(Subtask::Chop | Subtask::Wash)), "{subtask:?}");
    assert_eq!(metric(env.domain(), "disclosures"), 1.0);
}

#[test]
fn a_direction_that_is_blocked_only_turns_the_cook_and_ends() {
    let mut task = start(&settings(|_| {}), 0);
    let asked = |topic| Some(ReactionStep { topic, first: true });
    let pose = task.kitchen.world.cook().pose;
    // The island is west of the start tile.
    let advance = task.advance(asked(LEFT));
    assert_eq!(advance.reaction, Some(ReactionStatus::Ended));
    assert_eq!(task.kitchen.world.cook().pose, Pose { facing: Direction::West, ..pose });
    assert_eq!(task.advance(asked(UP)).reaction, Some(ReactionStatus::Followed));
    assert_eq!((metric(&task, "blocked_moves"), metric(&task, "ineffective_actions")), (1.0, 0.0));
    let held = task.kitchen.world.cook().held;
    task.advance(asked(LEFT));
    assert_eq!(task.advance(asked(LEFT)).reaction, Some(ReactionStatus::Ended));
    assert_eq!(task.kitchen.world.cook().held, held);
}

#[test]
fn a_message_discloses_if_it_is_long_enough() {
    let default = SteakhouseWorldSettings::default();
    let world = settings(|s| s.inform_discloses_from = default.inform_discloses_from);
    for (topic, length, discloses) in
        [(DOWN, 4, false), (DOWN, 5, true), (INFORM, 3, false), (INFORM, 4, true)]
    {
        let mut env = env(&world, |_| {});
        step(&mut env, Some(message(topic, 2, length)));
        for _ in 1..length {
            step(&mut env, None);
        }
        let kitchen = &env.domain().kitchen;
        let aware = kitchen.mind.belief.is_aware_of_all(&kitchen.world);
        assert_eq!(aware, discloses, "{topic} {length}");
    }
}

#[test]
fn informing_neither_starts_nor_displaces_a_reaction() {
    let delay = |human: &mut HumanSettings| {
        human.reaction_delay = ReactionDelay::Fixed(6);
        human.interrupt = Interrupt::UntilComprehended;
    };
    let mut env = env(&settings(|_| {}), delay);
    step(&mut env, Some(message(DOWN, 2, 2)));
    step(&mut env, None);
    step(&mut env, Some(message(INFORM, 2, 3)));
    let asked: Vec<u32> = (3..14).filter(|_| step(&mut env, None).1.is_none()).collect();
    // Understood at time 2, due at time 8; it goes on as far as the way is free.
    assert_eq!(asked.first(), Some(&8));
    let it = env.human().tally();
    assert_eq!((it.comprehended, it.followed, it.overwritten, it.unheeded), (2, 2, 0, 0));
}

#[test]
fn a_disclosure_ends_what_the_cook_was_told_to_do() {
    let mut env = env(&settings(|_| {}), |_| {});
    step(&mut env, Some(message(DOWN, 1, 1)));
    assert_eq!(step(&mut env, Some(message(INFORM, 1, 1))).1, None);
    let mut env = self::env(&settings(|s| s.inform_discloses_from = 1), |_| {});
    step(&mut env, Some(message(DOWN, 1, 1)));
    step(&mut env, Some(message(INFORM, 1, 1)));
    assert!(step(&mut env, None).1.is_some());
}

#[test]
fn a_delivery_pays_by_the_deadline_and_less_after_it() {
    let mut aware = start(&settings(|s| s.aware = true), 0);
    let (last, total) = cook(&mut aware);
    assert_eq!((aware.reference_steps(), aware.deadline(), aware.kitchen.n_steps), (33, 41, 33));
    assert!(aware.success());
    assert_eq!(last.end, Some(End::Terminated));
    // Six interactions are needed from this start.
    assert!((total - (20.0 + 0.5 * 6.0 - 0.05 * 33.0)).abs() < 1e-9, "{total}");
    assert_eq!(aware.scene().outcome, "delivered in time");

    let mut unaware = start(&settings(|_| {}), 0);
    let (_, total) = cook(&mut unaware);
    assert_eq!((unaware.kitchen.n_steps, unaware.success()), (54, false));
    assert!((total - (5.0 + 0.5 * 6.0 - 0.05 * 54.0 - 0.1 * 28.0)).abs() < 1e-9, "{total}");
    assert_eq!(
        (metric(&unaware, "redundant_steps"), metric(&unaware, "pointless_pickups")),
        (28.0, 2.0)
    );
    assert_eq!(
        (metric(&unaware, "steps_to_deliver"), metric(&unaware, "excess_steps")),
        (54.0, 21.0)
    );
    assert_eq!(unaware.scene().outcome, "delivered late");
}

#[test]
fn time_runs_out() {
    let mut task = start(&settings(|s| s.max_steps = 70), 0);
    // Somebody makes the cook run in circles.
    let mut last = None;
    for t in 0..70 {
        let topic = if t % 2 == 0 { UP } else { DOWN };
        assert_eq!(last, None);
        last = task.advance(Some(ReactionStep { topic, first: false })).end;
    }
    assert_eq!((last, task.success()), (Some(End::Terminated), false));
    assert_eq!((metric(&task, "dish_delivered"), metric(&task, "steps_to_deliver")), (0.0, 70.0));
    assert_eq!(task.scene().outcome, "out of time");
}

#[test]
fn a_dish_that_cannot_be_delivered_is_refused_at_once() {
    let refused = |change: fn(&mut SteakhouseWorldSettings)| {
        SteakhouseDomain::new(&settings(change)).unwrap_err().to_string()
    };
    assert_eq!(
        refused(|s| s.max_steps = 69),
        "`world.max_steps` is 69; allowed: at least 70 steps: a cook who knows everything needs them"
    );
    let walled = refused(|s| s.layout = "XPBWXXX\nO 1 XSX\nXMDXXXX".to_owned());
    assert_eq!(
        walled,
        "`world.layout` is a kitchen in which row 2, column 6, a serving window (S), cannot be \
         reached from the start; allowed: floor beside it that is joined to the start"
    );
}

#[test]
fn an_observation_shows_truth_and_awareness_between_0_and_1() {
    let world = settings(|s| {
        s.layout = "XPPPPXX\nB     S\nO 1   X\nXMDXXWX".to_owned();
        s.start_families = vec![StartFamily::Unavailable];
    });
    let mut task = start(&world, 0);
    assert_eq!(task.obs_dim(), 13 + 6 * 5 + 2);
    let mut observation = vec![f32::NAN; task.obs_dim()];
    let mut looked_busy = 0;
    for episode in 0..20 {
        task.reset(seed(episode));
        for _ in 0..20 {
            task.observe(&mut observation);
            assert!(observation.iter().all(|value| (0.0..=1.0).contains(value)), "{observation:?}");
            let world = &task.kitchen.world;
            for (slot, content) in world.contents().iter().enumerate() {
                let shown = &observation[13 + 5 * slot..18 + 5 * slot];
                assert_eq!(shown[..3].iter().sum::<f32>(), 1.0);
                let aware = task.kitchen.mind.belief.is_aware(slot, world);
                assert_eq!(shown[4], f32::from(u8::from(aware)));
                if *content == Content::Unavailable {
                    assert_eq!(shown[..4], [0.0, 1.0, 0.0, 0.0]);
                    looked_busy += 1;
                }
            }
            task.advance(None);
        }
    }
    assert!(looked_busy > 100);
    let many = settings(|s| s.layout = "XPPPPPX\nB     S\nO 1   X\nXMDXXWX".to_owned());
    assert_eq!(start(&many, 0).obs_dim(), 13 + 7 * 5 + 2);
}

#[test]
fn starts_depend_on_seed_and_settings_alone() {
    let world = SteakhouseWorldSettings {
        start_families: vec![StartFamily::Random, StartFamily::Unavailable],
        release_steps: [5, 9],
        ..SteakhouseWorldSettings::default()
    };
    let starts = || -> Vec<KitchenStart> {
        let mut task = SteakhouseDomain::new(&world).unwrap();
        let mut draw = |episode| {
            task.reset(seed(episode));
            task.start.clone()
        };
        (0..60).map(&mut draw).collect()
    };
    let drawn = starts();
    assert_eq!(drawn, starts());
    let taken = |start: &&KitchenStart| start.contents.contains(&Content::Unavailable);
    let n_taken = drawn.iter().filter(taken).count();
    assert!((15..45).contains(&n_taken), "{n_taken}");
    let releases: Vec<u32> = drawn.iter().filter_map(|start| start.release_at).collect();
    assert_eq!((releases.iter().min(), releases.iter().max()), (Some(&5), Some(&9)));
    assert!(drawn.iter().any(|start| start.pose != drawn[0].pose));
}

#[test]
fn the_scripted_notifier_informs_at_the_start_and_directs_who_errs() {
    let mut task = start(&settings(|_| {}), 0);
    let words = task.settings.inform_discloses_from;
    assert_eq!(task.heuristic(), Some(message(INFORM, words, words)));
    task.started(message(INFORM, words, words));
    task.advance(None);
    assert_eq!(task.heuristic(), None, "what was said is given time");
    go_on(&mut task, words - 1);
    // Nothing came of it, and the cook still goes for meat; one who knows would go to a board or sink.
    let said = task.heuristic().unwrap();
    assert!(said.topic != INFORM && (said.comprehension, said.conveyance) == (2, 5), "{said:?}");
    task.deliver(message(INFORM, words, words));
    assert_eq!(task.heuristic(), None);
    let empty = start(&settings(|s| s.start_families = vec![StartFamily::Empty]), 0);
    assert_eq!(empty.heuristic(), None, "there is nothing to tell");
}

#[test]
fn a_picture_shows_grid_view_truth_belief_and_cook() {
    let task = start(&settings(|s| s.start_families = vec![StartFamily::Unavailable]), 1);
    let scene = task.scene();
    assert_eq!((scene.view.min, scene.view.max), ([-0.25, -0.5], [9.25, 7.0]));
    assert_eq!(scene.position, [6.5, 3.5]);
    let label = |shape: &Shape| match shape {
        Shape::Label { text, .. } => Some(text.clone()),
        _ => None,
    };
    let labels: Vec<String> = scene.shapes.iter().filter_map(label).collect();
    for text in
        ["grill", "board", "sink", "taken", "thinks empty", "onions", "window", "plan: fetch meat"]
    {
        assert!(labels.iter().any(|label| label == text), "{text} {labels:?}");
    }
    let is =
        |shape: &Shape, wanted| matches!(shape, Shape::Rectangle { tone, .. } if *tone == wanted);
    let count = |wanted| scene.shapes.iter().filter(|shape| is(shape, wanted)).count();
    let n_taken = labels.iter().filter(|label| *label == "taken").count();
    assert_eq!([Tone::Hint, Tone::Mistaken, Tone::Goal].map(count), [6, n_taken, 1]);
}

fn snapshot(task: &SteakhouseDomain) -> Vec<u8> {
    let mut bytes = Vec::new();
    task.snapshot(&mut bytes);
    bytes
}

#[test]
fn a_snapshot_of_another_task_is_refused() {
    let mut task = start(&settings(|_| {}), 0);
    let other = snapshot(&start(&settings(|s| s.layout = "steak_mid_2".to_owned()), 0));
    let error = task.restore(&other).unwrap_err();
    assert!(matches!(error, SnapshotError::Mismatch { what: "kitchen" }), "{error}");
    let mut long = start(&settings(|s| s.max_steps = 1000), 0);
    for _ in 0..101 {
        long.advance(Some(ReactionStep { topic: UP, first: false }));
    }
    let error = task.restore(&snapshot(&long)).unwrap_err();
    assert!(matches!(error, SnapshotError::Mismatch { what: "progress" | "kitchen" }), "{error}");
}

proptest! {
    #[test]
    fn a_damaged_snapshot_is_refused_or_can_be_played_on(at in 0_usize..400, flip in 1_u8..) {
        let mut task = start(&SteakhouseWorldSettings::default(), 3);
        go_on(&mut task, 20);
        let mut bytes = snapshot(&task);
        let at = at % bytes.len();
        bytes[at] ^= flip;
        let mut other = start(&SteakhouseWorldSettings::default(), 4);
        if other.restore(&bytes).is_ok() {
            let mut observation = vec![0.0; other.obs_dim()];
            for _ in 0..100 {
                other.observe(&mut observation);
                prop_assert!(observation.iter().all(|value| value.is_finite()));
                other.heuristic();
                drop(other.scene());
                if other.advance(None).end.is_some() {
                    break;
                }
            }
        }
    }
}
