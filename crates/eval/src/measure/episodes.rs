//! Playing many episodes, several at a time.
//!
//! Episode i of an evaluation is the same whoever plays beside it: its world, person and action draws come from
//! streams named by (evaluation seed, i), and a policy's rows do not influence each other. So neither the number
//! of lanes nor that of threads changes a result, and two players meet the same worlds.

use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;

use leadtime_numerics::{Pcg64, Purpose};
use leadtime_proto::EnvId;
use leadtime_sims::{End, Environment, EpisodeSeed, TaskError};
use serde::{Deserialize, Serialize};

use super::player::{Acting, Player};
use crate::error::Error;

/// Makes one more environment of the task.
pub type MakeEnvironment<'a> = dyn Fn() -> Result<Box<dyn Environment>, TaskError> + Sync + 'a;

/// How many episodes, and how they are played.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EvaluateSettings {
    /// Number of episodes.
    pub n_episodes: u64,
    /// Seed of the evaluation; part of every stream's name.
    pub seed: u64,
    /// Episodes played side by side in a thread, so that a network sees batches.
    pub n_lanes: usize,
    /// Threads; the results do not depend on it.
    pub n_threads: usize,
    /// An episode that takes longer is reported as endless.
    pub max_steps: u64,
}

impl EvaluateSettings {
    /// Plans `n_episodes` on one thread.
    pub fn new(n_episodes: u64, seed: u64) -> Self {
        Self { n_episodes, seed, n_lanes: 16, n_threads: 1, max_steps: 100_000 }
    }

    /// Spreads the work over threads.
    pub fn threads(self, n_threads: usize) -> Self {
        Self { n_threads, ..self }
    }
}

/// What one episode gave.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Episode {
    /// Sum of raw rewards.
    pub total_reward: f64,
    /// Number of steps.
    pub n_steps: u64,
    /// A time limit ended it.
    pub truncated: bool,
    /// The task's metrics, in the order of [`Evaluation::metrics`].
    pub metrics: Vec<f32>,
}

/// What a player did in a number of episodes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// The player's name.
    pub player: String,
    /// Seed of the evaluation.
    pub seed: u64,
    /// Names of the task's metrics.
    pub metrics: Vec<String>,
    /// The episodes in order.
    pub episodes: Vec<Episode>,
}

impl Evaluation {
    /// Returns one of the task's metrics for every episode; `None` if there is no such metric.
    pub fn column(&self, name: &str) -> Option<Vec<f64>> {
        let place = self.metrics.iter().position(|metric| metric == name)?;
        Some(self.episodes.iter().map(|episode| f64::from(episode.metrics[place])).collect())
    }

    /// Adds a metric that is computed from the episodes afterwards; a value that is no number is undefined.
    ///
    /// # Shapes
    ///
    /// `values`: one per episode; an episode without one has none.
    pub fn with_column(mut self, name: &str, values: &[f32]) -> Self {
        self.metrics.push(name.to_owned());
        let values = values.iter().copied().chain(std::iter::repeat(f32::NAN));
        for (episode, value) in self.episodes.iter_mut().zip(values) {
            episode.metrics.push(value);
        }
        self
    }
}

/// Names the streams of the `index`-th episode of an evaluation.
///
/// Every episode is the first one of an environment of its own, so that a task which varies by environment shows
/// all its variants.
pub fn episode_seed(seed: u64, index: u64) -> EpisodeSeed {
    EpisodeSeed { run_seed: seed, env_id: EnvId(index as u32), episode: index >> 32 }
}

/// Plays episodes and returns what each gave.
///
/// # Errors
///
/// [`Error::Task`] if an environment cannot be made, [`Error::PolicyShape`] or [`Error::UnknownBaseline`] if the
/// player cannot play it, [`Error::Endless`] if an episode does not end.
pub fn evaluate(
    make: &MakeEnvironment<'_>,
    player: &Player,
    settings: &EvaluateSettings,
) -> Result<Evaluation, Error> {
    let probe = make()?;
    player.check(probe.as_ref())?;
    let next = AtomicU64::new(0);
    let work = || Worker::new(player, settings, &next).run(make);
    let episodes = in_threads(settings.n_threads, &work)?;
    Ok(Evaluation {
        player: player.name().to_owned(),
        seed: settings.seed,
        metrics: probe.spec().metrics.clone(),
        episodes,
    })
}

/// What some episodes gave, with their numbers.
pub(crate) type Numbered<T> = Vec<(u64, T)>;

/// Lets threads work until there is nothing left to do, and puts what they found in the order of the episodes.
///
/// # Errors
///
/// The first one of a thread, or [`Error::Thread`].
pub(crate) fn in_threads<T: Send>(
    n_threads: usize,
    work: &(dyn Fn() -> Result<Numbered<T>, Error> + Sync),
) -> Result<Vec<T>, Error> {
    let mut all = if n_threads <= 1 { work()? } else { gathered(n_threads, work)? };
    all.sort_unstable_by_key(|(index, _)| *index);
    Ok(all.into_iter().map(|(_, found)| found).collect())
}

