//! Many environments in lockstep, with one call per step.

use std::sync::Mutex;

use numpy::ndarray::ArrayView2;
use numpy::{
    Element, IntoPyArray as _, PyArray1, PyArray2, PyArrayDyn, PyArrayMethods as _,
    PyUntypedArrayMethods as _, ToPyArray as _,
};
use pyo3::exceptions::PyValueError;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::action::read_actions;
use crate::choices::n_choices;
use crate::info::{MetricNames, offering};
use crate::lanes::Lanes;
use crate::task::{PlayedTask, wrong};
use crate::world::attached;

/// From so many environments on other threads of Python may run during a step.
const RELEASES_FROM: usize = 16;

/// Observations, and what accompanies them. Shape `[n, obs_dim]`.
type ManyViews<'py> = (Bound<'py, PyArray2<f32>>, Bound<'py, PyDict>);
/// A step as Gymnasium has it for many: observations, rewards, who has ended, who was cut short, and what accompanies
/// them.
type ManySteps<'py> = (
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray1<f32>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyDict>,
);

/// Many environments of one built-in world.
#[pyclass(module = "leadtime._native", frozen)]
pub(crate) struct Worlds {
    lanes: Mutex<Lanes>,
    n: usize,
    /// The number of choices of every head.
    heads: Vec<usize>,
    metric_names: MetricNames,
    /// Says that something is reported of all environments. Shape `[n]`.
    everywhere: Py<PyArray1<bool>>,
}

impl Worlds {
    /// Returns a row per environment.
    fn table<'py, T: Element>(
        &self,
        py: Python<'py>,
        flat: &[T],
    ) -> PyResult<Bound<'py, PyArray2<T>>> {
        let shape = (self.n, flat.len() / self.n);
        Ok(ArrayView2::from_shape(shape, flat).map_err(wrong)?.to_pyarray(py))
    }

    /// Returns the observations, and says which choices are offered.
    fn views<'py>(&self, py: Python<'py>, lanes: &Lanes) -> PyResult<ManyViews<'py>> {
        let info = offering(py, self.table(py, &lanes.offered)?)?;
        info.set_item(intern!(py, "_action_mask"), &self.everywhere)?;
        Ok((self.table(py, &lanes.observations)?, info))
    }
}

#[pymethods]
impl Worlds {
    /// Makes so many environments of a configuration.
    #[new]
    fn new(
        py: Python<'_>,
        config: &str,
        set: Vec<String>,
        evaluation: bool,
        n: usize,
    ) -> PyResult<Self> {
        if n == 0 {
            return Err(PyValueError::new_err("0 environments; allowed: at least 1"));
        }
        let task = PlayedTask::read(config, &set, evaluation)?;
        let environments = (0..n).map(|_| task.build()).collect::<PyResult<Vec<_>>>()?;
        let metric_names = MetricNames::new(py, &environments[0].spec().metrics);
        let heads = n_choices(environments[0].as_ref());
        let lanes = Mutex::new(Lanes::new(environments));
        let everywhere = vec![true; n].into_pyarray(py).unbind();
        Ok(Self { lanes, n, heads, metric_names, everywhere })
    }

    /// Starts an episode in each: those of the run with this seed, from its first ones on, or its next ones without a seed.
    #[pyo3(signature = (seed=None))]
    fn reset<'py>(&self, py: Python<'py>, seed: Option<u64>) -> PyResult<ManyViews<'py>> {
        let mut guard = attached(&self.lanes, py);
        let lanes = &mut *guard;
        self.detached(py, || lanes.reset(seed));
        self.views(py, lanes)
    }

    /// Takes one step in each. Shape of the actions: `[n, n_heads]`, or `[n]` where there is one head.
    fn step<'py>(&self, py: Python<'py>, actions: &Bound<'py, PyAny>) -> PyResult<ManySteps<'py>> {
        let actions = self.actions(actions)?;
        let mut guard = attached(&self.lanes, py);
        let lanes = &mut *guard;
        self.detached(py, || lanes.step(&actions));
        let (observations, info) = self.views(py, lanes)?;
        if !lanes.ended.is_empty() {
            self.metric_names.tell_ends(&info, lanes)?;
        }
        Ok((
            observations,
            PyArray1::from_slice(py, &lanes.rewards),
            PyArray1::from_slice(py, &lanes.terminated),
            PyArray1::from_slice(py, &lanes.truncated),
            info,
        ))
    }
}

impl Worlds {
    /// Works without the interpreter where that is worth it.
    fn detached(&self, py: Python<'_>, work: impl Send + FnOnce()) {
        if self.n >= RELEASES_FROM { py.detach(work) } else { work() }
    }

    /// Reads the actions of all environments. Shape `[n, n_heads]`, or `[n]` where there is one head.
    fn actions(&self, given: &Bound<'_, PyAny>) -> PyResult<Vec<u8>> {
        if let Ok(array) = given.cast::<PyArrayDyn<i64>>() {
            // What Gymnasium's spaces draw.
            let array = array.readonly();
            if array.is_c_contiguous()
                && let Ok(numbers) = array.as_slice()
            {
                return read_actions(numbers, array.shape(), self.n, &self.heads);
            }
        }
        let py = given.py();
        let array = py.import("numpy")?.call_method1("asarray", (given,))?;
        let keywords = PyDict::new(py);
        keywords.set_item("casting", "same_kind")?;
        keywords.set_item("order", "C")?;
        let array = array.call_method("astype", ("int64",), Some(&keywords))?;
        let array = array.cast::<PyArrayDyn<i64>>()?;
        read_actions(&array.to_vec()?, array.shape(), self.n, &self.heads)
    }
}
