//! A notifier without its world sees and may choose what the same notifier does in training: bit for bit, in every domain.

use leadtime_numerics::{Pcg64, Purpose, stream};
use leadtime_proto::{ActionSpec, EnvId, Mask, TaskSpec};
use leadtime_sims::notifier::Session;
use leadtime_sims::{Environment, EpisodeSeed};

const DOMAINS: [&str; 3] = ["lander", "highway", "steakhouse"];
const N_STEPS: usize = 1_000;
/// Listeners whose rules of speech differ.
const LISTENERS: [&str; 7] = [
    "{}",
    r#"{"human": {"blocked_initiation": "mask"}}"#,
    r#"{"human": {"blocked_initiation": "mask", "interrupt": "finish", "can_stop": true}}"#,
    r#"{"human": {"interrupt": "replace", "can_stop": true}, "notifier": {"history": 1}}"#,
    r#"{"human": {"comprehension": "immediate", "occupies": false}}"#,
    r#"{"human": {"words_from": 0, "pending": "queue"}, "notifier": {"observe_utterance": false}}"#,
    r#"{"human": {"blocked_initiation": "mask"}, "notifier": {"notification": "complete_utterance", "k_max": 3}}"#,
];

/// Draws an action among those that are offered; speaks in every fourth step that offers it.
fn draw(spec: &ActionSpec, mask: Mask, generator: &mut Pcg64) -> Vec<u8> {
    loop {
        let choice = |n: usize| generator.below(n) as u8;
        let mut action: Vec<u8> =
            spec.heads.iter().map(|head| head.n_choices).map(choice).collect();
        if generator.below(4) > 0 {
            action[0] = 0;
        }
        if spec.allows(mask, &action) {
            return action;
        }
    }
}

/// Writes what the world shows now.
fn observed(env: &dyn Environment) -> Vec<f32> {
    let task = env.scriptable().expect("messages are sent");
    let mut now = vec![0.0; task.quantities().len()];
    task.write_quantities(&mut now, &mut vec![0.0; task.quantities().len()]);
    now.truncate(task.n_observed());
    now
}

fn bits(row: &[f32]) -> Vec<u32> {
    row.iter().map(|value| value.to_bits()).collect()
}

/// Plays both for so many steps, whatever episodes that takes; returns how often something was started.
fn compare(domain: &str, settings: &str) -> usize {
    let task = TaskSpec { domain: domain.to_owned(), settings: settings.to_owned() };
    let mut env = leadtime_worlds::builtin().build(&task).expect("the task can be built");
    let spec = env.spec().clone();
    let mut session: Session = env.session().expect("a notifier's task");
    let (mut row, mut own) = (vec![0.0; spec.obs_dim], vec![f32::NAN; spec.obs_dim]);
    assert_eq!(session.row_dim(), spec.obs_dim, "{domain}");
    let mut draws = [0; 2].map(|_| stream(5, Purpose::Act, 0, 0));
    let mut n_started = 0;
    let begin = |env: &mut dyn Environment, session: &mut Session, row: &mut [f32], episode| {
        env.reset(EpisodeSeed { run_seed: 3, env_id: EnvId(0), episode }, row);
        let seen = observed(env);
        session.begin(|observation| observation.copy_from_slice(&seen));
    };
    let mut episode = 0;
    begin(env.as_mut(), &mut session, &mut row, episode);
    for step in 0..N_STEPS {
        let place = format!("{domain}, {settings}, step {step}");
        session.write_row(&mut own);
        assert_eq!(bits(&own), bits(&row), "{place}");
        assert_eq!(session.mask(), env.mask(), "{place}");
        let action = draw(&spec.actions, env.mask(), &mut draws[0]);
        let decided = draw(&spec.actions, session.mask(), &mut draws[1]);
        assert_eq!(decided, action, "{place}");
        let act = session.speech_act(&decided);
        let initiation = session.initiation_of(act);
        n_started += usize::from(session.carry_out(act, initiation).is_some());
        let outcome = env.step(&action, &mut row);
        session.hear_word();
        let seen = observed(env.as_ref());
        session.observe(|observation| observation.copy_from_slice(&seen));
        if outcome.end.is_some() {
            session.write_row(&mut own);
            assert_eq!(bits(&own), bits(&row), "{place}");
            episode += 1;
            begin(env.as_mut(), &mut session, &mut row, episode);
        }
    }
    n_started
}

#[test]
fn a_notifier_without_its_world_sees_and_decides_the_same_for_a_thousand_steps() {
    for domain in DOMAINS {
        for settings in LISTENERS {
            let n_started = compare(domain, settings);
            assert!(n_started > 30, "{domain}, {settings}: {n_started} messages");
        }
    }
}
