//! Many environments in lockstep, with one call per step.

use std::sync::{Mutex, MutexGuard, PoisonError};

use leadtime_proto::EnvId;
use leadtime_sims::{End, Environment, EpisodeSeed};
use numpy::ndarray::Array2;
use numpy::{IntoPyArray as _, PyArray1, PyArray2, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::task::PlayedTask;
use crate::world::{check, n_choices, write_offered};

/// From so many environments on other threads of Python may run during a step.
const RELEASES_FROM: usize = 16;

/// Observations and what may be chosen in them. Shapes `[n, obs_dim]`, `[n, n_choices]`.
type ManyViews<'py> = (Bound<'py, PyArray2<f32>>, Bound<'py, PyArray2<i8>>);
/// What a step gave: observations, rewards, ended, cut short, what may be chosen, and for every episode that ended its
/// environment, final observation and metrics.
type ManySteps<'py> = (
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray1<f32>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray2<i8>>,
    Vec<(usize, Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<f32>>)>,
);

/// An episode that has ended.
struct EndedEpisode {
    env: usize,
    observation: Vec<f32>,
    metrics: Vec<f32>,
}

/// The environments with their next episodes.
struct Lanes {
    environments: Vec<Box<dyn Environment>>,
    run_seed: u64,
    episodes: Vec<u64>,
}

/// What a step gave, before Python gets it.
struct LanesStep {
    observations: Vec<f32>,
    rewards: Vec<f32>,
    terminated: Vec<bool>,
    truncated: Vec<bool>,
    offered: Vec<i8>,
    ended: Vec<EndedEpisode>,
}

impl Lanes {
    fn begin(&mut self, i: usize, observation: &mut [f32]) {
        let (run_seed, episode) = (self.run_seed, self.episodes[i]);
        let seed = EpisodeSeed { run_seed, env_id: EnvId(i as u32), episode };
        self.environments[i].reset(seed, observation);
        self.episodes[i] += 1;
    }

    fn offered(&self) -> Vec<i8> {
        let n_choices = self.environments[0].spec().actions.n_choices();
        let mut offered = vec![0; self.environments.len() * n_choices];
        for (environment, row) in self.environments.iter().zip(offered.chunks_exact_mut(n_choices))
        {
            write_offered(environment.as_ref(), row);
        }
        offered
    }

    /// Takes a step in each; one whose episode ends begins the next one at once.
    fn step(&mut self, actions: &[u8], n_heads: usize, obs_dim: usize) -> LanesStep {
        let n = self.environments.len();
        let mut step = LanesStep {
            observations: vec![0.0; n * obs_dim],
            rewards: vec![0.0; n],
            terminated: vec![false; n],
            truncated: vec![false; n],
            offered: Vec::new(),
            ended: Vec::new(),
        };
        let rows = step.observations.chunks_exact_mut(obs_dim);
        for (i, (observation, action)) in rows.zip(actions.chunks_exact(n_heads)).enumerate() {
            let outcome = self.environments[i].step(action, observation);
            step.rewards[i] = outcome.reward;
            step.terminated[i] = outcome.end == Some(End::Terminated);
            step.truncated[i] = outcome.end == Some(End::Truncated);
            if outcome.end.is_some() {
                let mut metrics = vec![0.0; self.environments[i].spec().metrics.len()];
                self.environments[i].metrics(&mut metrics);
                step.ended.push(EndedEpisode {
                    env: i,
                    observation: observation.to_vec(),
                    metrics,
                });
                self.begin(i, observation);
            }
        }
        step.offered = self.offered();
        step
    }
}

/// Many environments of one built-in world.
#[pyclass(module = "leadtime._native", frozen)]
pub(crate) struct Worlds {
    lanes: Mutex<Lanes>,
    n: usize,
    obs_dim: usize,
    /// The number of choices of every head.
    heads: Vec<usize>,
}

impl Worlds {
    fn lock(&self) -> MutexGuard<'_, Lanes> {
        self.lanes.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn table<'py, T: numpy::Element>(
        &self,
        py: Python<'py>,
        width: usize,
        flat: Vec<T>,
    ) -> PyResult<Bound<'py, PyArray2<T>>> {
        let table = Array2::from_shape_vec((self.n, width), flat);
        Ok(table.map_err(|error| PyValueError::new_err(error.to_string()))?.into_pyarray(py))
    }
}

#[pymethods]
impl Worlds {
    /// Makes so many environments of a configuration.
    #[new]
    fn new(config: &str, set: Vec<String>, evaluation: bool, n: usize) -> PyResult<Self> {
        if n == 0 {
            return Err(PyValueError::new_err("0 environments; allowed: at least 1"));
        }
        let task = PlayedTask::read(config, &set, evaluation)?;
        let environments = (0..n).map(|_| task.build()).collect::<PyResult<Vec<_>>>()?;
        let (obs_dim, heads) =
            (environments[0].spec().obs_dim, n_choices(environments[0].as_ref()));
        let lanes = Mutex::new(Lanes { environments, run_seed: 0, episodes: vec![0; n] });
        Ok(Self { lanes, n, obs_dim, heads })
    }

    /// Starts an episode in each: those of the run with this seed, from its first ones on, or its next ones without a seed.
    #[pyo3(signature = (seed=None))]
    fn reset<'py>(&self, py: Python<'py>, seed: Option<u64>) -> PyResult<ManyViews<'py>> {
        let mut lanes = self.lock();
        if let Some(seed) = seed {
            lanes.run_seed = seed;
            lanes.episodes.fill(0);
        }
        let mut observations = vec![0.0; self.n * self.obs_dim];
        for (i, observation) in observations.chunks_exact_mut(self.obs_dim).enumerate() {
            lanes.begin(i, observation);
        }
        let offered = lanes.offered();
        let offered = self.table(py, self.heads.iter().sum(), offered)?;
        Ok((self.table(py, self.obs_dim, observations)?, offered))
    }

    /// Takes one step in each. Shape of the actions: `[n, n_heads]`.
    fn step<'py>(
        &self,
        py: Python<'py>,
        actions: PyReadonlyArray2<'py, u8>,
    ) -> PyResult<ManySteps<'py>> {
        let actions: Vec<u8> = actions.as_array().iter().copied().collect();
        let n_heads = self.heads.len();
        if actions.len() != self.n * n_heads {
            let (found, n) = (actions.len(), self.n);
            let text = format!("{found} choices; allowed: {n} actions of {n_heads}");
            return Err(PyValueError::new_err(text));
        }
        actions.chunks_exact(n_heads).try_for_each(|action| check(&self.heads, action))?;
        // Locked and unlocked inside: who waits for the lock while Python waits for them would wait for ever.
        let step = || self.lock().step(&actions, n_heads, self.obs_dim);
        let step = if self.n >= RELEASES_FROM { py.detach(step) } else { step() };
        let ended = step
            .ended
            .into_iter()
            .map(|it| (it.env, it.observation.into_pyarray(py), it.metrics.into_pyarray(py)));
        Ok((
            self.table(py, self.obs_dim, step.observations)?,
            step.rewards.into_pyarray(py),
            step.terminated.into_pyarray(py),
            step.truncated.into_pyarray(py),
            self.table(py, self.heads.iter().sum(), step.offered)?,
            ended.collect(),
        ))
    }
}
