//! One environment, as Gymnasium has it.

use std::sync::{Mutex, MutexGuard, PoisonError};

use leadtime_proto::EnvId;
use leadtime_sims::{End, Environment, EpisodeSeed};
use numpy::ndarray::Array3;
use numpy::{IntoPyArray as _, PyArray1, PyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::sync::MutexExt as _;
use pyo3::types::{PyBytes, PyDict};

use crate::action::PythonAction;
use crate::choices::{n_choices, offered};
use crate::film::Film;
use crate::info::{MetricNames, offering};
use crate::task::{PlayedTask, wrong};

/// An observation, and what accompanies it. Shape `[obs_dim]`.
type OneView<'py> = (Bound<'py, PyArray1<f32>>, Bound<'py, PyDict>);
/// A step as Gymnasium has it: observation, reward, whether the episode has ended, or was cut short, and what
/// accompanies it.
type OneStep<'py> = (Bound<'py, PyArray1<f32>>, f64, bool, bool, Bound<'py, PyDict>);

/// A built-in world, stepped by itself.
#[pyclass(module = "leadtime._native", frozen)]
pub(crate) struct World {
    domain: String,
    /// The number of choices of every head.
    heads: Vec<usize>,
    metric_names: MetricNames,
    played: Mutex<Played>,
}

/// What changes while it is played.
struct Played {
    environment: Box<dyn Environment>,
    /// The newest observation. Shape `[obs_dim]`.
    observation: Vec<f32>,
    /// What is kept for drawing, where that is wanted.
    film: Option<Film>,
}

impl Played {
    fn film(&self) -> PyResult<&Film> {
        let nothing = || PyValueError::new_err("nothing is kept to be drawn: call `film` first");
        self.film.as_ref().ok_or_else(nothing)
    }

    fn metrics(&self) -> Vec<f32> {
        let mut metrics = vec![0.0; self.environment.spec().metrics.len()];
        self.environment.metrics(&mut metrics);
        metrics
    }

    /// Shows the present moment.
    fn view<'py>(&self, py: Python<'py>) -> PyResult<OneView<'py>> {
        let info = offering(py, offered(py, self.environment.as_ref()))?;
        Ok((PyArray1::from_slice(py, &self.observation), info))
    }
}

impl World {
    fn lock(&self, py: Python<'_>) -> MutexGuard<'_, Played> {
        attached(&self.played, py)
    }
}

/// Locks, and lets other threads of Python run where that takes a while. What a panic has left is an environment that has to
/// be reset, as after any error.
pub(crate) fn attached<'a, T>(mutex: &'a Mutex<T>, py: Python<'_>) -> MutexGuard<'a, T> {
    mutex.lock_py_attached(py).unwrap_or_else(PoisonError::into_inner)
}

#[pymethods]
impl World {
    /// Makes the environment of a configuration; the changes are `section.key=value`.
    #[new]
    fn new(py: Python<'_>, config: &str, set: Vec<String>, evaluation: bool) -> PyResult<Self> {
        let task = PlayedTask::read(config, &set, evaluation)?;
        let environment = task.build()?;
        let spec = environment.spec();
        let metric_names = MetricNames::new(py, &spec.metrics);
        let observation = vec![0.0; spec.obs_dim];
        let heads = n_choices(environment.as_ref());
        let played = Mutex::new(Played { environment, observation, film: None });
        Ok(Self { domain: task.domain().to_owned(), heads, metric_names, played })
    }

    /// Keeps what is needed to draw, from the next episode on.
    fn film(&self, py: Python<'_>) -> PyResult<()> {
        let mut played = self.lock(py);
        played.film = Some(Film::new(&self.domain, played.environment.as_ref())?);
        Ok(())
    }

    /// Draws the present moment. Shape `[height, width, 3]`.
    fn picture<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let drawn = self.lock(py).film()?.picture()?;
        let shape = (drawn.height, drawn.width, 3);
        Ok(Array3::from_shape_vec(shape, drawn.rgb).map_err(wrong)?.into_pyarray(py))
    }

    /// Says what the listener hears and does now.
    fn caption(&self, py: Python<'_>) -> PyResult<String> {
        self.lock(py).film()?.caption()
    }

    /// Length of an observation.
    #[getter]
    fn obs_dim(&self, py: Python<'_>) -> usize {
        self.lock(py).observation.len()
    }

