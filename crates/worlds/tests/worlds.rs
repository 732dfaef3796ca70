//! What holds in every built-in world: it builds, says why it does not, snapshots go on bit for bit and nowhere else.

use leadtime_highway::task::HighwayTaskSettings;
use leadtime_numerics::Pcg64;
use leadtime_proto::{EnvId, Mask, TaskSpec};
use leadtime_sims::env_check::check_environment;
use leadtime_sims::human::{FollowThrough, Interrupt};
use leadtime_sims::{Environment, EpisodeSeed, SnapshotError};
use leadtime_steakhouse::task::SteakhouseTaskSettings;
use leadtime_worlds::builtin;

fn task(domain: &str, settings: &str) -> TaskSpec {
    TaskSpec { domain: domain.to_owned(), settings: settings.to_owned() }
}

fn build(domain: &str) -> Box<dyn Environment> {
    builtin().build(&task(domain, "{}")).expect("the default task can be built")
}

fn refuse(domain: &str, settings: &str) -> String {
    builtin().build(&task(domain, settings)).err().expect("the task is refused").to_string()
}

fn names() -> Vec<String> {
    builtin().names().map(str::to_owned).collect()
}

fn seed(episode: u64) -> EpisodeSeed {
    EpisodeSeed { run_seed: 11, env_id: EnvId(2), episode }
}

/// Draws an action that is possible whatever the mask.
fn draw(env: &dyn Environment, generator: &mut Pcg64) -> Vec<u8> {
    let actions = &env.spec().actions;
    loop {
        let action: Vec<u8> =
            actions.heads.iter().map(|head| generator.below(head.n_choices) as u8).collect();
        if actions.allows(Mask::ALL, &action) {
            return action;
        }
    }
}

/// Plays up to `n` random steps; returns the observation after them, and whether the episode goes on.
fn play(env: &mut dyn Environment, n: usize, generator: &mut Pcg64) -> (Vec<f32>, bool) {
    let mut observation = vec![0.0; env.spec().obs_dim];
    env.reset(seed(generator.below(100) as u64), &mut observation);
    let goes_on = (0..n).all(|_| {
        let action = draw(env, generator);
        env.step(&action, &mut observation).end.is_none()
    });
    (observation, goes_on)
}

fn snapshot(env: &dyn Environment) -> Vec<u8> {
    let mut bytes = Vec::new();
    env.snapshot(&mut bytes);
    bytes
}

#[test]
fn every_task_has_a_default() {
    assert_eq!(names(), ["cartpole", "cue_recall", "highway", "lander", "pilot", "steakhouse"]);
    for name in names() {
        assert!(build(&name).spec().obs_dim > 0, "{name}");
    }
}

