//! A notifier over a world small enough to compute by hand: a walker on a line.

use leadtime_proto::EnvId;
use proptest::prelude::*;
use proptest::sample::select;

use super::*;
use crate::environment::End;
use crate::human::{FollowThroughEnd, Informativeness, Interrupt, ReactionDelay, ReactionReward};
use crate::notifier::NotificationType::{CompleteUtterance, IncrementallyActionable, TopicOnly};
use crate::{Advance, Delivery, Message, ReactionStatus, ReactionStep};

const LIMIT: u32 = 40;
/// Beyond this place there is a wall to the right.
const WALL: i64 = 8;

/// Walks right by itself; `back` makes it walk left, `hold` makes it stay; a wall ends a reaction.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Walker {
    place: i64,
    n_steps: u32,
    reactions_over: u32,
    delivered: u32,
}

impl Domain for Walker {
    fn topics(&self) -> &[&'static str] {
        &["back", "hold"]
    }
    fn obs_dim(&self) -> usize {
        1
    }
    fn reset(&mut self, seed: EpisodeSeed) {
        *self = Self { place: seed.stream(Purpose::World).integers(0, 3), ..Self::default() };
    }
    fn observe(&self, out: &mut [f32]) {
        out[0] = self.place as f32;
    }
    fn advance(&mut self, reaction: Option<ReactionStep>) -> Advance {
        self.n_steps += 1;
        let (status, change) = match reaction {
            None => (None, 1),
            Some(ReactionStep { topic: 0, .. }) if self.place == 0 => {
                (Some(ReactionStatus::Ended), 0)
            }
            Some(ReactionStep { topic: 0, .. }) => (Some(ReactionStatus::Followed), -1),
            Some(_) if self.place >= WALL => (Some(ReactionStatus::Refused), 1),
            Some(_) => (Some(ReactionStatus::Followed), 0),
        };
        self.place += change;
        let end = (self.n_steps >= LIMIT).then_some(End::Truncated);
        Advance { reward: self.place as f64, reaction: status, end }
    }
    fn reaction_over(&mut self) {
        self.reactions_over += 1;
    }
    fn deliver(&mut self, message: Message) -> Delivery {
        self.delivered += 1;
        Delivery { cancels_reaction: message.conveyance == 5 }
    }
    fn heuristic(&self) -> Option<Message> {
        (self.place > 4).then_some(Message { topic: 0, comprehension: 2, conveyance: 3 })
    }
    fn success(&self) -> bool {
        self.place < WALL
    }
    fn metric_names(&self) -> &'static [&'static str] {
        &["reactions_over", "delivered_to_walker"]
    }
    fn metrics(&self, out: &mut [f32]) {
        out.copy_from_slice(&[self.reactions_over as f32, self.delivered as f32]);
    }
    fn snapshot(&self, out: &mut Vec<u8>) {
        write_snapshot(self, out);
    }
    fn restore(&mut self, snapshot: &[u8]) -> Result<(), SnapshotError> {
        *self = read_snapshot(snapshot)?;
        Ok(())
    }
    fn scene(&self) -> Scene {
        Scene::default()
    }
}

const SILENT: [u8; 4] = [0; 4];
const SEED: EpisodeSeed = EpisodeSeed { run_seed: 3, env_id: EnvId(0), episode: 0 };

fn env(human: &HumanSettings, notifier: &NotifierSettings) -> NotifierEnv<Walker> {
    NotifierEnv::new(Walker::default(), human, notifier).unwrap()
}

/// A listener and a notifier as by default, but without a reaction delay.
fn undelayed_env() -> NotifierEnv<Walker> {
    let human = HumanSettings { reaction_delay: ReactionDelay::Fixed(0), ..Default::default() };
    env(&human, &NotifierSettings::default())
}

fn default_env() -> NotifierEnv<Walker> {
    env(&HumanSettings::default(), &NotifierSettings::default())
}

