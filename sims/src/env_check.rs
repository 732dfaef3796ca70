//! Checks an environment: it keeps the promise of equal bits only if its own `reset`, `snapshot` and `restore` do.
//!
//! Seeded episodes are played once and recorded, and then again with the same actions:
//!
//! ```text
//! in a fresh environment                                            -> same seed, same actions, same bits?
//! in one that has played other episodes                             -> does `reset` forget them?
//! from a snapshot, in one that is in the middle of another episode  -> does `restore` put everything back?
//! ```
//!
//! A third of the episodes is random, a third is played without messages, and a third by the task's own script.
//! Where to start: [`check_environment`].

use std::fmt;

use leadtime_numerics::Pcg64;
use leadtime_proto::{ActionSpec, EnvId, EnvSpec, Mask};
use thiserror::Error;

use crate::environment::{Environment, EpisodeSeed, SnapshotError, StepOutcome};
use crate::error::TaskError;

/// Episodes that are played.
const N_EPISODES: u64 = 12;
/// Steps after which an episode is left.
const MAX_STEPS: usize = 300;
/// Snapshots of an episode that are restored, evenly spread over it.
const N_RESTORED: usize = 4;
/// Seed of the episodes and of the random actions.
const SEED: u64 = 7;
/// The script that a third of the episodes follows, where the task has it.
const SCRIPT: &str = "heuristic";
/// The share of an episode's rewards, in absolute terms, above which the cost of one message is worth a notice.
const NOTABLE_COST: f64 = 0.1;

/// What playing an environment showed.
#[derive(Debug)]
pub struct EnvReport {
    /// How many episodes were played.
    pub n_episodes: u64,
    /// Steps of these episodes.
    pub n_steps: usize,
    /// How many snapshots were taken and restored.
    pub n_restored: usize,
    /// Size of the largest snapshot, in bytes.
    pub largest_snapshot: usize,
    /// What the environment promised of it, in bytes.
    pub snapshot_bound: usize,
    /// How large the rewards are.
    pub rewards: RewardScale,
    /// What is wrong, the first of each kind; empty if nothing is.
    pub defects: Vec<EnvDefect>,
}

/// How large the rewards of episodes without messages are, and what a message costs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RewardScale {
    /// Mean absolute reward of a step.
    pub per_step: f64,
    /// Sum of the absolute rewards of an episode, on average.
    pub per_episode: f64,
    /// By how much starting a message lowers the reward of its step; 0 in a task without messages.
    pub message_cost: f64,
}

impl fmt::Display for RewardScale {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { per_step, per_episode, message_cost } = self;
        write!(f, "{per_step:.3} per step, {per_episode:.3} per episode, in absolute terms")?;
        if *message_cost > 0.0 {
            write!(f, "; without messages, each of which costs {message_cost:.3}")?;
        }
        Ok(())
    }
}

impl RewardScale {
    /// Returns a warning if messages are so dear that a notifier learns silence before it learns what they are good for.
    pub fn notice(&self) -> Option<String> {
        let Self { per_episode, message_cost, .. } = *self;
        let limit = NOTABLE_COST * per_episode;
        (message_cost > limit).then(|| {
            if per_episode == 0.0 {
                return format!(
                    "a message costs {message_cost:.3}, and an episode without messages has no rewards: an untrained \
                     notifier speaks often and rarely wins what messages can win, so it may learn silence; set \
                     `notifier.initiation_cost` to a small part of what a success pays"
                );
            }
            format!(
                "a message costs {message_cost:.3}, and an episode without messages has rewards of {per_episode:.3} in \
                 all (absolute): an untrained notifier speaks often, so it may learn silence; set \
                 `notifier.initiation_cost` to {limit:.3} or less"
            )
        })
    }
}

/// A step of an episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepPlace {
    /// Which of the episodes, from 0.
    pub episode: u64,
    /// Steps taken in it; 0 after its reset.
    pub step: usize,
}

impl fmt::Display for StepPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "step {} of episode {}", self.step, self.episode)
    }
}

