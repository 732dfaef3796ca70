//! What Python finds in `leadtime._native`.

use pyo3::prelude::*;

use crate::pair::Pair;
use crate::task;
use crate::vector::Worlds;
use crate::world::World;

/// The module `leadtime._native`: the part of the package that is written in Rust.
#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_function(wrap_pyfunction!(task::configurations, module)?)?;
    module.add_class::<Pair>()?;
    module.add_class::<World>()?;
    module.add_class::<Worlds>()
}
