//! What the person names on the command line (plans, databases, directories), and whose fault it is if that fails.

use std::io;
use std::path::Path;

use anyhow::Context as _;
use leadtime_config::{Layer, Override};
use leadtime_proto::phrase::no_such;
use leadtime_runs::regular;
use leadtime_taxonomy::pipeline::error::BackendError;
use leadtime_taxonomy::pipeline::{DatabasePlan, PipelineError, job};
use leadtime_taxonomy::{Taxonomy, shipped};
use toml::Table;

use crate::cli::PlanArgs;
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
    Failure::of(code, anyhow::Error::msg(error.to_string()))
}

/// Reads the plan of a name or a file, and makes the changes of the command line.
pub(super) fn plan(args: &PlanArgs) -> Result<DatabasePlan, Failure> {
    let name = &args.plan;
    let named = is_shipped(name);
    if !named && !name.is_file() {
        return Err(Failure::input(unknown("plan", name)));
    }
    let plan = job::plan_or_file(name).map_err(|error| match error {
        // Says which file itself.
        PipelineError::File { .. } => failure(&error),
        _ if named => failure(&error),
        _ => Failure::input(format!("{}: {error}", name.display())),
    })?;
    if args.set.is_empty() {
        return Ok(plan);
    }
    let table = Table::try_from(plan).context("a plan can be written").map_err(Failure::from)?;
    let changes = args.set.iter().map(Layer::set);
    let plan: DatabasePlan =
        leadtime_config::read([Layer::table("the plan", &table)].into_iter().chain(changes))
            .blame(ExitCode::WrongInput)?;
    let keys: Vec<String> = args.set.iter().map(Override::key).collect();
    // Its sentence holds its causes; as causes they would be said twice.
    let refused = |error| Failure::input(format!("--set {}: {error}", keys.join(", ")));
    plan.check().map_err(refused)?;
    Ok(plan)
}

/// Reads the database of a file, or the shipped one of a domain.
pub(in crate::commands) fn database(name: &Path) -> Result<Taxonomy, Failure> {
    if let Some(domain) = shipped_domain(name) {
        return shipped(domain).blame(ExitCode::Failed);
    }
    let text = regular::read_to_string(name).map_err(|error| {
        if error.kind() == io::ErrorKind::NotFound {
            return Failure::input(unknown("database", name));
        }
        let told = format!("the database {} cannot be read", name.display());
        Failure::of(ExitCode::WrongInput, anyhow::Error::new(error).context(told))
    })?;
    job::database(&text).with_context(|| name.display().to_string()).blame(ExitCode::WrongInput)
}

/// Makes sure that a directory of the person's is one: what it lacks is taken from elsewhere, so a misspelt one would
/// go unnoticed.
pub(super) fn directory(option: &str, path: Option<&Path>) -> Result<(), Failure> {
    match path {
        Some(path) if !path.is_dir() => {
            Err(Failure::input(format!("{option} {}: there is no such directory", path.display())))
        }
        _ => Ok(()),
    }
}

/// Returns whether a plan and a database of that name come with the program.
pub(super) fn is_shipped(name: &Path) -> bool {
    shipped_domain(name).is_some()
}

fn shipped_domain(name: &Path) -> Option<&'static str> {
    shipped::domains().find(|&domain| name.as_os_str() == domain)
}

fn unknown(what: &str, name: &Path) -> String {
    no_such(
        &format!("file or shipped {what}"),
        &name.to_string_lossy(),
        shipped::domains().collect::<Vec<_>>(),
    )
}
