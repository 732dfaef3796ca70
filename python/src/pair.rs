//! One environment for two: a notifier, and its listener.

use std::sync::Mutex;

use leadtime_proto::EnvId;
use leadtime_sims::{End, EpisodeSeed, TwoPlayers};
use numpy::PyArray1;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::action::PythonAction;
use crate::choices::{n_choices, offered};
use crate::info::MetricNames;
use crate::task::PlayedTask;
use crate::world::attached;

/// The observations of the notifier and the listener, and what the notifier may choose. Shapes `[obs_dim]`,
/// `[person_dim]`, `[n_choices]`.
type BothViews<'py> =
    (Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<i8>>);

/// A built-in world in which the listener is played, too.
#[pyclass(module = "leadtime._native", frozen)]
pub(crate) struct Pair {
    both: Mutex<Box<dyn TwoPlayers>>,
    /// Length of what the listener sees.
    person_dim: usize,
    /// The number of choices of every head of the notifier.
    heads: Vec<usize>,
    metric_names: MetricNames,
}

impl Pair {
    /// Makes room for what both see.
    fn rows(&self, both: &dyn TwoPlayers) -> (Vec<f32>, Vec<f32>) {
        (vec![0.0; both.notifier().spec().obs_dim], vec![0.0; self.person_dim])
    }
}

#[pymethods]
impl Pair {
    /// Makes the environment of a configuration; the changes are `section.key=value`.
    #[new]
    fn new(py: Python<'_>, config: &str, set: Vec<String>, evaluation: bool) -> PyResult<Self> {
        let both = PlayedTask::read(config, &set, evaluation)?.build_pair()?;
        let (person_dim, heads) = (both.person_quantities().len(), n_choices(both.notifier()));
        let metric_names = MetricNames::new(py, &both.notifier().spec().metrics);
        Ok(Self { both: Mutex::new(both), person_dim, heads, metric_names })
    }

    /// The topics that the listener can carry out.
    #[getter]
    fn topics(&self, py: Python<'_>) -> Vec<&'static str> {
        attached(&self.both, py).topics().to_vec()
    }

    /// The numbers that the listener sees: each with its name, its meaning, and its least and greatest value.
    #[getter]
    fn person_quantities(&self, py: Python<'_>) -> Vec<(String, String, f32, f32)> {
        let all = attached(&self.both, py).person_quantities().into_iter();
        all.map(|it| (it.name, it.meaning, it.range[0], it.range[1])).collect()
    }

    /// Starts an episode: the one of this index of the run with this seed, in its environment 0.
    fn reset<'py>(&self, py: Python<'py>, seed: u64, episode: u64) -> BothViews<'py> {
        let mut both = attached(&self.both, py);
        let (mut notifier, mut person) = self.rows(both.as_ref());
        let seed = EpisodeSeed { run_seed: seed, env_id: EnvId(0), episode };
        both.reset(seed, &mut notifier, &mut person);
        views(py, both.as_ref(), notifier, person)
    }

    /// Takes one step: the notifier's choices, and the listener's topic, or -1 for their own plan. Returns what both
    /// see, both rewards, and whether the episode has ended, or was cut short.
    fn step<'py>(
        &self,
        py: Python<'py>,
        action: &Bound<'py, PyAny>,
        topic: i64,
    ) -> PyResult<(BothViews<'py>, [f32; 2], [bool; 2])> {
        let action = PythonAction::read(action, &self.heads)?;
        let mut both = attached(&self.both, py);
        let n_topics = both.topics().len();
        let topic = match usize::try_from(topic) {
            Err(_) if topic == -1 => None,
            Ok(topic) if topic < n_topics => Some(topic),
            _ => {
                let text = format!("topic {topic}; allowed: -1..{n_topics}");
                return Err(PyValueError::new_err(text));
            }
        };
        let (mut notifier, mut person) = self.rows(both.as_ref());
        let shared = both.step(action.choices(), topic, &mut notifier, &mut person);
        let ends = [End::Terminated, End::Truncated].map(|end| shared.end == Some(end));
        let rewards = [shared.notifier_reward, shared.person_reward];
        Ok((views(py, both.as_ref(), notifier, person), rewards, ends))
    }

    /// What is reported at the end of an episode.
    fn ending<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let both = attached(&self.both, py);
        let mut metrics = vec![0.0; both.notifier().spec().metrics.len()];
        both.notifier().metrics(&mut metrics);
        drop(both);
        let info = PyDict::new(py);
        self.metric_names.tell_end(&info, &metrics)?;
        Ok(info)
    }
}

fn views<'py>(
    py: Python<'py>,
    both: &dyn TwoPlayers,
    notifier: Vec<f32>,
    person: Vec<f32>,
) -> BothViews<'py> {
    let [notifier, person] = [notifier, person].map(|seen| PyArray1::from_vec(py, seen));
    (notifier, person, offered(py, both.notifier()))
}