/// One action, and then silence.
fn only<const N: usize>(action: [u8; 4]) -> [[u8; 4]; N] {
    std::array::from_fn(|t| if t == 0 { action } else { SILENT })
}

fn reset(env: &mut NotifierEnv<Walker>) -> Vec<f32> {
    let mut observation = vec![f32::NAN; env.spec().obs_dim];
    env.reset(SEED, &mut observation);
    observation
}

/// Plays actions from a place; returns the places after each step and the rewards.
fn play(env: &mut NotifierEnv<Walker>, from: i64, actions: &[[u8; 4]]) -> (Vec<i64>, Vec<f32>) {
    let mut observation = reset(env);
    env.domain.place = from;
    let mut step = |action: &[u8; 4]| {
        let outcome = env.step(action, &mut observation);
        (env.domain.place, outcome.reward)
    };
    actions.iter().map(&mut step).unzip()
}

fn snapshot(env: &NotifierEnv<Walker>) -> Vec<u8> {
    let mut bytes = Vec::new();
    env.snapshot(&mut bytes);
    bytes
}

fn metric(env: &NotifierEnv<Walker>, name: &str) -> f32 {
    let mut metrics = vec![f32::NAN; env.spec().metrics.len()];
    env.metrics(&mut metrics);
    metrics[env.spec().metrics.iter().position(|metric| metric == name).unwrap()]
}

#[test]
fn a_message_changes_the_world_k_plus_delay_later_and_costs_once() {
    // "hold", k = 2, l = 3: comprehended at 2, acted upon in steps 4, 5 and 6.
    let mut env = default_env();
    let (places, rewards) = play(&mut env, 2, &only::<9>([1, 1, 0, 1]));
    assert_eq!(places, [3, 4, 5, 6, 6, 6, 6, 7, 8]);
    assert_eq!(rewards, [2.0, 4.0, 5.0, 6.0, 6.0, 6.0, 6.0, 7.0, 8.0]);
    assert_eq!((metric(&env, "followed"), metric(&env, "reactions_over")), (1.0, 1.0));
    assert_eq!((metric(&env, "mean_k"), metric(&env, "mean_l")), (2.0, 3.0));
    assert_eq!(metric(&env, "notifications_per_step"), 1.0 / 9.0);
    assert_eq!(metric(&env, "first_notification"), 1.0);
    play(&mut env, 2, &[SILENT, SILENT]);
    assert_eq!(metric(&env, "first_notification"), 0.0);
    play(&mut env, 2, &[SILENT, SILENT, [1, 0, 0, 0], SILENT, SILENT, SILENT, [1, 0, 0, 0]]);
    assert_eq!(metric(&env, "first_notification"), 3.0);
}

#[test]
fn a_world_that_ends_a_reaction_gets_its_listener_back_and_so_does_a_delivery_that_discloses() {
    let (mut env, actions) = (undelayed_env(), only::<9>([1, 0, 0, 2]));
    // "back" from 4 for four steps, but the wall at 0 is met only if it takes longer: 4, then 3, 2, 1, 0.
    assert_eq!(play(&mut env, 2, &actions).0, [3, 4, 3, 2, 1, 0, 1, 2, 3]);
    // 1, 2, then back to 0 in two steps; the third is blocked, which ends the reaction.
    assert_eq!(play(&mut env, 0, &actions).0, [1, 2, 1, 0, 0, 1, 2, 3, 4]);
    // "hold", k = 2, l = 5 would hold in steps 2..=6; the fifth word, at time 5, cancels what is left.
    assert_eq!(play(&mut env, 2, &only::<8>([1, 1, 0, 3])).0, [3, 4, 4, 4, 4, 5, 6, 7]);
    assert_eq!(metric(&env, "delivered_to_walker"), 1.0);
}