/// The first thing in which two playings of an episode differ.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Divergence {
    /// What differs: ``observation 3 (`x`)``, `the reward`, ``metric `slipped` ``.
    pub what: String,
    /// What it was at first.
    pub expected: String,
    /// What it is now.
    pub found: String,
    /// The step at which they differ.
    pub at: StepPlace,
}

impl fmt::Display for Divergence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { what, expected, found, at } = self;
        write!(f, "at {at} {what} is {found}, and was {expected} the first time")
    }
}

/// What is wrong with an environment.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the sentence of each variant names its fields")]
pub enum EnvDefect {
    #[error(
        "`quantities` names {n_named} numbers of an observation that has {obs_dim}: name each once, in order, or policy \
         files and `describe` label them wrongly"
    )]
    QuantitiesDiffer { n_named: usize, obs_dim: usize },
    #[error(
        "`describe` has the heads {described}, and `spec` has {specified}: policy files and `describe` label the \
         choices wrongly"
    )]
    HeadsDiffer { described: String, specified: String },
    #[error(
        "the mask offers no choice of head `{head}` at {at}: offer at least one, such as the one that does nothing"
    )]
    NothingOffered { head: String, at: StepPlace },
    #[error(
        "{what} is {value} at {at}; observations, rewards and metrics must be finite, and every one must be written"
    )]
    NotFinite { what: String, value: f32, at: StepPlace },
    #[error(
        "the snapshot has {n_bytes} bytes at {at}, and `max_snapshot_bytes` promised at most {bound}: raise \
         `snapshot_margin`"
    )]
    SnapshotTooLarge { n_bytes: usize, bound: usize, at: StepPlace },
    /// What steps the environment outside of this process has failed: nothing that it shows after that counts.
    #[error("{at} cannot be played: {reason}")]
    Failed { at: StepPlace, reason: String },
    #[error(
        "not deterministic: played again from the same seed in a fresh environment, {0}; draw every random number from \
         the seed of the episode (`EpisodeSeed`; `reset(seed=...)` in Python), and let nothing depend on hash maps, clocks \
         or globals"
    )]
    NotDeterministic(Divergence),
    #[error(
        "`reset` leaves something of the episode before: played again in a used environment, {0}"
    )]
    NotReset(Divergence),
    #[error("`restore` refuses the environment's own snapshot of {at}: {fault}")]
    NotRestored { at: StepPlace, fault: SnapshotError },
    /// A restored episode goes on in another way.
    #[error(
        "after the snapshot of {from} was restored, {divergence} ({}); {cause}",
        after(from, divergence)
    )]
    GoesOnOtherwise { from: StepPlace, divergence: Divergence, cause: RestoreCause },
    /// A restored episode goes on in the same way, as far as it was played, but its snapshot differs.
    #[error("after the snapshot of {from} was restored, {cause}")]
    SnapshotDiffers { from: StepPlace, cause: RestoreCause },
}

/// Says how long after a restore two playings differ.
fn after(from: &StepPlace, divergence: &Divergence) -> String {
    match divergence.at.step - from.step {
        0 => "at once".to_owned(),
        1 => "1 step later".to_owned(),
        n => format!("{n} steps later"),
    }
}

/// Where a wrong restore is to be looked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RestoreCause {
    /// A snapshot taken right after the restore differs from the restored one, first in this byte of so many.
    NotPutBack {
        /// Index of the byte.
        byte: usize,
        /// Length of the restored snapshot.
        n_bytes: usize,
    },
    /// It is the same.
    NotWritten,
}

impl RestoreCause {
    fn of(restored: &[u8], again: &[u8]) -> Self {
        let shared = restored.iter().zip(again).position(|(a, b)| a != b);
        let n_bytes = restored.len();
        let end = restored.len().min(again.len());
        match shared.or((restored.len() != again.len()).then_some(end)) {
            Some(byte) => Self::NotPutBack { byte, n_bytes },
            None => Self::NotWritten,
        }
    }
}

