//! One environment of a worker, as this process knows it: enough to put it back where it was in another worker.

use leadtime_numerics::Purpose;
use leadtime_proto::limits::MAX_MAGNITUDE;
use leadtime_sims::EpisodeSeed;

use crate::protocol::StepRow;

/// The bits of a seed that Gymnasium gets.
const SEED_BITS: u32 = 31;

/// How far a step has come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum StepProgress {
    /// None is under way.
    #[default]
    Idle,
    /// Its action is known.
    Announced,
    /// It is with the worker.
    Sent,
    /// It is with the worker once more, after an exception.
    SentAgain,
    /// The row has what it has shown, and nothing has read it yet.
    Shown,
}

/// An environment of a worker.
#[derive(Debug, Default)]
pub(crate) struct WorkerSlot {
    /// It is reserved, and stepped by its holder.
    pub(crate) is_used: bool,
    /// An episode has begun, here and in the worker.
    pub(crate) is_begun: bool,
    /// The episode that the worker is in.
    pub(crate) seed: EpisodeSeed,
    /// A pickle of the environment; empty where the episode's seed is where it goes on from.
    pub(crate) base: Vec<u8>,
    /// Steps of the episode before the base; all of them where actions are not kept.
    pub(crate) n_before: u32,
    /// Actions since then. Shape `[n, H]`.
    pub(crate) actions: Vec<u8>,
    /// The action of the step that is announced. Shape `[H]`.
    pub(crate) action: Vec<u8>,
    /// What the latest step has shown.
    pub(crate) row: StepRow,
    pub(crate) progress: StepProgress,
    /// The row's observation begins an episode that was not asked for yet.
    pub(crate) is_ahead: bool,
    /// The exception of the step that failed last.
    pub(crate) exception: String,
    /// Why it cannot be stepped any more.
    pub(crate) failure: Option<String>,
}

impl WorkerSlot {
    /// Notes that an episode begins, from its seed.
    pub(crate) fn begin(&mut self, seed: EpisodeSeed) {
        self.seed = seed;
        self.base.clear();
        self.actions.clear();
        self.n_before = 0;
        self.is_begun = true;
    }

    /// Returns the seed of the next episode of the same environment.
    pub(crate) fn next_seed(&self) -> EpisodeSeed {
        self.seed.following()
    }

    /// Returns how many steps of the episode were taken.
    pub(crate) fn n_steps(&self) -> usize {
        let n_heads = self.action.len().max(1);
        self.n_before as usize + self.actions.len() / n_heads
    }

    /// Notes what the step that was under way has shown; `row` is exchanged for the one before. Its action is kept where it can be
    /// taken again.
    ///
    /// `metrics`: the names of the row's metrics.
    pub(crate) fn stepped(&mut self, row: &mut StepRow, metrics: &[String], keeps_action: bool) {
        std::mem::swap(&mut self.row, row);
        self.progress = StepProgress::Shown;
        self.failure = self.implausible(metrics);
        if self.row.end.is_some() {
            self.begin(self.next_seed());
            self.is_ahead = true;
        } else if keeps_action {
            self.actions.extend_from_slice(&self.action);
        } else {
            self.n_before = self.n_before.saturating_add(1);
        }
    }

    /// Takes note that the environment cannot be stepped any more.
    pub(crate) fn fail(&mut self, reason: impl FnOnce(&Self) -> String) {
        if self.failure.is_none() {
            self.failure = Some(reason(self));
        }
        self.progress = StepProgress::Shown;
    }

    /// Takes note of what an episode begins with, or goes on with where it is put back: the row that came without a step.
    pub(crate) fn put_back(&mut self) {
        (self.progress, self.is_ahead) = (StepProgress::Idle, false);
        if let Some(what) = named("observation", &self.row.observation) {
            self.fail(|slot| {
                let EpisodeSeed { env_id, episode, .. } = slot.seed;
                let n_steps = slot.n_steps();
                let place = if n_steps == 0 {
                    format!("at the reset of episode {episode}")
                } else {
                    format!("where episode {episode} goes on after {n_steps} steps")
                };
                format!("environment {env_id}: {what} {place}")
            });
        }
    }

