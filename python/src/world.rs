//! One environment.

use std::fmt::Debug;
use std::sync::{Mutex, MutexGuard, PoisonError};

use leadtime_proto::{EnvId, Mask};
use leadtime_sims::{End, Environment, EpisodeSeed};
use numpy::ndarray::Array3;
use numpy::{IntoPyArray as _, PyArray1, PyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::film::Film;
use crate::task::{PlayedTask, wrong};

/// An observation and what may be chosen in it. Shapes `[obs_dim]`, `[n_choices]`.
type OneView<'py> = (Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<i8>>);
/// The same after a step, with its reward, and whether the episode has ended, or was cut short.
type OneStep<'py> = (Bound<'py, PyArray1<f32>>, f32, bool, bool, Bound<'py, PyArray1<i8>>);

/// A built-in world.
#[pyclass(module = "leadtime._native", frozen)]
pub(crate) struct World {
    domain: String,
    environment: Mutex<Box<dyn Environment>>,
    /// What is kept for drawing, where that is wanted. Locked after the environment.
    film: Mutex<Option<Film>>,
}

impl World {
    fn lock(&self) -> MutexGuard<'_, Box<dyn Environment>> {
        unpoisoned(&self.environment)
    }

    fn filmed<T>(&self, of: impl FnOnce(&Film) -> PyResult<T>) -> PyResult<T> {
        let nothing = || PyValueError::new_err("nothing is kept to be drawn: call `film` first");
        unpoisoned(&self.film).as_ref().ok_or_else(nothing).and_then(of)
    }
}

/// Locks. What a panic has left is an environment that has to be reset, as after any error.
pub(crate) fn unpoisoned<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[pymethods]
impl World {
    /// Makes the environment of a configuration; the changes are `section.key=value`.
    #[new]
    fn new(config: &str, set: Vec<String>, evaluation: bool) -> PyResult<Self> {
        let task = PlayedTask::read(config, &set, evaluation)?;
        let (domain, environment) = (task.domain().to_owned(), Mutex::new(task.build()?));
        Ok(Self { domain, environment, film: Mutex::new(None) })
    }

    /// Keeps what is needed to draw, from the next episode on.
    fn film(&self) -> PyResult<()> {
        let environment = self.lock();
        *unpoisoned(&self.film) = Some(Film::new(&self.domain, environment.as_ref())?);
        Ok(())
    }

