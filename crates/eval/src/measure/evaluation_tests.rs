//! Evaluations are functions of task, player and seed, and of nothing else.

use leadtime_episodes::{Decision, Error as Refusal};
use leadtime_proto::{ActionSpec, EnvSpec, PolicySpec};
use leadtime_sims::classic::{CartPole, CartPoleSettings};
use leadtime_sims::{Environment, TaskError};

use super::*;
use crate::measure::Choice;
use crate::playthrough::Playthrough;

fn cartpole() -> Result<Box<dyn Environment>, TaskError> {
    Ok(Box::new(CartPole::new(&CartPoleSettings::default())?))
}

fn policy_spec(obs_dim: usize) -> PolicySpec {
    let actions = ActionSpec::discrete("push", 2);
    PolicySpec::dense(&EnvSpec { obs_dim, actions, metrics: Vec::new() }, &[16, 16])
}

fn untrained() -> Player {
    Player::untrained(&policy_spec(4), 5, Choice::Sample).unwrap()
}

fn play(settings: &PlaySettings<'_>) -> Evaluation {
    evaluate(&cartpole, &untrained(), settings).unwrap()
}

#[test]
fn neither_slots_nor_threads_change_a_result() {
    let settings = PlaySettings::new(23, 9);
    let reference = play(&PlaySettings { n_slots: 1, ..settings });
    assert_eq!(reference.episodes.len(), 23);
    for (n_slots, n_threads) in [(7, 1), (64, 1), (4, 2), (1, 3)] {
        let again = play(&PlaySettings { n_slots, ..settings }.threads(n_threads));
        assert_eq!(again, reference, "{n_slots} slots, {n_threads} threads");
    }
}

#[test]
fn the_seed_decides_and_fewer_episodes_are_a_prefix() {
    let long = play(&PlaySettings::new(12, 9));
    let short = play(&PlaySettings::new(5, 9));
    assert_eq!(long.episodes[..5], short.episodes);
    assert_ne!(play(&PlaySettings::new(12, 10)).episodes, long.episodes);
    assert!(play(&PlaySettings::new(0, 0)).episodes.is_empty());
}

#[test]
fn sampling_and_greedy_choice_differ() {
    let greedy = Player::untrained(&policy_spec(4), 5, Choice::Greedy).unwrap();
    let settings = PlaySettings::new(12, 9);
    let greedy = evaluate(&cartpole, &greedy, &settings).unwrap();
    assert_ne!(greedy.episodes, play(&settings).episodes);
}

#[test]
fn a_playthrough_is_the_episode_that_was_evaluated() {
    let evaluation = play(&PlaySettings::new(4, 9));
    for (index, episode) in (0..).zip(&evaluation.episodes) {
        let recorded = Playthrough::record(&cartpole, &untrained(), 9, index).unwrap();
        assert_eq!(recorded.n_steps() as u64, episode.n_steps);
        assert_eq!(recorded.total_reward, episode.total_reward);
    }
}

#[test]
fn what_cannot_be_played_is_refused() {
    let refused = |player: &Player, settings: &PlaySettings<'_>| {
        let error = evaluate(&cartpole, player, settings).unwrap_err();
        let Error::Play(error) = error else { panic!("{error}") };
        error
    };
    let one = PlaySettings::new(1, 0);
    let wide = Player::untrained(&policy_spec(9), 5, Choice::Sample).unwrap();
    let error = refused(&wide, &one);
    assert!(matches!(error, Refusal::PolicyShape { found: [9, 2], expected: [4, 2] }), "{error}");
    let error = refused(&Player::baseline("no such script"), &one);
    assert!(matches!(error, Refusal::UnknownBaseline { .. }), "{error}");
    let error = refused(&untrained(), &PlaySettings { max_steps: 3, ..one });
    assert!(matches!(error, Refusal::Endless { index: 0, n_steps: 3 }), "{error}");
    for n_threads in [1, 2] {
        let stopped = PlaySettings::new(23, 9).threads(n_threads).stopped_by(&|| true);
        let error = refused(&untrained(), &stopped);
        assert!(matches!(error, Refusal::Interrupted), "{error}");
    }
    let settings = PlaySettings::new(4, 9);
    assert_eq!(play(&settings.stopped_by(&|| false)), play(&settings));
}

#[test]
fn observers_watch_the_episodes_that_are_measured() {
    let settings = PlaySettings { n_slots: 3, ..PlaySettings::new(8, 9) };
    let observe = |index| HookCount { index, ..HookCount::default() };
    let (evaluation, seen) = evaluate_with(&cartpole, &untrained(), &settings, observe).unwrap();
    for (index, (episode, seen)) in (0..).zip(evaluation.episodes.iter().zip(seen)) {
        let expected = HookCount { index, n_resets: 1, n_actions: episode.n_steps, n_hidden: 1 };
        assert_eq!(seen, expected);
    }
}

/// Counts its hooks; wants the hidden features of the first step.
#[derive(Debug, Default, PartialEq)]
struct HookCount {
    index: u64,
    n_resets: u64,
    n_actions: u64,
    n_hidden: u64,
}

impl Observer for HookCount {
    fn on_reset(&mut self, slot: &EnvSlot) {
        assert_eq!(slot.seed(), leadtime_episodes::episode_seed(9, self.index));
        self.n_resets += 1;
    }

    fn wants_hidden(&mut self, slot: &EnvSlot) -> bool {
        slot.n_steps() == 0
    }

    fn on_decision(&mut self, slot: &EnvSlot, decision: &Decision<'_>) {
        assert_eq!(u64::from(slot.n_steps()), self.n_actions);
        self.n_actions += 1;
        self.n_hidden += u64::from(decision.hidden.is_some_and(|hidden| hidden.len() == 16));
    }
}

impl EpisodeObserver for HookCount {
    type Output = Self;

    fn finish(self, _slot: &EnvSlot, _end: End) -> Self {
        self
    }
}
