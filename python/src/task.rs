//! Which task an environment plays: a built-in configuration or a file, with changes.

use std::fs;
use std::io;
use std::path::Path;

use leadtime_config::{Catalog, Config, ConfigSource, Layer, Override};
use leadtime_proto::TaskSpec;
use leadtime_proto::phrase::{no_such, with_causes};
use leadtime_sims::{Environment, Registry, TwoPlayers};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Names the built-in configurations.
#[pyfunction]
pub(crate) fn configurations() -> Vec<String> {
    Catalog::built_in().names().map(str::to_owned).collect()
}

/// A task, and what builds its environments.
pub(crate) struct PlayedTask {
    registry: Registry,
    spec: TaskSpec,
}

impl PlayedTask {
    /// Reads a configuration (a file, or the name of a built-in one) with changes `section.key=value`; the task is that of
    /// training, or that of evaluation.
    ///
    /// # Errors
    ///
    /// `ValueError` if the configuration or a setting cannot be read, or a value is impossible: with the key, what was
    /// given and what is allowed.
    pub(crate) fn read(config: &str, set: &[String], evaluation: bool) -> PyResult<Self> {
        let registry = leadtime_worlds::builtin();
        let catalog = Catalog::built_in();
        let set = set.iter().map(|text| Override::parse(text)).collect::<Result<_, _>>();
        let set = set.map_err(PyValueError::new_err)?;
        let place = format!("configuration {config}");
        // A pipe would keep its reader waiting for ever.
        let is_other = fs::metadata(config).is_ok_and(|found| !found.is_file());
        let not_one = || Err(io::Error::new(io::ErrorKind::InvalidInput, "it is not a file"));
        let text = if is_other { not_one() } else { fs::read_to_string(config) };
        let (file, text) = match text {
            Ok(text) => (Layer::text(place.clone(), text.clone()), Some(text)),
            Err(error) => (built_in(config, &error, &catalog)?, None),
        };
        let source = ConfigSource { file: Some(file), set, ..ConfigSource::default() };
        let read = Config::load(&source, &catalog, &registry);
        // A policy's own configuration may be older than this program, and is read as the program reads it.
        let stored = |text: &String| Config::stored(&place, text, &source.set, &registry).ok();
        let read =
            read.or_else(|error| text.as_ref().and_then(stored).ok_or(error)).map_err(wrong)?;
        let spec = if evaluation { read.evaluation.task } else { read.task };
        Ok(Self { registry, spec })
    }

    pub(crate) fn domain(&self) -> &str {
        &self.spec.domain
    }

    /// Builds an environment for two.
    ///
    /// # Errors
    ///
    /// `ValueError` if a setting is impossible, or nobody in the task listens.
    pub(crate) fn build_pair(&self) -> PyResult<Box<dyn TwoPlayers>> {
        let nobody = || {
            let text = format!("`{}` has no listener who could be played", self.spec.domain);
            PyValueError::new_err(text)
        };
        self.registry.build_pair(&self.spec).map_err(wrong)?.ok_or_else(nobody)
    }

    /// Builds an environment.
    ///
    /// # Errors
    ///
    /// `ValueError` if a setting is out of its range, or does not fit another one.
    pub(crate) fn build(&self) -> PyResult<Box<dyn Environment>> {
        self.registry.build(&self.spec).map_err(wrong)
    }
}

fn built_in(name: &str, error: &io::Error, catalog: &Catalog) -> PyResult<Layer> {
    if let Some(layer) = catalog.file(name) {
        return Ok(layer);
    }
    if Path::new(name).exists() {
        return Err(PyValueError::new_err(format!("reading {name}: {error}")));
    }
    let names: Vec<&str> = catalog.names().collect();
    Err(PyValueError::new_err(no_such("file or configuration", name, names)))
}

/// Makes Python's error of one of ours, with its causes.
pub(crate) fn wrong(error: impl std::error::Error) -> PyErr {
    PyValueError::new_err(with_causes(&error))
}