#[test]
fn ignored_initiations_are_free_or_charged_as_set() {
    let rules = [(BlockedInitiation::IgnoreFree, 0.0), (BlockedInitiation::IgnoreCharged, 1.5)];
    for (blocked_initiation, cost) in rules {
        let human = HumanSettings { blocked_initiation, ..Default::default() };
        let notifier = NotifierSettings { initiation_cost: 1.5, ..Default::default() };
        let mut env = env(&human, &notifier);
        let (_, rewards) = play(&mut env, 2, &[[1, 1, 2, 2], [1, 0, 0, 0], SILENT]);
        assert_eq!(rewards, [1.5, 4.0 - cost, 5.0]);
        assert_eq!(metric(&env, "notifications"), 1.0);
        assert_eq!(metric(&env, "ignored_initiations"), 1.0);
    }
}

#[test]
fn the_reaction_reward_joins_the_domains() {
    let human = HumanSettings { reaction_reward: ReactionReward::Once, ..Default::default() };
    let mut env = env(&human, &NotifierSettings::default());
    // "hold" of four words: R_react = 4 - 2 in step 4, where the walker stands at 6.
    let (_, rewards) = play(&mut env, 2, &only::<8>([1, 1, 0, 2]));
    assert_eq!(rewards, [2.0, 4.0, 5.0, 6.0, 8.0, 6.0, 6.0, 6.0]);
}

#[test]
fn a_blocked_start_is_masked_where_masks_are_asked_for() {
    let (blocked_initiation, interrupt) = (BlockedInitiation::Mask, Interrupt::Finish);
    let human =
        HumanSettings { blocked_initiation, interrupt, can_stop: true, ..Default::default() };
    let mut env = env(&human, &NotifierSettings::default());
    let mut observation = reset(&mut env);
    let offered = |env: &NotifierEnv<Walker>| {
        [0, 1, 2].map(|choice| env.spec().actions.allows(env.mask(), &[choice, 0, 0, 0]))
    };
    assert_eq!(offered(&env), [true, true, false]);
    env.step(&[1, 0, 0, 1], &mut observation);
    assert_eq!(offered(&env), [true, false, true]);
    env.step(&[2, 0, 0, 0], &mut observation);
    assert_eq!(offered(&env), [true, true, false]);
    assert_eq!(metric(&env, "preempted"), 1.0);
}

#[test]
fn the_observation_is_the_history_and_the_own_utterance() {
    let notifier = NotifierSettings { history: 2, ..Default::default() };
    let mut env = env(&HumanSettings::default(), &notifier);
    let mut observation = reset(&mut env);
    let start = env.domain.place as f32;
    let none = [0.0_f32; 11];
    let expect = |[(first, then), (second, last)]: [(f32, [f32; 11]); 2], status: [f32; 3]| {
        [&[first][..], &then, &[second], &last, &status].concat()
    };
    assert_eq!(observation, expect([(start, none), (start, none)], [0.0; 3]));
    env.step(&[1, 1, 0, 2], &mut observation);
    let said = [1., 0., 1., 1., 0., 0., 0., 0., 0., 1., 0.];
    assert_eq!(observation, expect([(start, none), (start + 1.0, said)], [0.25, 0.0, 1.0]));
    // A blocked start leaves no trace in the history.
    env.step(&[1, 0, 0, 0], &mut observation);
    let pairs = [(start + 1.0, said), (start + 2.0, none)];
    assert_eq!(observation, expect(pairs, [0.5, 0.0, 1.0]));
    let bare = NotifierSettings { observe_utterance: false, ..notifier };
    assert_eq!(self::env(&HumanSettings::default(), &bare).spec().obs_dim, 24);
}

#[test]
fn a_policy_cannot_tell_from_its_first_view_how_fast_the_listener_understands() {
    let first = |human: &HumanSettings| {
        let mut env = env(human, &NotifierSettings::default());
        let mut observation = reset(&mut env);
        env.step(&[1, 1, 0, 3], &mut observation);
        observation[observation.len() - 3..].to_vec()
    };
    assert_eq!(first(&HumanSettings::default()), first(&HumanSettings::delay_free()));
}

