//! Actions as Python has them: a number, an array, a list.

use leadtime_proto::limits::MAX_HEADS;
use numpy::{PyArray1, PyArrayMethods as _, PyUntypedArray, PyUntypedArrayMethods as _};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyList, PyTuple};

/// A choice per head.
pub(crate) struct PythonAction {
    choices: [u8; MAX_HEADS],
    n_heads: usize,
}

impl PythonAction {
    /// Reads the action of one environment, whose heads have so many choices.
    ///
    /// # Errors
    ///
    /// `ValueError` unless it has one choice of each head.
    pub(crate) fn read(given: &Bound<'_, PyAny>, heads: &[usize]) -> PyResult<Self> {
        let mut action = Self { choices: [0; MAX_HEADS], n_heads: heads.len() };
        if action.take_in(given, heads)? { Ok(action) } else { Err(refused(given, heads)) }
    }

    /// Returns the choices. Shape `[n_heads]`.
    pub(crate) fn choices(&self) -> &[u8] {
        &self.choices[..self.n_heads]
    }

    /// Takes in what was given, and returns whether it fits.
    fn take_in(&mut self, given: &Bound<'_, PyAny>, heads: &[usize]) -> PyResult<bool> {
        if let Ok(array) = given.cast::<PyArray1<i64>>() {
            // What Gymnasium's spaces draw.
            let choice = |head| array.get_owned(head).unwrap_or(-1);
            return Ok(array.shape() == [heads.len()] && self.choose(heads, choice));
        }
        if given.is_instance_of::<PyUntypedArray>() {
            let plain = given.call_method0("tolist")?;
            return self.take_in(&plain, heads);
        }
        if given.is_instance_of::<PyList>() || given.is_instance_of::<PyTuple>() {
            let Ok(choices) = given.extract::<Vec<i64>>() else { return Ok(false) };
            return Ok(choices.len() == heads.len() && self.choose(heads, |head| choices[head]));
        }
        let Ok(choice) = given.extract::<i64>() else { return Ok(false) };
        Ok(heads.len() == 1 && self.choose(heads, |_head| choice))
    }

    /// Takes a choice of each head, and returns whether all of them can be taken.
    fn choose(&mut self, heads: &[usize], choice: impl Fn(usize) -> i64) -> bool {
        let mut head_choices = heads.iter().zip(&mut self.choices).enumerate();
        head_choices.all(|(head, (n_choices, taken))| {
            let given = choice(head);
            *taken = given as u8;
            is_one_of(given, *n_choices)
        })
    }
}

fn is_one_of(choice: i64, n_choices: usize) -> bool {
    usize::try_from(choice).is_ok_and(|choice| choice < n_choices)
}

/// Reads the actions of so many environments, head after head, from an array of whole numbers in the order of its rows.
/// Shape `[n, n_heads]`, or `[n]` where there is one head.
///
/// # Errors
///
/// `ValueError` unless there is one choice of each head for each environment.
pub(crate) fn read_actions(
    given: &[i64],
    shape: &[usize],
    n: usize,
    heads: &[usize],
) -> PyResult<Vec<u8>> {
    let n_heads = heads.len();
    // As many numbers in another shape, such as one row per head, would be read in the wrong order.
    let fits = shape == [n, n_heads] || (n_heads == 1 && shape == [n]);
    if !fits {
        let or_flat = if n_heads == 1 { format!(" or [{n}]") } else { String::new() };
        let text = format!("actions of shape {shape:?}; allowed: [{n}, {n_heads}]{or_flat}");
        return Err(PyValueError::new_err(text));
    }
    for action in given.chunks_exact(n_heads) {
        if !action.iter().zip(heads).all(|(choice, n_choices)| is_one_of(*choice, *n_choices)) {
            return Err(refused(format!("{action:?}"), heads));
        }
    }
    Ok(given.iter().map(|choice| *choice as u8).collect())
}

/// Says what an action may be.
fn refused(given: impl std::fmt::Display, heads: &[usize]) -> PyErr {
    let allowed: Vec<String> = heads.iter().map(|n_choices| format!("0..{n_choices}")).collect();
    let allowed = allowed.join(", ");
    PyValueError::new_err(format!("action {given}; allowed: one of each of [{allowed}]"))
}