impl fmt::Display for RestoreCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotPutBack { byte, n_bytes } => write!(
                f,
                "a snapshot taken right away differs from it in byte {byte} of {n_bytes}: `snapshot` writes a field that \
                 `restore` does not put back, or one in no fixed order"
            ),
            Self::NotWritten => {
                f.write_str("a snapshot taken right away is the same: `snapshot` does not write a field that matters")
            }
        }
    }
}

/// What an environment shows at one moment.
#[derive(Clone, Debug)]
struct Shown {
    observation: Vec<f32>,
    outcome: StepOutcome,
    metrics: Vec<f32>,
    mask: Mask,
    snapshot: Vec<u8>,
}

impl Shown {
    fn of(env: &dyn Environment, observation: Vec<f32>, outcome: StepOutcome) -> Self {
        let mut metrics = vec![f32::NAN; env.spec().metrics.len()];
        env.metrics(&mut metrics);
        let mut snapshot = Vec::new();
        env.snapshot(&mut snapshot);
        Self { observation, outcome, metrics, mask: env.mask(), snapshot }
    }

    /// Lists every number; [`number_name`] names them.
    fn numbers(&self) -> impl Iterator<Item = f32> {
        let reward = [self.outcome.reward];
        self.observation.iter().copied().chain(reward).chain(self.metrics.iter().copied())
    }

    /// Finds the first difference that a policy or a learner would notice.
    fn divergence(&self, found: &Self, env: &dyn Environment, at: StepPlace) -> Option<Divergence> {
        let differ = |what: String, expected: String, found: String| {
            Some(Divergence { what, expected, found, at })
        };
        let mut pairs = self.numbers().zip(found.numbers()).enumerate();
        let unequal = pairs.find(|(_, (a, b))| a.to_bits() != b.to_bits());
        if let Some((i, (expected, found))) = unequal {
            return differ(number_name(env, i), expected.to_string(), found.to_string());
        }
        let end = |shown: &Self| match shown.outcome.end {
            None => "that it goes on".to_owned(),
            Some(end) => format!("{end:?}").to_lowercase(),
        };
        if self.outcome.end != found.outcome.end {
            return differ("the end of the episode".to_owned(), end(self), end(found));
        }
        let mask = |shown: &Self| format!("{:#b}", shown.mask.0);
        let unequal = self.mask != found.mask;
        unequal.then(|| differ("the mask".to_owned(), mask(self), mask(found))).flatten()
    }
}

/// Names one of [`Shown::numbers`].
fn number_name(env: &dyn Environment, i: usize) -> String {
    let EnvSpec { obs_dim, metrics, .. } = env.spec();
    match i.checked_sub(*obs_dim) {
        None => {
            let quantities = env.describe().observation.quantities();
            let name = quantities.get(i).map_or("", |quantity| quantity.name.as_str());
            format!("observation {i} (`{name}`)")
        }
        Some(0) => "the reward".to_owned(),
        Some(after) => format!("metric `{}`", metrics[after - 1]),
    }
}

/// An episode as it was played first.
#[derive(Debug)]
struct Recording {
    episode: u64,
    actions: Vec<Vec<u8>>,
    /// One more than actions.
    shown: Vec<Shown>,
}

impl Recording {
    fn place(&self, step: usize) -> StepPlace {
        StepPlace { episode: self.episode, step }
    }

    /// Takes steps `from..` of the episode again, and returns the first difference.
    fn go_on(&self, env: &mut dyn Environment, from: usize) -> Option<Divergence> {
        (from..self.actions.len()).find_map(|t| {
            let found = step(env, &self.actions[t]);
            self.shown[t + 1].divergence(&found, env, self.place(t + 1))
        })
    }

    /// Plays the first half of the episode again.
    fn play_half(&self, env: &mut dyn Environment) {
        reset(env, self.episode);
        for action in &self.actions[..self.actions.len() / 2] {
            step(env, action);
        }
    }

    /// Plays the whole episode again, and returns the first difference.
    fn play_again(&self, env: &mut dyn Environment) -> Option<Divergence> {
        let found = reset(env, self.episode);
        let at_once = self.shown[0].divergence(&found, env, self.place(0));
        at_once.or_else(|| self.go_on(env, 0))
    }

