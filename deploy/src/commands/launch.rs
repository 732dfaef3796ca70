//! A learner and actors on this machine, over a unix socket in a short temporary directory.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use leadtime_proto::RunName;
use tempfile::TempDir;
use tokio_util::sync::CancellationToken;

use crate::cli::RunChoice;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::supervise::{Plan, supervise};
use leadtime_config::Config;

/// The longest temporary directory that leaves room for a socket's name (the kernel allows 107 bytes in all).
const MAX_TEMP_DIR: usize = 60;

/// What to launch beside the configuration.
#[derive(Debug)]
pub(super) struct Launch<'a> {
    /// The run.
    pub(super) name: &'a RunName,
    /// How many actors.
    pub(super) n_actors: u32,
    /// Further addresses for the learner.
    pub(super) listen: &'a [String],
    /// What else was said about the run.
    pub(super) choice: &'a RunChoice,
    /// Whether the learner's results go to standard output.
    pub(super) learner_talks: bool,
    /// Where the processes' talk is appended, instead of on standard error.
    pub(super) log: Option<PathBuf>,
}

/// Runs learner and actors as child processes until the learner ends.
pub(super) async fn launch(
    config: &Config,
    launch: &Launch<'_>,
    shutdown: &CancellationToken,
) -> Result<(), Failure> {
    enough_actors(config, launch).blame(ExitCode::WrongInput)?;
    let directory = short_temp_dir().blame(ExitCode::WrongInput)?;
    let plan = plan(config, launch, directory.path()).blame(ExitCode::WrongInput)?;
    supervise(&plan, shutdown).await
}

/// Refuses a run that would wait for ever: nobody else can join where only this program's actors know the address.
fn enough_actors(config: &Config, launch: &Launch<'_>) -> anyhow::Result<()> {
    let (n_actors, n_needed) = (launch.n_actors, config.run.actors_min);
    anyhow::ensure!(
        n_actors >= n_needed || !launch.listen.is_empty(),
        "`run.actors_min` is {n_needed} and --actors is {n_actors}, so the run would never start; allowed: at least \
         {n_needed} actors, or a --listen address where others can join"
    );
    Ok(())
}

fn short_temp_dir() -> anyhow::Result<TempDir> {
    let preferred = std::env::temp_dir();
    let fits = preferred.as_os_str().len() <= MAX_TEMP_DIR;
    let base = if fits { preferred.as_path() } else { Path::new("/tmp") };
    tempfile::Builder::new()
        .prefix("leadtime-")
        .tempdir_in(base)
        .with_context(|| format!("making a temporary directory in {}", base.display()))
}

fn plan(config: &Config, launch: &Launch<'_>, directory: &Path) -> anyhow::Result<Plan> {
    let file = directory.join("config.toml");
    std::fs::write(&file, config.table.to_string())
        .with_context(|| format!("writing {}", file.display()))?;
    let endpoint = format!("unixsock-stream/{}", directory.join("learner.sock").display());
    let text = |words: &[&str]| words.iter().map(OsString::from).collect::<Vec<_>>();
    let mut learner = text(&["learner", "--supervised", "--name", launch.name.as_str(), "-c"]);
    learner.push(file.into_os_string());
    // The file is text, and a path need not be.
    learner.push("--runs".into());
    learner.push(config.run.directory.clone().into_os_string());
    learner.extend(text(&["--listen", &endpoint, "--scratch"]));
    learner.push(directory.as_os_str().to_owned());
    for extra in launch.listen {
        learner.extend(text(&["--listen", extra]));
    }
    if let Some(fork) = &launch.choice.fork {
        learner.extend(text(&["--fork", fork]));
    }
    if let Some(updates) = launch.choice.stop_after {
        learner.extend(text(&["--stop-after", &updates.to_string()]));
    }
    let actor = |number: u32| {
        let id = format!("actor-{number}");
        text(&["actor", "--supervised", "--connect", &endpoint, "--id", &id])
    };
    let actors = (1..=launch.n_actors).map(actor).collect();
    let (learner_talks, log) = (launch.learner_talks, launch.log.clone());
    Ok(Plan { learner, actors, learner_talks, log })
}
