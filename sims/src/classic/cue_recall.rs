//! A memory task: a cue is shown in the first step, asked for in the last, and blanked in between.
//!
//! ```text
//! step         0        1 ... delay     delay + 1
//! sees         cue      nothing         "now"
//! choice                                counts: +1 if it is the cue, -1 if not
//! ```
//!
//! A policy without memory cannot beat chance, 1 / `n_cues`, so this shows whether a recurrent state is carried
//! correctly through rollouts, snapshots and learner.

use leadtime_numerics::Purpose;
use leadtime_proto::{ActionSpec, EnvSpec};
use serde::{Deserialize, Serialize};

use crate::check::{SettingError, require, require_within};
use crate::description::{Description, NamedHead, ObservationLayout, Quantity, RewardTerm};
use crate::environment::{
    End, Environment, EpisodeSeed, SnapshotError, StepOutcome, read_snapshot, write_snapshot,
};

/// Settings of [`CueRecall`]: how many cues, and how long to remember them.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CueRecallSettings {
    /// How many cues there are (2..=16). Default 2.
    pub n_cues: usize,
    /// The fewest blank steps between cue and question (0..=1000). Default 2.
    pub delay_min: u32,
    /// The most blank steps (`delay_min`..=1000). Default 6.
    pub delay_max: u32,
}

