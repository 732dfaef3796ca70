//! One environment for two: a notifier, and the person beside it.

use std::sync::Mutex;

use leadtime_proto::EnvId;
use leadtime_sims::{End, EpisodeSeed, TwoPlayers};
use numpy::{IntoPyArray as _, PyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::task::PlayedTask;
use crate::world::{check, n_choices, offered, unpoisoned};

/// The observations of the notifier and the person, and what the notifier may choose. Shapes `[obs_dim]`, `[person_dim]`,
/// `[n_choices]`.
type BothViews<'py> =
    (Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<i8>>);

/// A built-in world in which the person is played, too.
#[pyclass(module = "leadtime._native", frozen)]
pub(crate) struct Pair {
    both: Mutex<Box<dyn TwoPlayers>>,
    /// Length of what the person sees.
    person_dim: usize,
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
    fn new(config: &str, set: Vec<String>, evaluation: bool) -> PyResult<Self> {
        let both = PlayedTask::read(config, &set, evaluation)?.build_pair()?;
        let person_dim = both.person_quantities().len();
        Ok(Self { both: Mutex::new(both), person_dim })
    }

    /// The topics that the person can carry out.
    #[getter]
    fn topics(&self) -> Vec<&'static str> {
        unpoisoned(&self.both).topics().to_vec()
    }

    /// The numbers that the person sees: each with its name, its meaning, and its least and greatest value.
    #[getter]
    fn person_quantities(&self) -> Vec<(String, String, f32, f32)> {
        let all = unpoisoned(&self.both).person_quantities().into_iter();
        all.map(|it| (it.name, it.meaning, it.range[0], it.range[1])).collect()
    }

    /// Starts an episode: the one of this index of the run with this seed, in its environment 0.
    fn reset<'py>(&self, py: Python<'py>, seed: u64, episode: u64) -> BothViews<'py> {
        let mut both = unpoisoned(&self.both);
        let (mut notifier, mut person) = self.rows(both.as_ref());
        let seed = EpisodeSeed { run_seed: seed, env_id: EnvId(0), episode };
        both.reset(seed, &mut notifier, &mut person);
        views(py, both.as_ref(), notifier, person)
    }

    /// Takes one step: the notifier's choices, and the person's topic, or -1 for their own plan. Returns what both see, both
    /// rewards, and whether the episode has ended, or was cut short.
    fn step<'py>(
        &self,
        py: Python<'py>,
        action: Vec<i64>,
        topic: i64,
    ) -> PyResult<(BothViews<'py>, [f32; 2], [bool; 2])> {
        let mut both = unpoisoned(&self.both);
        check(&n_choices(both.notifier()), &action)?;
        let n_topics = both.topics().len();
        let topic = match usize::try_from(topic) {
            Err(_) if topic == -1 => None,
            Ok(topic) if topic < n_topics => Some(topic),
            _ => {
                let text = format!("topic {topic}; allowed: -1..{n_topics}");
                return Err(PyValueError::new_err(text));
            }
        };
        let action: Vec<u8> = action.into_iter().map(|choice| choice as u8).collect();
        let (mut notifier, mut person) = self.rows(both.as_ref());
        let shared = both.step(&action, topic, &mut notifier, &mut person);
        let ends = [End::Terminated, End::Truncated].map(|end| shared.end == Some(end));
        let rewards = [shared.notifier_reward, shared.person_reward];
        Ok((views(py, both.as_ref(), notifier, person), rewards, ends))
    }

    /// The metrics of the episode so far.
    fn metrics<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f32>> {
        let both = unpoisoned(&self.both);
        let mut metrics = vec![0.0; both.notifier().spec().metrics.len()];
        both.notifier().metrics(&mut metrics);
        metrics.into_pyarray(py)
    }
}

fn views<'py>(
    py: Python<'py>,
    both: &dyn TwoPlayers,
    notifier: Vec<f32>,
    person: Vec<f32>,
) -> BothViews<'py> {
    let offered = offered(both.notifier());
    (notifier.into_pyarray(py), person.into_pyarray(py), offered.into_pyarray(py))
}
