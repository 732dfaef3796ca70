//! What may be chosen: how many choices there are, and which of them are offered.

use leadtime_proto::Mask;
use leadtime_proto::limits::MAX_CHOICES;
use leadtime_sims::Environment;
use numpy::PyArray1;
use pyo3::prelude::*;

/// Returns the number of choices of every head.
pub(crate) fn n_choices(environment: &dyn Environment) -> Vec<usize> {
    environment.spec().actions.heads.iter().map(|head| head.n_choices).collect()
}

/// Returns what may be chosen now. Shape `[n_choices]`.
pub(crate) fn offered<'py>(
    py: Python<'py>,
    environment: &dyn Environment,
) -> Bound<'py, PyArray1<i8>> {
    let mut offered = [0; MAX_CHOICES];
    let offered = &mut offered[..environment.spec().actions.n_choices()];
    write_offered(environment.mask(), offered);
    PyArray1::from_slice(py, offered)
}

/// Writes a mask as 1 or 0 per choice, head after head. Shape `[n_choices]`.
pub(crate) fn write_offered(Mask(bits): Mask, offered: &mut [i8]) {
    for (choice, offered) in offered.iter_mut().enumerate() {
        *offered = (bits >> choice.min(MAX_CHOICES - 1) & 1) as i8;
    }
}