    /// Names the first number that cannot be, if there is one.
    fn implausible(&self, metrics: &[String]) -> Option<String> {
        let row = &self.row;
        let Self { seed: EpisodeSeed { env_id, episode, .. }, action, .. } = self;
        let in_end = || {
            row.end?;
            named("the last observation", &row.last_observation).or_else(|| {
                let (name, x) = metrics.iter().zip(&row.metrics).find(|(_, x)| is_odd(**x))?;
                Some(format!("metric `{name}` is {}", shown(*x)))
            })
        };
        let reward = || is_odd(row.reward).then(|| format!("the reward is {}", shown(row.reward)));
        let observed = named("observation", &row.observation);
        let (seen, begun) = if row.end.is_some() { (None, observed) } else { (observed, None) };
        if let Some(what) = seen.or_else(reward).or_else(in_end) {
            let step = self.n_steps() + 1;
            return Some(format!(
                "environment {env_id}: {what} after action {action:?} in episode {episode}, step {step}"
            ));
        }
        let next = self.next_seed().episode;
        begun.map(|what| format!("environment {env_id}: {what} at the reset of episode {next}"))
    }
}

fn is_odd(x: f32) -> bool {
    !(-MAX_MAGNITUDE..=MAX_MAGNITUDE).contains(&f64::from(x))
}

/// Names the first of some numbers that cannot be.
fn named(name: &str, values: &[f32]) -> Option<String> {
    let i = values.iter().position(|x| is_odd(*x))?;
    Some(format!("{name}[{i}] is {}", shown(values[i])))
}

/// Writes a number that cannot be as Python does.
fn shown(x: f32) -> String {
    if x.is_nan() { "nan".to_owned() } else { format!("{x:e}") }
}

/// Draws the number with which an environment begins an episode.
pub(crate) fn reset_seed(seed: EpisodeSeed) -> u32 {
    (seed.stream(Purpose::World).next_u64() >> (64 - SEED_BITS)) as u32
}

#[cfg(test)]
mod tests {
    use leadtime_proto::EnvId;
    use leadtime_sims::End;

    use super::*;

    fn slot() -> WorkerSlot {
        let mut slot = WorkerSlot::default();
        slot.begin(EpisodeSeed { run_seed: 1, env_id: EnvId(17), episode: 12 });
        slot.action = vec![1, 0];
        slot
    }

    #[test]
    fn a_number_that_cannot_be_is_named_with_its_place() {
        let mut slot = slot();
        slot.actions = vec![0; 2 * 39];
        let mut row = StepRow { observation: vec![0.0, 1.0, 2.0, f32::NAN], ..StepRow::default() };
        slot.stepped(&mut row, &[], true);
        let expected =
            "environment 17: observation[3] is nan after action [1, 0] in episode 12, step 40";
        assert_eq!(slot.failure.as_deref(), Some(expected));
        let mut row = StepRow { reward: -2e9, ..StepRow::default() };
        slot.stepped(&mut row, &[], true);
        assert!(slot.failure.take().unwrap().contains("the reward is -2e9 after"));
        let end = Some(End::Terminated);
        let mut row = StepRow { end, metrics: vec![1.0, f32::NAN], ..StepRow::default() };
        slot.stepped(&mut row, &["success", "fuel"].map(str::to_owned), true);
        assert!(slot.failure.unwrap().contains("metric `fuel` is nan after"));
    }

    #[test]
    fn a_number_that_cannot_be_at_a_reset_is_named_with_its_episode() {
        let odd = || StepRow { observation: vec![0.0, f32::NAN], ..StepRow::default() };
        let mut slot = slot();
        slot.row = odd();
        slot.put_back();
        let expected = "environment 17: observation[1] is nan at the reset of episode 12";
        assert_eq!(slot.failure.take().as_deref(), Some(expected));
        slot.n_before = 3;
        slot.put_back();
        assert!(slot.failure.take().unwrap().ends_with("where episode 12 goes on after 3 steps"));
        slot.stepped(&mut StepRow { end: Some(End::Terminated), ..odd() }, &[], true);
        assert!(
            slot.failure.unwrap().ends_with("observation[1] is nan at the reset of episode 13")
        );
    }

    #[test]
    fn an_episode_that_ends_is_followed_by_the_next_one() {
        let mut slot = slot();
        slot.stepped(&mut StepRow::default(), &[], true);
        assert_eq!((slot.n_steps(), slot.is_ahead), (1, false));
        let end = Some(End::Terminated);
        slot.stepped(&mut StepRow { end, ..StepRow::default() }, &[], true);
        assert_eq!((slot.n_steps(), slot.is_ahead, slot.seed.episode), (0, true, 13));
    }

    #[test]
    fn seeds_have_31_bits_and_depend_on_all_that_names_them() {
        let of = |run_seed, env_id, episode| {
            reset_seed(EpisodeSeed { run_seed, env_id: EnvId(env_id), episode })
        };
        let seeds = [of(1, 0, 0), of(2, 0, 0), of(1, 1, 0), of(1, 0, 1)];
        let all: std::collections::BTreeSet<u32> = seeds.into_iter().collect();
        assert!(all.len() == 4 && all.iter().all(|seed| *seed < 1 << 31));
    }
}