    /// The heads of an action: each with its name and those of its choices.
    #[getter]
    fn heads(&self, py: Python<'_>) -> Vec<(String, Vec<String>)> {
        let heads = self.lock(py).environment.describe().actions.into_iter();
        heads.map(|head| (head.name, head.choices)).collect()
    }

    /// The numbers of an observation: each with its name, its meaning, and its least and greatest value.
    #[getter]
    fn quantities(&self, py: Python<'_>) -> Vec<(String, String, f32, f32)> {
        let description = self.lock(py).environment.describe();
        let all = description.observation.quantities().into_iter();
        all.map(|it| (it.name, it.meaning, it.range[0], it.range[1])).collect()
    }

    /// The parts of the reward: each with when it is paid, how much, and the setting that holds it.
    #[getter]
    fn rewards(&self, py: Python<'_>) -> Vec<(String, f64, String)> {
        let all = self.lock(py).environment.describe().rewards.into_iter();
        all.map(|it| (it.when, it.amount, it.key)).collect()
    }

    /// Names of an episode's metrics.
    #[getter]
    fn metric_names(&self, py: Python<'_>) -> Vec<String> {
        self.lock(py).environment.spec().metrics.clone()
    }

    /// Names of the scripted policies.
    #[getter]
    fn baselines(&self, py: Python<'_>) -> Vec<&'static str> {
        self.lock(py).environment.baselines().to_vec()
    }

    /// Starts an episode: the one of this index of the run with this seed, in its environment 0.
    fn reset<'py>(&self, py: Python<'py>, seed: u64, episode: u64) -> PyResult<OneView<'py>> {
        let mut played = self.lock(py);
        let Played { environment, observation, film } = &mut *played;
        let named = EpisodeSeed { run_seed: seed, env_id: EnvId(0), episode };
        environment.reset(named, observation);
        if let Some(film) = film {
            film.begin(seed, episode, environment.as_ref());
        }
        played.view(py)
    }

    /// Takes one step, with a choice per head.
    fn step<'py>(&self, py: Python<'py>, action: &Bound<'py, PyAny>) -> PyResult<OneStep<'py>> {
        let action = PythonAction::read(action, &self.heads)?;
        let mut played = self.lock(py);
        let Played { environment, observation, film } = &mut *played;
        let outcome = environment.step(action.choices(), observation);
        if let Some(film) = film {
            film.step(outcome, environment.as_ref());
        }
        let (seen, info) = played.view(py)?;
        if outcome.end.is_some() {
            self.metric_names.tell_end(&info, &played.metrics())?;
        }
        let [terminated, truncated] =
            [End::Terminated, End::Truncated].map(|end| outcome.end == Some(end));
        Ok((seen, f64::from(outcome.reward), terminated, truncated, info))
    }

    /// What may be chosen now, 1 or 0 per choice, head after head. Shape `[n_choices]`.
    fn offered<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i8>> {
        offered(py, self.lock(py).environment.as_ref())
    }

    /// The metrics of the episode so far.
    fn metrics<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f32>> {
        self.lock(py).metrics().into_pyarray(py)
    }

    /// The action that a scripted policy takes now.
    fn baseline(&self, py: Python<'_>, name: &str) -> PyResult<Vec<u8>> {
        let played = self.lock(py);
        let mut action = vec![0; self.heads.len()];
        if played.environment.baseline_action(name, &mut action) {
            return Ok(action);
        }
        let known = played.environment.baselines().join(", ");
        Err(PyValueError::new_err(format!("there is no script `{name}`; there are: {known}")))
    }

    /// Everything that the rest of the episode depends on.
    fn snapshot<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        let mut bytes = Vec::new();
        self.lock(py).environment.snapshot(&mut bytes);
        PyBytes::new(py, &bytes)
    }

    /// Continues from a snapshot, bit for bit.
    fn restore<'py>(&self, py: Python<'py>, snapshot: &[u8]) -> PyResult<OneView<'py>> {
        let mut played = self.lock(py);
        let Played { environment, observation, film } = &mut *played;
        environment.restore(snapshot, observation).map_err(wrong)?;
        if let Some(film) = film {
            film.begin(0, 0, environment.as_ref());
        }
        played.view(py)
    }
}