    /// Says what is wrong with an environment that played the episode again and differed, if it did.
    fn defect(
        &self,
        env: &dyn Environment,
        divergence: Option<Divergence>,
        kind: fn(Divergence) -> EnvDefect,
    ) -> Option<EnvDefect> {
        let at = divergence.as_ref().map_or(self.place(0), |divergence| divergence.at);
        failed(env, at).or_else(|| divergence.map(kind))
    }

    /// Restores the snapshot of a step into an environment, goes on from there, and says what is wrong.
    fn resume(&self, env: &mut dyn Environment, step: usize) -> Option<EnvDefect> {
        let (from, expected) = (self.place(step), &self.shown[step]);
        let mut observation = unwritten(env);
        if let Err(fault) = env.restore(&expected.snapshot, &mut observation) {
            return Some(EnvDefect::NotRestored { at: from, fault });
        }
        // The reward and the end belong to the step before, which nobody asks for again.
        let found = Shown::of(env, observation, expected.outcome);
        let cause = RestoreCause::of(&expected.snapshot, &found.snapshot);
        let at_once = expected.divergence(&found, env, from);
        match at_once.or_else(|| self.go_on(env, step)) {
            Some(divergence) => Some(EnvDefect::GoesOnOtherwise { from, divergence, cause }),
            None if cause == RestoreCause::NotWritten => None,
            None => Some(EnvDefect::SnapshotDiffers { from, cause }),
        }
    }
}

/// Plays an environment, and reports whether it is as runs need it.
///
/// `build` makes a fresh environment each time. A dozen episodes of at most 300 steps are played, some of them several
/// times, so the check takes seconds at most. An environment that panics makes the check panic.
///
/// # Errors
///
/// [`TaskError`] if the environment cannot be built for the task; what is wrong with it once it is built is in the
/// report.
///
/// # Example
///
/// ```
/// use leadtime_sims::classic::{CartPole, CartPoleSettings};
/// use leadtime_sims::env_check::check_environment;
///
/// let report = check_environment(|| Ok(Box::new(CartPole::new(&CartPoleSettings::default())?)))?;
/// assert!(report.defects.is_empty(), "{:?}", report.defects);
/// # Ok::<(), leadtime_sims::TaskError>(())
/// ```
pub fn check_environment(
    build: impl Fn() -> Result<Box<dyn Environment>, TaskError>,
) -> Result<EnvReport, TaskError> {
    let mut played = Vec::new();
    for episode in 0..N_EPISODES {
        let mut env = build()?;
        let recording = record(env.as_mut(), episode);
        let defect = failed(env.as_ref(), recording.place(recording.actions.len()));
        played.push(recording);
        if defect.is_some() {
            // Nothing that it showed is worth a comparison.
            let bound = env.max_snapshot_bytes();
            let mut report = EnvReport::of(&played, bound, RewardScale::default());
            report.defects.extend(defect);
            return Ok(report);
        }
    }
    let mut used = build()?;
    let bound = build()?.max_snapshot_bytes();
    let mut report = EnvReport::of(&played, bound, rewards(&played, used.as_mut()));
    report.look_at(&played, used.as_ref());
    for recording in &played {
        let mut env = build()?;
        let divergence = recording.play_again(env.as_mut());
        let defect = recording.defect(env.as_ref(), divergence, EnvDefect::NotDeterministic);
        if defect.is_some() {
            // Whatever else would be found follows from it.
            report.defects.extend(defect);
            return Ok(report);
        }
    }
    let mut not_reset = played.iter().find_map(|recording| {
        let divergence = recording.play_again(used.as_mut());
        recording.defect(used.as_ref(), divergence, EnvDefect::NotReset)
    });
    for (recording, other) in played.iter().zip(played.iter().cycle().skip(1)) {
        for n in 0..N_RESTORED {
            let mut env = build()?;
            other.play_half(env.as_mut());
            report.n_restored += 1;
            let step = n * recording.actions.len() / N_RESTORED;
            let defect = recording.resume(env.as_mut(), step);
            let defect = failed(env.as_ref(), recording.place(step)).or(defect);
            if defect.is_some() {
                report.defects.extend(defect);
                report.defects.extend(not_reset);
                return Ok(report);
            }
            not_reset = not_reset.or_else(|| {
                let divergence = other.play_again(env.as_mut());
                other.defect(env.as_ref(), divergence, EnvDefect::NotReset)
            });
        }
    }
    report.defects.extend(not_reset);
    Ok(report)
}

