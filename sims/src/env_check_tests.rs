use std::sync::atomic::{AtomicU32, Ordering};

use leadtime_numerics::Purpose;
use leadtime_proto::{ActionSpec, Mask};
use serde::{Deserialize, Serialize};

use super::*;
use crate::environment::{read_snapshot, write_snapshot};
use crate::human::HumanSettings;
use crate::notifier::NotifierSettings;
use crate::{
    Advance, Description, Domain, End, NotifierEnv, Quantity, ReactionStatus, ReactionStep, Scene,
};

/// What is wrong with a walker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Flaw {
    None,
    RestoreForgetsPace,
    SnapshotForgetsPace,
    SnapshotForgetsTurns,
    ResetForgetsTurns,
    Static,
    NotANumber,
    GrowingSnapshot,
    RefusesItself,
    NamesTooFew,
}

#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Walk {
    n_steps: u32,
    place: f32,
    pace: f32,
    turns: u32,
    trail: Vec<u64>,
}

/// Walks for sixty steps; turns round when told to.
#[derive(Debug)]
struct Walker {
    flaw: Flaw,
    reward: f64,
    walk: Walk,
}

static STEPS_OF_ALL: AtomicU32 = AtomicU32::new(0);

impl Domain for Walker {
    fn topics(&self) -> &[&'static str] {
        &["turn", "go_on"]
    }

    fn obs_dim(&self) -> usize {
        2
    }

    fn quantities(&self) -> Vec<Quantity> {
        Quantity::unnamed(if self.flaw == Flaw::NamesTooFew { 1 } else { 2 })
    }

    fn reset(&mut self, seed: EpisodeSeed) {
        let turns = if self.flaw == Flaw::ResetForgetsTurns { self.walk.turns } else { 0 };
        let pace = 1.0 + seed.stream(Purpose::World).below(5) as f32;
        self.walk = Walk { pace, turns, ..Walk::default() };
    }

    fn observe(&self, out: &mut [f32]) {
        out[0] = self.walk.n_steps as f32 / 60.0;
        let is_odd = self.flaw == Flaw::NotANumber && self.walk.n_steps == 9;
        out[1] = if is_odd { f32::NAN } else { self.walk.place };
    }

    fn advance(&mut self, reaction: Option<ReactionStep>) -> Advance {
        let walk = &mut self.walk;
        if reaction.is_some_and(|reaction| reaction.first && reaction.topic == 0) {
            walk.pace = -walk.pace;
            walk.turns += 1;
        }
        walk.n_steps += 1;
        walk.place += walk.pace;
        if self.flaw == Flaw::Static {
            walk.place += STEPS_OF_ALL.fetch_add(1, Ordering::Relaxed) as f32;
        }
        if self.flaw == Flaw::GrowingSnapshot {
            walk.trail.push(u64::MAX);
        }
        let end = (walk.n_steps == 60).then_some(End::Truncated);
        let reward = if end.is_some() { self.reward } else { 0.0 };
        Advance { reward, reaction: reaction.map(|_| ReactionStatus::Followed), end }
    }

    fn success(&self) -> bool {
        false
    }

    fn metric_names(&self) -> &'static [&'static str] {
        &["turns"]
    }

    fn metrics(&self, out: &mut [f32]) {
        out[0] = self.walk.turns as f32;
    }

    fn snapshot(&self, out: &mut Vec<u8>) {
        let mut walk = self.walk.clone();
        match self.flaw {
            Flaw::SnapshotForgetsPace => walk.pace = 1.0,
            Flaw::SnapshotForgetsTurns => walk.turns = 0,
            _ => {}
        }
        write_snapshot(&walk, out);
    }

    fn restore(&mut self, snapshot: &[u8]) -> Result<(), SnapshotError> {
        let walk: Walk = read_snapshot(snapshot)?;
        if self.flaw == Flaw::RefusesItself && walk.n_steps > 20 {
            return Err(SnapshotError::Mismatch { what: "number of steps" });
        }
        let pace = if self.flaw == Flaw::RestoreForgetsPace { self.walk.pace } else { walk.pace };
        self.walk = Walk { pace, ..walk };
        Ok(())
    }

    fn scene(&self) -> Scene {
        Scene::default()
    }
}

fn check(flaw: Flaw, reward: f64, initiation_cost: f64) -> EnvReport {
    let build = || -> Result<Box<dyn Environment>, TaskError> {
        let walker = Walker { flaw, reward, walk: Walk::default() };
        let notifier = NotifierSettings { initiation_cost, ..NotifierSettings::default() };
        Ok(Box::new(NotifierEnv::new(walker, &HumanSettings::default(), &notifier)?))
    };
    check_environment(build).unwrap()
}

fn defects(flaw: Flaw) -> Vec<String> {
    check(flaw, 1.0, 0.02).defects.iter().map(ToString::to_string).collect()
}

#[test]
fn a_sound_world_is_played_and_has_no_defect() {
    let report = check(Flaw::None, 1.0, 0.02);
    assert!(report.defects.is_empty(), "{:?}", report.defects);
    assert_eq!((report.n_episodes, report.n_steps, report.n_restored), (12, 720, 48));
    assert!(report.largest_snapshot > 0 && report.largest_snapshot <= report.snapshot_bound);
    assert_eq!(report.rewards.per_episode, 1.0);
    assert_eq!(report.rewards.per_step, 1.0 / 60.0);
    assert!((report.rewards.message_cost - 0.02).abs() < 1e-6);
    assert_eq!(report.rewards.notice(), None);
}

/// Counts to three, with another head than it describes, and offers nothing after the first step.
#[derive(Debug)]
struct Counter {
    spec: EnvSpec,
    n_steps: u8,
    /// What steps it fails in the second step.
    fails: bool,
}