#[test]
fn topics_can_be_restricted() {
    let topics = Some(vec!["hold".to_owned()]);
    let notifier = NotifierSettings { topics, ..Default::default() };
    let mut env = env(&HumanSettings::delay_free(), &notifier);
    assert_eq!(env.spec().actions.heads[1].n_choices, 1);
    assert_eq!(play(&mut env, 2, &only::<3>([1, 0, 0, 0])).0, [2, 2, 3]);
}

#[test]
fn a_listener_whom_no_message_moves_is_refused() {
    let made = |human: &HumanSettings, notification| {
        let notifier = NotifierSettings { notification, ..Default::default() };
        let made = NotifierEnv::new(Walker::default(), human, &notifier);
        made.map(drop).map_err(|error| error.to_string())
    };
    let tail = HumanSettings { informativeness: Informativeness::Tail, ..HumanSettings::default() };
    for notification in [TopicOnly, CompleteUtterance] {
        let error = made(&tail, notification).unwrap_err();
        let says = "`human.follow_through` is 0 steps for every message that asks for";
        assert!(error.starts_with(says), "{error}");
    }
    made(&tail, IncrementallyActionable).unwrap();
    let inclusive = HumanSettings { follow_through_end: FollowThroughEnd::Inclusive, ..tail };
    made(&inclusive, CompleteUtterance).unwrap();
    let weightless = HumanSettings { informativeness_weight: 0.0, ..HumanSettings::default() };
    made(&weightless, IncrementallyActionable).unwrap_err();
}

#[test]
fn baselines_speak_or_keep_silent() {
    let mut env = default_env();
    reset(&mut env);
    env.domain.place = 6;
    let mut action = [9; 4];
    assert!(env.baseline_action("unaided", &mut action));
    assert_eq!(action, SILENT);
    assert!(env.baseline_action("heuristic", &mut action));
    assert_eq!(action, [1, 0, 0, 1]);
    let mut observation = vec![0.0; env.spec().obs_dim];
    env.step(&action, &mut observation);
    env.baseline_action("heuristic", &mut action);
    assert_eq!(action, SILENT, "it waits until it is understood");
    assert!(!env.baseline_action("oracle", &mut action));
    assert_eq!(env.baselines(), ["unaided", "heuristic"], "there is nothing to inform about");
}

#[test]
fn a_scene_shows_speech_and_reaction() {
    let mut env = default_env();
    play(&mut env, 2, &only::<3>([1, 1, 0, 3]));
    let listener = env.scene().unwrap().listener;
    assert_eq!(listener.word.map(|word| (word.topic, word.heard)), Some((1, 3)));
    assert_eq!((listener.pending, listener.reacting), (Some(1), None));
}

#[test]
fn the_word_of_every_step_is_noted_and_no_other() {
    // "hold", k = 2, l = 3, heard to its end, and once more, broken off after two words.
    let (say, stop) = ([1, 1, 0, 1], [2, 0, 0, 0]);
    let human = HumanSettings { can_stop: true, ..Default::default() };
    let mut env = env(&human, &NotifierSettings::default());
    let mut observation = reset(&mut env);
    let heard = [say, SILENT, SILENT, SILENT, say, SILENT, stop, SILENT].map(|action| {
        env.step(&action, &mut observation);
        let listener = env.scene().unwrap().listener;
        assert_eq!(listener.word, env.insight().unwrap().word);
        listener.word.map(|word| (word.heard, word.started, word.needed))
    });
    let (first, second) = (Some((1, true, 2)), Some((2, false, 2)));
    let third = Some((3, false, 2));
    assert_eq!(heard, [first, second, third, None, first, second, None, None]);
    // It is no part of a state, and of no other episode.
    env.step(&say, &mut observation);
    assert!(env.insight().unwrap().word.is_some());
    let bytes = snapshot(&env);
    env.restore(&bytes, &mut observation).unwrap();
    assert_eq!(env.insight().unwrap().word, None);
    env.step(&SILENT, &mut observation);
    assert!(env.insight().unwrap().word.is_some());
    reset(&mut env);
    assert_eq!(env.insight().unwrap().word, None);
}