fn gathered<T: Send>(
    n_threads: usize,
    work: &(dyn Fn() -> Result<Numbered<T>, Error> + Sync),
) -> Result<Numbered<T>, Error> {
    thread::scope(|scope| {
        let start = |i: usize| {
            let name = format!("evaluate-{i}");
            thread::Builder::new().name(name).spawn_scoped(scope, work).map_err(Error::Thread)
        };
        let threads: Vec<_> = (0..n_threads).map(start).collect::<Result<_, _>>()?;
        let mut all = Vec::new();
        for thread in threads {
            // A panic in a thread is a bug; it goes on in the caller.
            let part = thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            all.extend(part?);
        }
        Ok(all)
    })
}

/// One episode in progress.
struct Lane {
    environment: Box<dyn Environment>,
    index: u64,
    generator: Pcg64,
    total_reward: f64,
    n_steps: u64,
}

/// Plays episodes from a shared counter until there are no more.
struct Worker<'a> {
    settings: &'a EvaluateSettings,
    next: &'a AtomicU64,
    acting: Acting,
    recurrent_dim: usize,
    lanes: Vec<Lane>,
    /// `[n_lanes, D]`.
    observations: Vec<f32>,
    /// `[n_lanes, S]`.
    recurrent: Vec<f32>,
    done: Numbered<Episode>,
}

impl<'a> Worker<'a> {
    fn new(player: &Player, settings: &'a EvaluateSettings, next: &'a AtomicU64) -> Self {
        Self {
            settings,
            next,
            acting: Acting::new(player),
            recurrent_dim: player.recurrent_dim(),
            lanes: Vec::new(),
            observations: Vec::new(),
            recurrent: Vec::new(),
            done: Vec::new(),
        }
    }

    fn run(mut self, make: &MakeEnvironment<'_>) -> Result<Numbered<Episode>, Error> {
        while self.lanes.len() < self.settings.n_lanes.max(1) {
            let Some(index) = self.take() else { break };
            let environment = make()?;
            let (obs_dim, n) = (environment.spec().obs_dim, self.lanes.len() + 1);
            self.observations.resize(n * obs_dim, 0.0);
            self.recurrent.resize(n * self.recurrent_dim, 0.0);
            self.lanes.push(Lane::new(environment));
            self.begin(n - 1, index);
        }
        while !self.lanes.is_empty() {
            self.step()?;
        }
        Ok(self.done)
    }

    fn take(&self) -> Option<u64> {
        let index = self.next.fetch_add(1, Ordering::Relaxed);
        (index < self.settings.n_episodes).then_some(index)
    }

    fn begin(&mut self, row: usize, index: u64) {
        let lane = &mut self.lanes[row];
        let obs_dim = lane.environment.spec().obs_dim;
        let observation = &mut self.observations[row * obs_dim..(row + 1) * obs_dim];
        lane.begin(self.settings.seed, index, observation);
        self.recurrent[row * self.recurrent_dim..(row + 1) * self.recurrent_dim].fill(0.0);
    }

    /// Takes a step in every lane; a lane whose episode ended takes the next one or goes.
    fn step(&mut self) -> Result<(), Error> {
        let n = self.lanes.len();
        self.acting.think(&self.observations, &mut self.recurrent, n);
        let mut ended = Vec::new();
        for (row, lane) in self.lanes.iter_mut().enumerate() {
            let obs_dim = lane.environment.spec().obs_dim;
            let observation = &mut self.observations[row * obs_dim..(row + 1) * obs_dim];
            if let Some(episode) = lane.step(row, &self.acting, observation) {
                self.done.push((lane.index, episode));
                ended.push(row);
            } else if lane.n_steps >= self.settings.max_steps {
                return Err(Error::Endless { index: lane.index, n_steps: lane.n_steps });
            }
        }
        // From the back, so that removing a row leaves the rows before it in place.
        for row in ended.into_iter().rev() {
            match self.take() {
                Some(index) => self.begin(row, index),
                None => self.remove(row),
            }
        }
        Ok(())
    }

    fn remove(&mut self, row: usize) {
        let obs_dim = self.lanes[row].environment.spec().obs_dim;
        self.lanes.remove(row);
        self.observations.drain(row * obs_dim..(row + 1) * obs_dim);
        self.recurrent.drain(row * self.recurrent_dim..(row + 1) * self.recurrent_dim);
    }
}

impl Lane {
    fn new(environment: Box<dyn Environment>) -> Self {
        let generator = Pcg64::seed_from_u64(0);
        Self { environment, index: 0, generator, total_reward: 0.0, n_steps: 0 }
    }

    fn begin(&mut self, seed: u64, index: u64, observation: &mut [f32]) {
        let streams = episode_seed(seed, index);
        self.environment.reset(streams, observation);
        self.generator = streams.stream(Purpose::Act);
        (self.index, self.total_reward, self.n_steps) = (index, 0.0, 0);
    }

    fn step(&mut self, row: usize, acting: &Acting, observation: &mut [f32]) -> Option<Episode> {
        let mut action = vec![0; self.environment.spec().actions.heads.len()];
        acting.choose(row, self.environment.as_ref(), &mut self.generator, &mut action);
        let outcome = self.environment.step(&action, observation);
        self.total_reward += f64::from(outcome.reward);
        self.n_steps += 1;
        let end = outcome.end?;
        let mut metrics = vec![0.0; self.environment.spec().metrics.len()];
        self.environment.metrics(&mut metrics);
        let truncated = end == End::Truncated;
        Some(Episode { total_reward: self.total_reward, n_steps: self.n_steps, truncated, metrics })
    }
}

#[cfg(test)]
#[path = "episodes_tests.rs"]
mod tests;
