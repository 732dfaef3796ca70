//! What the person names on the command line (plans, databases, directories), and whose fault it is if that fails.

use std::path::Path;

use anyhow::Context as _;
use leadtime_taxonomy::pipeline::error::BackendError;
use leadtime_taxonomy::pipeline::{PipelineError, Plan, job};
use leadtime_taxonomy::{Taxonomy, shipped};

use crate::exit::{Blame as _, ExitCode, Failure};

/// Blames an error of the pipeline on the server, or on what the person gave.
pub(super) fn failure(error: &PipelineError) -> Failure {
    let code = match error {
        PipelineError::Backend(BackendError::Unreachable { .. } | BackendError::Refused { .. }) => {
            ExitCode::PeerLost
        }
        _ => ExitCode::WrongInput,
    };
    // Its sentence holds its causes; as causes they would be said twice.
    Failure { code, error: Some(anyhow::Error::msg(error.to_string())) }
}

/// Reads the plan of a name or a file.
///
/// # Errors
///
/// Wrong input: what there is, or the line of the file.
pub(super) fn plan(name: &str) -> Result<Plan, Failure> {
    let named = is_shipped(name);
    if !named && !Path::new(name).is_file() {
        return Err(Failure::input(format!(
            "`{name}` is neither a file nor a plan that comes with the program: {}",
            domains()
        )));
    }
    job::plan_or_file(name).map_err(|error| {
        if named { failure(&error) } else { Failure::input(format!("{name}: {error}")) }
    })
}

/// Reads the database of a file, or the shipped one of a domain.
///
/// # Errors
///
/// Wrong input: what there is, or which line or sentence of the file is wrong and how.
pub(in crate::commands) fn database(name: &str) -> Result<Taxonomy, Failure> {
    if is_shipped(name) {
        return shipped(name).blame(ExitCode::Failed);
    }
    let text = std::fs::read_to_string(name)
        .with_context(|| {
            let known = domains();
            format!(
                "`{name}` is neither a readable file nor a domain with shipped sentences: {known}"
            )
        })
        .blame(ExitCode::WrongInput)?;
    Taxonomy::from_toml(&text).with_context(|| name.to_owned()).blame(ExitCode::WrongInput)
}

/// Makes sure that a directory of the person's is one: what it lacks is taken from elsewhere, so a misspelt one would
/// go unnoticed.
///
/// # Errors
///
/// Wrong input, with the path.
pub(super) fn directory(option: &str, path: Option<&Path>) -> Result<(), Failure> {
    match path {
        Some(path) if !path.is_dir() => {
            Err(Failure::input(format!("{option} {}: there is no such directory", path.display())))
        }
        _ => Ok(()),
    }
}

fn is_shipped(name: &str) -> bool {
    shipped::domains().any(|domain| domain == name)
}

fn domains() -> String {
    shipped::domains().collect::<Vec<_>>().join(", ")
}
