//! What accompanies an observation, in the form that Gymnasium has for it: for one environment, and for many.

use std::iter;

use numpy::{Element, PyArray1};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString};

use crate::lanes::Lanes;

/// The metric that says whether an episode succeeded.
const SUCCESS: &str = "success";

/// Says which choices are offered.
pub(crate) fn offering<'py>(
    py: Python<'py>,
    offered: impl IntoPyObject<'py>,
) -> PyResult<Bound<'py, PyDict>> {
    let info = PyDict::new(py);
    info.set_item(intern!(py, "action_mask"), offered)?;
    Ok(info)
}

/// The names of an episode's metrics, as Python has them.
pub(crate) struct MetricNames {
    /// Each, and what says in a vector which environments it is about.
    names: Vec<[Py<PyString>; 2]>,
    success: Option<usize>,
}

impl MetricNames {
    pub(crate) fn new(py: Python<'_>, names: &[String]) -> Self {
        let both = |name: &String| {
            [name.clone(), format!("_{name}")].map(|name| PyString::new(py, &name).unbind())
        };
        let success = names.iter().position(|name| name == SUCCESS);
        Self { names: names.iter().map(both).collect(), success }
    }

    /// Adds what is reported at the end of an episode.
    pub(crate) fn tell_end(&self, info: &Bound<'_, PyDict>, metrics: &[f32]) -> PyResult<()> {
        let py = info.py();
        let named = PyDict::new(py);
        for ([name, _], value) in self.names.iter().zip(metrics) {
            named.set_item(name, f64::from(*value))?;
        }
        info.set_item(intern!(py, "metrics"), named)?;
        if let Some(success) = self.success {
            info.set_item(intern!(py, "success"), metrics[success] != 0.0)?;
        }
        Ok(())
    }

    /// Adds what is reported about the episodes that have ended in a vector.
    pub(crate) fn tell_ends(&self, info: &Bound<'_, PyDict>, lanes: &Lanes) -> PyResult<()> {
        let (py, n, ended) = (info.py(), lanes.rewards.len(), &lanes.ended);
        let mut last = Vec::with_capacity(n);
        last.resize_with(n, || py.None());
        for (&lane, observation) in ended.iter().zip(lanes.last.chunks_exact(lanes.obs_dim)) {
            last[lane] = PyArray1::from_slice(py, observation).into_any().unbind();
        }
        let whom = spread(py, n, ended, iter::repeat(true));
        let (named, final_info) = (PyDict::new(py), PyDict::new(py));
        for (metric, [name, of_whom]) in self.names.iter().enumerate() {
            let values = lanes.metrics.iter().skip(metric).step_by(self.names.len());
            named.set_item(name, spread(py, n, ended, values.clone().map(|it| f64::from(*it))))?;
            named.set_item(of_whom, &whom)?;
            if self.success == Some(metric) {
                let succeeded = spread(py, n, ended, values.map(|value| *value != 0.0));
                final_info.set_item(intern!(py, "success"), succeeded)?;
                final_info.set_item(intern!(py, "_success"), &whom)?;
            }
        }
        final_info.set_item(intern!(py, "metrics"), named)?;
        final_info.set_item(intern!(py, "_metrics"), &whom)?;
        info.set_item(intern!(py, "final_obs"), PyArray1::from_vec(py, last))?;
        info.set_item(intern!(py, "_final_obs"), &whom)?;
        info.set_item(intern!(py, "final_info"), final_info)?;
        info.set_item(intern!(py, "_final_info"), whom)
    }
}

/// Returns an array with a value for each of `n` environments, of which only some have one. Shape `[n]`.
fn spread<'py, T: Element + Copy + Default>(
    py: Python<'py>,
    n: usize,
    whom: &[usize],
    values: impl Iterator<Item = T>,
) -> Bound<'py, PyArray1<T>> {
    let mut all = vec![T::default(); n];
    whom.iter().zip(values).for_each(|(&env, value)| all[env] = value);
    PyArray1::from_slice(py, &all)
}