impl Default for CueRecallSettings {
    fn default() -> Self {
        Self { n_cues: 2, delay_min: 2, delay_max: 6 }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
struct CueRecallState {
    cue: u8,
    delay: u32,
    n_steps: u32,
    recalled: bool,
}

/// The cue-recall task.
///
/// # Shapes
///
/// Observation `[n_cues + 1]`: the cue one-hot in the first step, then zeros, and 1 in the last place when the
/// answer is asked for. Action: one head of `n_cues` choices.
#[derive(Clone, Debug)]
pub struct CueRecall {
    spec: EnvSpec,
    settings: CueRecallSettings,
    state: CueRecallState,
}

impl CueRecall {
    /// Creates the task; the error names a setting that is out of range.
    pub(super) fn new(settings: &CueRecallSettings) -> Result<Self, SettingError> {
        let &CueRecallSettings { n_cues, delay_min, delay_max } = settings;
        require_within("world.n_cues", n_cues, 2..=16, "cues")?;
        let fits = delay_min <= delay_max && delay_max <= 1000;
        let given = format_args!("{delay_max} (with delay_min {delay_min})");
        require(fits, "world.delay_max", given, "delay_min to 1000 steps")?;
        let spec = EnvSpec {
            obs_dim: n_cues + 1,
            actions: ActionSpec::discrete("recall", n_cues),
            metrics: vec!["success".to_owned()],
        };
        Ok(Self { spec, settings: settings.clone(), state: CueRecallState::default() })
    }

    fn observe(&self, observation: &mut [f32]) {
        observation.fill(0.0);
        if self.state.n_steps == 0 {
            observation[usize::from(self.state.cue)] = 1.0;
        } else if self.state.n_steps == self.state.delay + 1 {
            observation[self.settings.n_cues] = 1.0;
        }
    }
}

impl Environment for CueRecall {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn describe(&self) -> Description {
        let cues = 0..self.settings.n_cues;
        let cue =
            |i| Quantity::flag(format!("cue{i}"), "whether this is the cue, in the first step");
        let mut frame: Vec<Quantity> = cues.clone().map(cue).collect();
        frame.push(Quantity::flag("asked", "whether the answer is asked for"));
        let choices = cues.map(|i| format!("cue{i}")).collect();
        let rewards = vec![
            RewardTerm::new("the right answer", 1.0, ""),
            RewardTerm::new("a wrong answer", -1.0, ""),
        ];
        Description {
            observation: ObservationLayout::single(frame),
            actions: vec![NamedHead { name: "recall".to_owned(), choices }],
            rewards,
        }
    }

    fn reset(&mut self, seed: EpisodeSeed, observation: &mut [f32]) {
        let mut generator = seed.stream(Purpose::World);
        let CueRecallSettings { n_cues, delay_min, delay_max } = self.settings;
        let cue = generator.below(n_cues) as u8;
        let delay = generator.integers(delay_min.into(), i64::from(delay_max) + 1) as u32;
        self.state = CueRecallState { cue, delay, n_steps: 0, recalled: false };
        self.observe(observation);
    }

    fn step(&mut self, action: &[u8], observation: &mut [f32]) -> StepOutcome {
        let asked = self.state.n_steps == self.state.delay + 1;
        self.state.recalled = asked && action[0] == self.state.cue;
        self.state.n_steps += 1;
        self.observe(observation);
        let answer = if self.state.recalled { 1.0 } else { -1.0 };
        let reward = if asked { answer } else { 0.0 };
        StepOutcome { reward, end: asked.then_some(End::Terminated) }
    }

    fn metrics(&self, out: &mut [f32]) {
        out[0] = f32::from(u8::from(self.state.recalled));
    }

    fn write_state(&self, out: &mut Vec<u8>) {
        write_snapshot(&self.state, out);
    }

    fn read_state(&mut self, state: &[u8], observation: &mut [f32]) -> Result<(), SnapshotError> {
        let state: CueRecallState = read_snapshot(state)?;
        if usize::from(state.cue) >= self.settings.n_cues {
            return Err(SnapshotError::Mismatch { what: "number of cues" });
        }
        let delays = self.settings.delay_min..=self.settings.delay_max;
        if !delays.contains(&state.delay) || state.n_steps > state.delay + 2 {
            return Err(SnapshotError::Mismatch { what: "delay" });
        }
        self.state = state;
        self.observe(observation);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use leadtime_proto::EnvId;

    use super::*;

    /// Plays an episode with a fixed answer, or with the cue itself; returns the return.
    fn play(task: &mut CueRecall, episode: u64, answer: Option<u8>) -> f32 {
        let mut observation = vec![0.0; task.spec.obs_dim];
        task.reset(EpisodeSeed { run_seed: 1, env_id: EnvId(0), episode }, &mut observation);
        let cue = observation.iter().position(|&x| x == 1.0).unwrap() as u8;
        let mut total = 0.0;
        loop {
            let outcome = task.step(&[answer.unwrap_or(cue)], &mut observation);
            total += outcome.reward;
            if outcome.end.is_some() {
                return total;
            }
        }
    }

    #[test]
    fn remembering_wins_and_a_fixed_answer_is_chance() {
        let mut task = CueRecall::new(&CueRecallSettings::default()).unwrap();
        let remembered: f32 = (0..100).map(|e| play(&mut task, e, None)).sum();
        assert_eq!(remembered, 100.0);
        let fixed: f32 = (0..100).map(|e| play(&mut task, e, Some(0))).sum();
        assert!(fixed.abs() < 40.0, "{fixed}");
    }

    #[test]
    fn the_cue_is_seen_once_and_the_question_once() {
        let settings = CueRecallSettings { n_cues: 3, delay_min: 2, delay_max: 2 };
        let mut task = CueRecall::new(&settings).unwrap();
        let mut observation = [0.0; 4];
        task.reset(EpisodeSeed { run_seed: 1, env_id: EnvId(0), episode: 0 }, &mut observation);
        assert_eq!(observation[3], 0.0);
        for expected in [[0.0; 4], [0.0; 4], [0.0, 0.0, 0.0, 1.0]] {
            assert_eq!(task.step(&[0], &mut observation).end, None);
            assert_eq!(observation, expected);
        }
        assert_eq!(task.step(&[0], &mut observation).end, Some(End::Terminated));
    }

    #[test]
    fn impossible_settings_are_named() {
        let error = CueRecall::new(&CueRecallSettings { delay_min: 9, ..Default::default() });
        let text = "`world.delay_max` is 6 (with delay_min 9); allowed: delay_min to 1000 steps";
        assert_eq!(error.unwrap_err().to_string(), text);
    }
}