/// Says that an environment cannot be stepped any more, if so.
fn failed(env: &dyn Environment, at: StepPlace) -> Option<EnvDefect> {
    env.failure().map(|reason| EnvDefect::Failed { at, reason })
}

impl EnvReport {
    /// Describes episodes that were played, in which nothing is found yet.
    fn of(played: &[Recording], snapshot_bound: usize, rewards: RewardScale) -> Self {
        Self {
            n_episodes: played.len() as u64,
            n_steps: played.iter().map(|recording| recording.actions.len()).sum(),
            n_restored: 0,
            largest_snapshot: 0,
            snapshot_bound,
            rewards,
            defects: Vec::new(),
        }
    }

    /// Looks at every moment for itself.
    fn look_at(&mut self, played: &[Recording], env: &dyn Environment) {
        let moments = || {
            played.iter().flat_map(|recording| {
                let numbered = recording.shown.iter().enumerate();
                numbered.map(|(step, shown)| (recording.place(step), shown))
            })
        };
        let odd = moments().find_map(|(at, shown)| {
            let (i, value) = shown.numbers().enumerate().find(|(_, value)| !value.is_finite())?;
            Some(EnvDefect::NotFinite { what: number_name(env, i), value, at })
        });
        let largest = moments().max_by_key(|(_, shown)| shown.snapshot.len());
        let (at, n_bytes) = largest
            .map_or((StepPlace { episode: 0, step: 0 }, 0), |(at, shown)| {
                (at, shown.snapshot.len())
            });
        self.largest_snapshot = n_bytes;
        let actions = &env.spec().actions;
        let offsets = actions.offsets();
        let nothing_offered = moments().find_map(|(at, shown)| {
            let ended = shown.outcome.end.is_some();
            let mut heads = actions.heads.iter().zip(&offsets).filter(|_| !ended);
            let (head, _) =
                heads.find(|(head, offset)| shown.mask.of_head(**offset, head.n_choices) == 0)?;
            Some(EnvDefect::NothingOffered { head: head.name.clone(), at })
        });
        let bound = self.snapshot_bound;
        let too_large = EnvDefect::SnapshotTooLarge { n_bytes, bound, at };
        self.defects.extend(wrong_names(env));
        self.defects.extend(nothing_offered);
        self.defects.extend(odd);
        self.defects.extend((n_bytes > bound).then_some(too_large));
    }
}

/// Finds what the description counts otherwise than the specification.
fn wrong_names(env: &dyn Environment) -> Vec<EnvDefect> {
    let (spec, description) = (env.spec(), env.describe());
    let (n_named, obs_dim) = (description.observation.quantities().len(), spec.obs_dim);
    let list = |heads: Vec<(&String, usize)>| {
        let shown = heads.iter().map(|(name, n_choices)| format!("`{name}` {n_choices}"));
        shown.collect::<Vec<_>>().join(", ")
    };
    let described = description.actions.iter().map(|head| (&head.name, head.choices.len()));
    let specified = spec.actions.heads.iter().map(|head| (&head.name, head.n_choices));
    let (described, specified) = (list(described.collect()), list(specified.collect()));
    let quantities = EnvDefect::QuantitiesDiffer { n_named, obs_dim };
    let quantities = (n_named != obs_dim).then_some(quantities);
    let heads = (described != specified).then_some(EnvDefect::HeadsDiffer { described, specified });
    quantities.into_iter().chain(heads).collect()
}