impl Counter {
    fn new(fails: bool) -> Self {
        let actions = ActionSpec::discrete("press", 2);
        Self { spec: EnvSpec { obs_dim: 1, actions, metrics: Vec::new() }, n_steps: 0, fails }
    }
}

impl Environment for Counter {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn describe(&self) -> Description {
        let mut description = Description::unnamed(&self.spec);
        description.actions[0].choices.pop();
        description
    }

    fn reset(&mut self, _seed: EpisodeSeed, observation: &mut [f32]) {
        self.n_steps = 0;
        observation[0] = 0.0;
    }

    fn mask(&self) -> Mask {
        if self.n_steps == 1 { Mask(0) } else { Mask::ALL }
    }

    fn step(&mut self, _action: &[u8], observation: &mut [f32]) -> StepOutcome {
        self.n_steps += 1;
        observation[0] = f32::from(self.n_steps);
        let is_over = self.n_steps == 3 || self.failure().is_some();
        StepOutcome { reward: 0.0, end: is_over.then_some(End::Truncated) }
    }

    fn metrics(&self, _out: &mut [f32]) {}

    fn failure(&self) -> Option<String> {
        let has_failed = self.fails && self.n_steps == 2;
        has_failed.then(|| "environment 0 fails: RuntimeError: no fuel".to_owned())
    }

    fn write_state(&self, out: &mut Vec<u8>) {
        out.push(self.n_steps);
    }

    fn read_state(&mut self, state: &[u8], observation: &mut [f32]) -> Result<(), SnapshotError> {
        self.n_steps = state[0];
        observation[0] = f32::from(self.n_steps);
        Ok(())
    }
}

#[test]
fn shapes_that_do_not_fit_are_defects() {
    let found = check_environment(|| Ok(Box::new(Counter::new(false)))).unwrap().defects;
    let found: Vec<String> = found.iter().map(ToString::to_string).collect();
    let [heads, mask] = &found[..] else { panic!("{found:#?}") };
    assert!(heads.starts_with("`describe` has the heads `press` 1, and `spec` has `press` 2: "));
    assert!(mask.starts_with("the mask offers no choice of head `press` at step 1 of episode 0: "));
    let named = defects(Flaw::NamesTooFew);
    let [quantities] = &named[..] else { panic!("{named:#?}") };
    assert!(quantities.starts_with("`quantities` names "), "{quantities}");
}

#[test]
fn an_environment_that_fails_is_named_before_anything_that_follows_from_it() {
    let n_built = AtomicU32::new(0);
    let build = || -> Result<Box<dyn Environment>, TaskError> {
        n_built.fetch_add(1, Ordering::Relaxed);
        Ok(Box::new(Counter::new(true)))
    };
    let report = check_environment(build).unwrap();
    let found: Vec<String> = report.defects.iter().map(ToString::to_string).collect();
    let says = "step 2 of episode 0 cannot be played: environment 0 fails: RuntimeError: no fuel";
    assert_eq!(found, [says]);
    assert_eq!((report.n_episodes, n_built.into_inner()), (1, 1), "it is not tried again");
}

#[test]
fn messages_that_cost_more_than_they_can_win_are_noticed() {
    let notice = check(Flaw::None, 1.0, 1.0).rewards.notice().unwrap();
    let says = "a message costs 1.000, and an episode without messages has rewards of 1.000 in all (absolute): an \
                untrained notifier speaks often, so it may learn silence; set `notifier.initiation_cost` to 0.100 or less";
    assert_eq!(notice, says);
    assert_eq!(check(Flaw::None, 100.0, 1.0).rewards.notice(), None);
    let sparse = check(Flaw::None, 0.0, 1.0).rewards.notice().unwrap();
    assert!(sparse.contains("an episode without messages has no rewards"), "{sparse}");
    assert!(
        sparse.ends_with("set `notifier.initiation_cost` to a small part of what a success pays")
    );
}

#[test]
fn every_flaw_has_its_sentence() {
    for (flaw, parts) in [
        (Flaw::NotANumber, &["observation ", " is NaN at step 9 of episode 0; observations, "][..]),
        (
            Flaw::GrowingSnapshot,
            &["the snapshot has ", "promised at most ", "raise `snapshot_margin`"],
        ),
        (
            Flaw::Static,
            &[
                "not deterministic: ",
                "at step 1 of episode 0 observation ",
                " the first time; draw",
            ],
        ),
        (
            Flaw::ResetForgetsTurns,
            &["`reset` leaves something", "at step 0 of episode ", "metric `turns` is "],
        ),
        (
            Flaw::RestoreForgetsPace,
            &[
                "after the snapshot of step 0 of episode 0 was restored, at step 1 of episode 0 observation ",
                "(1 step later); a snapshot taken right away differs from it in byte ",
                "`snapshot` writes a field that `restore` does not put back",
            ],
        ),
        (
            Flaw::SnapshotForgetsPace,
            &[
                "after the snapshot of step 0 of episode 0 was restored, at step 1 of episode 0 observation ",
                "(1 step later); a snapshot taken right away is the same: `snapshot` does not write a field",
            ],
        ),
        (
            Flaw::SnapshotForgetsTurns,
            &[
                "metric `turns` is 0, and was ",
                " the first time (at once); a snapshot taken right away is",
            ],
        ),
        (
            Flaw::RefusesItself,
            &["`restore` refuses the environment's own snapshot of step ", "number of steps"],
        ),
    ] {
        let found = defects(flaw);
        let [sentence] = &found[..] else { panic!("{flaw:?}: {found:#?}") };
        let missing: Vec<_> = parts.iter().filter(|part| !sentence.contains(**part)).collect();
        assert!(missing.is_empty(), "{flaw:?}: {sentence} lacks {missing:#?}");
    }
}
