//! An episode made by hand, for tests of the drawing: a gliding box, zones, and messages at given steps. And one of the
//! lander, in which is said what a test wants.

use leadtime_lander::task::LanderTaskSettings;
use leadtime_sims::human::{HumanSettings, SpeechAct};
use leadtime_sims::{
    Environment as _, EpisodeSeed, Gauge, Listener, Message, Scene, Shape, Tone, View, Word,
};

use super::Playthrough;

const DELAY: usize = 2;

/// Makes `n` scenes; a message is (step at which it starts, topic, k, l). It is understood unless the next one
/// starts before, waits two steps, and is followed for l steps.
pub(crate) fn scenes(n: usize, messages: &[(usize, usize, usize, usize)]) -> Vec<Scene> {
    (0..n).map(|i| scene(i, n, messages)).collect()
}

pub(crate) fn playthrough() -> Playthrough {
    let messages =
        [(6, 2, 2, 4), (18, 2, 2, 2), (24, 2, 3, 5), (44, 0, 2, 3), (46, 1, 5, 5), (70, 3, 2, 2)];
    let mut scenes = scenes(110, &messages);
    "landed <safely>".clone_into(&mut scenes[109].outcome);
    let player = "trained & tested".to_owned();
    Playthrough { player, seed: 7, index: 3, scenes, total_reward: 215.4, success: Some(true) }
}

/// Says a message that asks to ascend.
pub(crate) fn ascend(comprehension: u32, conveyance: u32) -> SpeechAct {
    SpeechAct::Start(Message { topic: 0, comprehension, conveyance })
}

/// Plays the lander's first steps, with a listener who is changed, and with one of the acts in each.
pub(crate) fn lander(change: impl FnOnce(&mut HumanSettings), acts: &[SpeechAct]) -> Vec<Scene> {
    let mut settings = LanderTaskSettings::default();
    change(&mut settings.human);
    let mut env = settings.build().unwrap();
    let mut observation = vec![0.0; env.spec().obs_dim];
    env.reset(EpisodeSeed::default(), &mut observation);
    let mut scenes: Vec<_> = env.scene().into_iter().collect();
    for act in acts {
        env.step_with(*act, &mut observation);
        scenes.extend(env.scene());
    }
    scenes
}

fn scene(i: usize, n: usize, messages: &[(usize, usize, usize, usize)]) -> Scene {
    let mut listener = Listener {
        topics: vec!["ascend", "shift_left", "shift_right", "descend"],
        ..Listener::default()
    };
    for (m, &(start, topic, k, l)) in messages.iter().enumerate() {
        let cut = messages.get(m + 1).map_or(usize::MAX, |next| next.0);
        if i > start && i <= start + l && i <= cut {
            listener.word = Some(Word {
                topic,
                comprehension: k as u32,
                conveyance: l as u32,
                needed: k as u32,
                heard: (i - start) as u32,
                started: i == start + 1,
            });
        }
        let understood = start + k;
        if understood > cut {
            continue;
        }
        let reacts = understood + DELAY;
        if (understood..=reacts).contains(&i) {
            listener.pending = Some(topic);
        } else if (reacts + 1..=reacts + l).contains(&i) {
            listener.reacting = Some(topic);
        }
    }
    let t = i as f64 / (n.max(2) - 1) as f64;
    let at = [0.55 * (4.2 * t).sin() * (1.0 - t) + 0.02, 1.4 * (1.0 - t) * (1.0 - 0.25 * t)];
    Scene {
        view: View { min: [-1.0, -0.25], max: [1.0, 1.75] },
        shapes: shapes(at),
        position: at,
        gauge: Gauge { label: "height", value: at[1] },
        others: vec![[at[0], 0.5 * at[1]]],
        listener,
        facts: vec!["zone_ahead", "zone_near"],
        outcome: String::new(),
    }
}

fn shapes(at: [f64; 2]) -> Vec<Shape> {
    let zone = |min, max| Shape::Rectangle { min, max, tone: Tone::Danger };
    let ground = [[-1.0, 0.15], [-0.5, 0.05], [-0.2, 0.0], [0.2, 0.0], [0.6, 0.2], [1.0, 0.1]];
    let soil = [&ground[..], &[[1.0, -0.25], [-1.0, -0.25]]].concat();
    let body = [[-0.05, 0.0], [0.05, 0.0], [0.03, 0.08], [-0.03, 0.08]];
    let body = body.map(|[x, y]| [at[0] + x, at[1] + y]).to_vec();
    vec![
        Shape::Polygon { points: soil, tone: Tone::Ground },
        Shape::Line { points: vec![[-0.2, 0.0], [0.2, 0.0]], tone: Tone::Goal },
        zone([-1.5, 0.95], [-0.4, 1.1]),
        zone([-0.3, 0.5], [0.3, 0.65]),
        zone([0.3, 0.4], [1.5, 0.65]),
        Shape::Label { at: [-0.7, 1.02], text: "top-left".to_owned() },
        Shape::Polygon { points: body, tone: Tone::Own },
    ]
}