#[test]
fn a_message_that_is_over_with_its_first_word_has_that_word() {
    let human = HumanSettings { occupies: false, ..HumanSettings::delay_free() };
    let mut env = env(&human, &NotifierSettings::default());
    let mut observation = reset(&mut env);
    for (action, heard) in [([1, 0, 0, 3], Some((1, 5, true, 0))), (SILENT, None)] {
        env.step(&action, &mut observation);
        let word = env.insight().unwrap().word;
        let word = word.map(|word| (word.heard, word.conveyance, word.started, word.needed));
        assert_eq!(word, heard);
    }
}

#[test]
fn a_foreign_snapshot_is_refused() {
    let mut env = default_env();
    let mut observation = reset(&mut env);
    let bytes = snapshot(&env);
    let longer = NotifierSettings { history: 5, ..Default::default() };
    let mut other = self::env(&HumanSettings::default(), &longer);
    let mut wide = vec![0.0; other.spec().obs_dim];
    assert!(matches!(other.restore(&bytes, &mut wide), Err(SnapshotError::OtherTask)));
    let cut = &bytes[..bytes.len() - 1];
    assert!(matches!(env.restore(cut, &mut observation), Err(SnapshotError::Codec(_))));
}

proptest! {
    #[test]
    fn a_restored_episode_goes_on_bit_for_bit(
        choices in prop::collection::vec((0_u8..2, 0_u8..2, 0_u8..4, 0_u8..4), 2..LIMIT as usize),
        cut in 0.0..1.0_f64,
        notification in select(vec![CompleteUtterance, IncrementallyActionable]),
    ) {
        let drawn = crate::human::DelayDraw::PerNotification;
        let reaction_delay = ReactionDelay::Uniform { low: 0, high: 4, drawn };
        let human = HumanSettings { reaction_delay, ..Default::default() };
        let notifier = NotifierSettings { notification, ..Default::default() };
        let (mut straight, mut resumed) = (env(&human, &notifier), env(&human, &notifier));
        let mut expected = reset(&mut straight);
        let mut observation = reset(&mut resumed);
        let cut = (cut * choices.len() as f64) as usize;
        let n_heads = straight.spec().actions.heads.len();
        for (t, (initiate, topic, k, l)) in choices.into_iter().enumerate() {
            let action = &[initiate, topic, k, l.max(k)][..n_heads];
            if t == cut {
                let bytes = snapshot(&resumed);
                resumed = env(&human, &notifier);
                observation.fill(f32::NAN);
                resumed.restore(&bytes, &mut observation).unwrap();
                prop_assert_eq!(&observation, &expected);
            }
            let outcome = straight.step(action, &mut expected);
            prop_assert_eq!(resumed.step(action, &mut observation), outcome);
            prop_assert_eq!(&observation, &expected);
        }
        prop_assert_eq!(snapshot(&straight), snapshot(&resumed));
    }
}

#[test]
fn an_insight_tells_the_delay_and_when_a_reaction_begins() {
    let mut env = default_env();
    let mut observation = reset(&mut env);
    env.domain.place = 2;
    // "hold", k = 2, l = 3: comprehended at 2, acted upon in steps 4, 5 and 6.
    let actions = only::<9>([1, 1, 0, 1]);
    let mut begun = Vec::new();
    for (t, action) in actions.iter().enumerate() {
        env.step(action, &mut observation);
        let insight = env.insight().unwrap();
        assert_eq!((insight.reaction_delay, insight.comprehended), (Some(2), u32::from(t >= 1)));
        begun.extend(insight.reaction_began.then_some(t));
    }
    assert_eq!(begun, [4]);
    // At the wall the same reaction is refused: the listener does nothing of what is asked for.
    let mut observation = reset(&mut env);
    env.domain.place = WALL;
    for action in &actions {
        env.step(action, &mut observation);
        assert!(!env.insight().unwrap().reaction_began);
    }
}