#[test]
fn what_cannot_be_built_says_why() {
    let known = "there is no domain `lunar`; known: cartpole, cue_recall, highway, lander, pilot, steakhouse";
    let expect = |domain, settings: &str, expected| {
        let text = refuse(domain, settings);
        assert!(text.contains(expected), "{text}");
    };
    expect("lunar", "{}", known);
    let settings = r#"{"world": {"max_step": 5}}"#;
    expect("cartpole", settings, "unknown field `max_step`, expected `max_steps`");
    expect("cartpole", r#"{"human": {}}"#, "unknown field `human`, expected `world`");
    let settings = r#"{"world": {"max_steps": 0}}"#;
    expect("cartpole", settings, "`world.max_steps` is 0; allowed: 1 to 100000 steps");
    let settings = r#"{"notifier": {"topics": []}}"#;
    expect("lander", settings, "`notifier.topics` is []; allowed: at least one of ascend");
    let settings = r#"{"human": {"reaction_delay": {"fixed": "two"}}}"#;
    expect("lander", settings, "string \"two\", expected u32");
    expect("highway", r#"{"human": {"delay": 2}}"#, "unknown field `delay`, expected");
    expect("highway", r#"{"world": {"roads": 2}}"#, "unknown field `roads`");
    let settings = r#"{"world": {"road": {"lanes": [{"from": "a"}]}}}"#;
    expect("highway", settings, "missing field `to`");
    let words: Vec<u32> = (1..40).collect();
    let settings = format!(r#"{{"notifier": {{"words": {words:?}}}}}"#);
    expect("lander", &settings, "an action has ");
}

#[test]
fn settings_that_are_not_given_are_those_of_that_world() {
    let text = r#"{"human": {"interrupt": "finish"}, "notifier": {"history": 2}}"#;
    let highway: HighwayTaskSettings = serde_json::from_str(text).unwrap();
    let steakhouse: SteakhouseTaskSettings = serde_json::from_str(text).unwrap();
    for (human, notifier, follow_through, cost) in [
        (&highway.human, &highway.notifier, FollowThrough::TwiceLengthMinusTwo, 0.3),
        (&steakhouse.human, &steakhouse.notifier, FollowThrough::Fixed(3), 0.2),
    ] {
        assert_eq!((human.interrupt, human.follow_through), (Interrupt::Finish, follow_through));
        assert_eq!((notifier.history, notifier.initiation_cost), (2, cost));
    }
    let text = serde_json::to_string(&highway).unwrap();
    assert_eq!(serde_json::from_str::<HighwayTaskSettings>(&text).unwrap(), highway);
}

#[test]
fn every_task_is_as_runs_need_it() {
    let varied =
        r#"{"world": {"zone_jitter": [0.05, 0.05], "zone_ends_episode": false, "wind": true}}"#;
    let mut tasks: Vec<_> = names().iter().map(|name| task(name, "{}")).collect();
    tasks.push(task("lander", varied));
    for task in tasks {
        let report = check_environment(|| builtin().build(&task)).unwrap();
        assert!(report.defects.is_empty(), "{task:?}: {:?}", report.defects);
        assert_eq!(report.rewards.notice(), None, "{task:?}");
        assert_eq!((report.n_episodes, report.n_restored), (12, 48), "{task:?}");
    }
}

#[test]
fn every_number_is_described_and_stays_in_its_range() {
    let zones = task("lander", r#"{"world": {"zone_jitter": [0.1, 0.1]}}"#);
    let stops = r#"{"human": {"can_stop": true}, "notifier": {"notification": "topic_only", "history": 1}}"#;
    let mut tasks: Vec<_> = names().iter().map(|name| task(name, "{}")).collect();
    tasks.extend([zones, task("steakhouse", stops)]);
    let mut generator = Pcg64::seed_from_u64(5);
    for task in tasks {
        let mut env = builtin().build(&task).unwrap();
        let description = env.describe();
        let quantities = description.observation.quantities();
        assert_eq!(quantities.len(), env.spec().obs_dim, "{task:?}");
        let mut names: Vec<_> = quantities.iter().map(|it| &it.name).collect();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), quantities.len(), "{task:?}: a name stands twice");
        let heads = env.spec().actions.heads.iter().map(|head| (&head.name, head.n_choices));
        let described = description.actions.iter().map(|head| (&head.name, head.choices.len()));
        assert!(heads.eq(described), "{task:?}");
        assert!(!description.rewards.is_empty(), "{task:?}");
        let mut observation = vec![0.0; quantities.len()];
        for episode in 0..20 {
            env.reset(seed(episode), &mut observation);
            for _ in 0..300 {
                for (quantity, x) in quantities.iter().zip(&observation) {
                    let [low, high] = quantity.range;
                    assert!((low..=high).contains(x), "{task:?}: {} is {x}", quantity.name);
                }
                let action = draw(env.as_ref(), &mut generator);
                if env.step(&action, &mut observation).end.is_some() {
                    break;
                }
            }
        }
    }
}

#[test]
fn what_a_reaction_pays_is_described_where_it_is_paid() {
    let keys = |settings| -> Vec<String> {
        let env = builtin().build(&task("lander", settings)).unwrap();
        env.describe().rewards.into_iter().map(|term| term.key).collect()
    };
    let key = "human.reaction_reward".to_owned();
    assert!(keys(r#"{"human": {"reaction_reward": "once"}}"#).contains(&key));
    assert!(!keys("{}").contains(&key));
}

#[test]
fn a_snapshot_is_restored_by_its_own_task_and_with_its_tag_only() {
    let mut generator = Pcg64::seed_from_u64(3);
    let begun = |name: String| {
        let mut env = build(&name);
        play(env.as_mut(), 2, &mut generator);
        (name, snapshot(env.as_ref()))
    };
    let snapshots: Vec<_> = names().into_iter().map(begun).collect();
    for (own, bytes) in &snapshots {
        let mut env = build(own);
        let mut observation = vec![0.0; env.spec().obs_dim];
        for (other, theirs) in &snapshots {
            let restored = env.restore(theirs, &mut observation);
            let refused = matches!(restored, Err(SnapshotError::OtherTask));
            assert_eq!(refused, own != other, "{other} into {own}: {restored:?}");
        }
        let tag = bytes.len().min(16);
        for cut in (0..tag).chain([bytes.len() - 1]) {
            assert!(env.restore(&bytes[..cut], &mut observation).is_err(), "{own}, {cut} bytes");
        }
        for bit in 0..8 * tag {
            let mut flipped = bytes.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            assert!(env.restore(&flipped, &mut observation).is_err(), "{own}, bit {bit}");
        }
        // What was written before snapshots had a tag.
        let error = env.restore(&bytes[tag..], &mut observation).unwrap_err();
        assert!(matches!(error, SnapshotError::OtherRelease), "{own}: {error}");
        env.restore(bytes, &mut observation).unwrap();
    }
}

#[test]
fn a_highway_policy_is_evaluated_to_its_arrival() {
    assert_eq!(builtin().evaluation_world("highway"), "absorb_until = 0");
    assert_eq!(builtin().evaluation_world("lander"), "zone_ends_episode = false");
    assert_eq!(builtin().evaluation_world("cartpole"), "");
    let drive = |episode, settings: &str| {
        let mut env = builtin().build(&task("highway", settings)).unwrap();
        let mut observation = vec![0.0; env.spec().obs_dim];
        env.reset(seed(episode), &mut observation);
        let length =
            (1..1_000).find(|_| env.step(&[0; 4], &mut observation).end.is_some()).unwrap();
        let mut metrics = vec![0.0; env.spec().metrics.len()];
        env.metrics(&mut metrics);
        (length, metrics[0] == 1.0)
    };
    let arrived = (0..50).find(|&episode| drive(episode, "{}").1).unwrap();
    assert_eq!(drive(arrived, "{}").0, 200);
    let (length, success) = drive(arrived, r#"{"world": {"absorb_until": 0}}"#);
    assert!(success && length < 150, "{length}");
}