/// Measures the rewards of the episodes without messages, and what a message costs.
fn rewards(played: &[Recording], env: &mut dyn Environment) -> RewardScale {
    let silent = played.iter().filter(|recording| is_silent(recording.episode));
    let sum = |recording: &Recording| -> f64 {
        recording.shown.iter().map(|shown| f64::from(shown.outcome.reward.abs())).sum()
    };
    let (mut total, mut n_steps, mut n_episodes) = (0.0, 0.0, 0.0);
    for recording in silent {
        total += sum(recording);
        n_steps += recording.actions.len() as f64;
        n_episodes += 1.0;
    }
    let cost = (0..N_EPISODES).filter_map(|episode| message_cost(env, episode)).reduce(f64::min);
    RewardScale {
        per_step: total / n_steps,
        per_episode: total / n_episodes,
        message_cost: cost.unwrap_or_default().max(0.0),
    }
}

/// Compares the first step of an episode with a message and without; none where no message can start.
fn message_cost(env: &mut dyn Environment, episode: u64) -> Option<f64> {
    let mut generator = Pcg64::seed_from_u64(SEED);
    let mut first = |speaks| {
        let mask = reset(env, episode).mask;
        let action = draw(&env.spec().actions, mask, speaks, &mut generator);
        (step(env, &action).outcome.reward, action)
    };
    let ((silent, _), (spoken, action)) = (first(Some(false)), first(Some(true)));
    let gate = env.spec().actions.gate?;
    let starts = usize::from(action[gate.head]) == gate.choice;
    starts.then(|| f64::from(silent) - f64::from(spoken))
}

fn is_silent(episode: u64) -> bool {
    episode % 3 == 1
}

/// Plays an episode in a fresh environment.
fn record(env: &mut dyn Environment, episode: u64) -> Recording {
    let mut generator = Pcg64::seed_from_u64(SEED + episode);
    let mut recording =
        Recording { episode, actions: Vec::new(), shown: vec![reset(env, episode)] };
    while let Some(now) = recording.shown.last()
        && now.outcome.end.is_none()
        && recording.actions.len() < MAX_STEPS
    {
        let silent = is_silent(episode).then_some(false);
        let mut action = draw(&env.spec().actions, now.mask, silent, &mut generator);
        if episode % 3 == 2 {
            env.baseline_action(SCRIPT, &mut action);
        }
        recording.shown.push(step(env, &action));
        recording.actions.push(action);
    }
    recording
}

/// Draws an action that is possible; `speaks` decides about the gate, where the mask leaves a choice.
fn draw(actions: &ActionSpec, mask: Mask, speaks: Option<bool>, generator: &mut Pcg64) -> Vec<u8> {
    let offsets = actions.offsets();
    let mut action = vec![0; actions.heads.len()];
    for head in 0..action.len() {
        let mut allowed = actions.allowed(head, &offsets, mask, &action);
        let gate = actions.gate.filter(|gate| gate.head == head).zip(speaks);
        if let Some((gate, speaks)) = gate {
            let start = 1 << gate.choice;
            let wanted = if speaks { allowed & start } else { allowed & !start };
            allowed = if wanted == 0 { allowed } else { wanted };
        }
        let choices: Vec<u8> = (0..64).filter(|choice| allowed >> choice & 1 == 1).collect();
        // What offers nothing is a defect, and is not to end the check.
        action[head] = if choices.is_empty() { 0 } else { choices[generator.below(choices.len())] };
    }
    action
}

/// Makes a buffer in which a value that is not written is found.
fn unwritten(env: &dyn Environment) -> Vec<f32> {
    vec![f32::NAN; env.spec().obs_dim]
}

fn reset(env: &mut dyn Environment, episode: u64) -> Shown {
    let mut observation = unwritten(env);
    env.reset(EpisodeSeed { run_seed: SEED, env_id: EnvId(0), episode }, &mut observation);
    Shown::of(env, observation, StepOutcome { reward: 0.0, end: None })
}

fn step(env: &mut dyn Environment, action: &[u8]) -> Shown {
    let mut observation = unwritten(env);
    let outcome = env.step(action, &mut observation);
    Shown::of(env, observation, outcome)
}

#[cfg(test)]
#[path = "env_check_tests.rs"]
mod tests;