    /// Draws the present moment. Shape `[height, width, 3]`.
    fn picture<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let drawn = self.filmed(Film::picture)?;
        let shape = (drawn.height, drawn.width, 3);
        Ok(Array3::from_shape_vec(shape, drawn.rgb).map_err(wrong)?.into_pyarray(py))
    }

    /// Says what the person hears and does now.
    fn caption(&self) -> PyResult<String> {
        self.filmed(Film::caption)
    }

    /// Length of an observation.
    #[getter]
    fn obs_dim(&self) -> usize {
        self.lock().spec().obs_dim
    }

    /// The heads of an action: each with its name and those of its choices.
    #[getter]
    fn heads(&self) -> Vec<(String, Vec<String>)> {
        let heads = self.lock().describe().actions.into_iter();
        heads.map(|head| (head.name, head.choices)).collect()
    }

    /// The numbers of an observation: each with its name, its meaning, and its least and greatest value.
    #[getter]
    fn quantities(&self) -> Vec<(String, String, f32, f32)> {
        let all = self.lock().describe().observation.quantities().into_iter();
        all.map(|it| (it.name, it.meaning, it.range[0], it.range[1])).collect()
    }

    /// The parts of the reward: each with when it is paid, how much, and the setting that holds it.
    #[getter]
    fn rewards(&self) -> Vec<(String, f64, String)> {
        let all = self.lock().describe().rewards.into_iter();
        all.map(|it| (it.when, it.amount, it.key)).collect()
    }

    /// Names of an episode's metrics.
    #[getter]
    fn metric_names(&self) -> Vec<String> {
        self.lock().spec().metrics.clone()
    }

    /// Names of the scripted policies.
    #[getter]
    fn baselines(&self) -> Vec<&'static str> {
        self.lock().baselines().to_vec()
    }

    /// Starts an episode: the one of this index of the run with this seed, in its environment 0.
    fn reset<'py>(&self, py: Python<'py>, seed: u64, episode: u64) -> OneView<'py> {
        let mut environment = self.lock();
        let mut observation = vec![0.0; environment.spec().obs_dim];
        let named = EpisodeSeed { run_seed: seed, env_id: EnvId(0), episode };
        environment.reset(named, &mut observation);
        if let Some(film) = unpoisoned(&self.film).as_mut() {
            film.begin(seed, episode, environment.as_ref());
        }
        (observation.into_pyarray(py), offered(environment.as_ref()).into_pyarray(py))
    }

    /// Takes one step, with a choice per head.
    fn step<'py>(&self, py: Python<'py>, action: Vec<i64>) -> PyResult<OneStep<'py>> {
        let mut environment = self.lock();
        check(&n_choices(environment.as_ref()), &action)?;
        let action: Vec<u8> = action.into_iter().map(|choice| choice as u8).collect();
        let mut observation = vec![0.0; environment.spec().obs_dim];
        let outcome = environment.step(&action, &mut observation);
        if let Some(film) = unpoisoned(&self.film).as_mut() {
            film.step(outcome, environment.as_ref());
        }
        let [terminated, truncated] =
            [End::Terminated, End::Truncated].map(|end| outcome.end == Some(end));
        let offered = offered(environment.as_ref()).into_pyarray(py);
        Ok((observation.into_pyarray(py), outcome.reward, terminated, truncated, offered))
    }

    /// The metrics of the episode so far.
    fn metrics<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f32>> {
        let environment = self.lock();
        let mut metrics = vec![0.0; environment.spec().metrics.len()];
        environment.metrics(&mut metrics);
        metrics.into_pyarray(py)
    }

    /// The action that a scripted policy takes now.
    fn baseline(&self, name: &str) -> PyResult<Vec<u8>> {
        let environment = self.lock();
        let mut action = vec![0; environment.spec().actions.heads.len()];
        if environment.baseline_action(name, &mut action) {
            return Ok(action);
        }
        let known = environment.baselines().join(", ");
        Err(PyValueError::new_err(format!("there is no script `{name}`; there are: {known}")))
    }

    /// Everything that the rest of the episode depends on.
    fn snapshot<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        let mut bytes = Vec::new();
        self.lock().snapshot(&mut bytes);
        PyBytes::new(py, &bytes)
    }

    /// Continues from a snapshot, bit for bit.
    fn restore<'py>(&self, py: Python<'py>, snapshot: &[u8]) -> PyResult<OneView<'py>> {
        let mut environment = self.lock();
        let mut observation = vec![0.0; environment.spec().obs_dim];
        environment.restore(snapshot, &mut observation).map_err(wrong)?;
        if let Some(film) = unpoisoned(&self.film).as_mut() {
            film.begin(0, 0, environment.as_ref());
        }
        Ok((observation.into_pyarray(py), offered(environment.as_ref()).into_pyarray(py)))
    }
}

/// Refuses an action that has not one choice of each of these heads.
pub(crate) fn check<T: Copy + Debug>(heads: &[usize], action: &[T]) -> PyResult<()>
where
    i64: From<T>,
{
    let is_one_of = |(&choice, &n_choices): (&T, &usize)| {
        usize::try_from(i64::from(choice)).is_ok_and(|choice| choice < n_choices)
    };
    let fits = action.len() == heads.len() && action.iter().zip(heads).all(is_one_of);
    if fits {
        return Ok(());
    }
    let allowed: Vec<String> = heads.iter().map(|n_choices| format!("0..{n_choices}")).collect();
    let allowed = allowed.join(", ");
    Err(PyValueError::new_err(format!("action {action:?}; allowed: one of each of [{allowed}]")))
}

/// Returns the number of choices of every head.
pub(crate) fn n_choices(environment: &dyn Environment) -> Vec<usize> {
    environment.spec().actions.heads.iter().map(|head| head.n_choices).collect()
}

/// Returns what may be chosen now. Shape `[n_choices]`.
pub(crate) fn offered(environment: &dyn Environment) -> Vec<i8> {
    let mut offered = vec![0; environment.spec().actions.n_choices()];
    write_offered(environment, &mut offered);
    offered
}

/// Writes what may be chosen now, 1 or 0 per choice, head after head. Shape `[n_choices]`.
pub(crate) fn write_offered(environment: &dyn Environment, offered: &mut [i8]) {
    let Mask(bits) = environment.mask();
    for (choice, offered) in offered.iter_mut().enumerate() {
        *offered = (bits >> choice.min(63) & 1) as i8;
    }
}
