//! A learner and actors on this machine, over a unix socket in a short temporary directory.

use std::ffi::OsString;
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use leadtime_config::Config;
use leadtime_proto::RunName;
use thiserror::Error;
use tokio::time::sleep;
use tokio_util::sync::CancellationToken;
use tracing::info;

use crate::RunDirError;
use crate::learner_config::is_crowded;
use crate::naming::{Naming, Reservation};
use crate::placement::Placement;
use crate::scratch::ScratchDir;
use crate::supervise::{Ended, ProcessPlan, supervise};

/// How long a learner may take to end after its supervisor was killed: a little longer than [`crate::supervise::GRACE`].
const ORPHAN_PATIENCE: Duration = Duration::from_secs(6);
/// Pause between two looks at whether it has.
const ORPHAN_PAUSE: Duration = Duration::from_millis(50);

/// What to launch beside the configuration.
#[derive(Clone)]
pub struct Launch<'a> {
    /// Whether a run goes on or a new one begins.
    pub naming: Naming<'a>,
    /// How many actors are started beside the learner.
    pub n_actors: u32,
    /// Further addresses for the learner.
    pub listen: &'a [String],
    /// Options of the learner that say whom it lets in there.
    pub guard: &'a [OsString],
    /// The run or file whose weights a new run starts from.
    pub fork: Option<&'a Path>,
    /// After how many updates or steps the run stops with a checkpoint, as the learner's `--stop-after` has it.
    pub stop_after: Option<String>,
    /// After what time it does, however often its learner is started meanwhile.
    pub stop_in: Option<Duration>,
    /// Settings that change in a run that goes on: `KEY=VALUE`, the learner's `--change`.
    pub changes: Vec<String>,
    /// A command that gets every update's metrics, the learner's `--metrics-to`.
    pub metrics_to: Option<&'a str>,
    /// The file to whose end every process writes where its time goes.
    pub trace: Option<&'a Path>,
    /// Which CPUs learner and actors keep to.
    pub placement: Placement,
    /// Where the learner serves its status.
    pub status: Option<&'a str>,
    /// Whether the learner's results go to standard output.
    pub learner_stdout: bool,
    /// Whether they are JSON.
    pub json: bool,
    /// File that collects what the processes log, instead of standard error.
    pub stderr_log: Option<PathBuf>,
    /// Further options of every process: how much it logs.
    pub options: &'a [OsString],
    /// Told where the learner will be reached, before it is started.
    pub observer: Option<&'a LearnerPlace>,
}

/// Takes in an address of a run's learner, its name, and its directory.
pub type LearnerPlace = dyn Fn(&str, &RunName, &Path) + Send + Sync;

impl fmt::Debug for Launch<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Launch({:?}, {} actors)", self.naming, self.n_actors)
    }
}

impl<'a> Launch<'a> {
    /// Describes a launch that is seen only in its run's files.
    pub fn new(naming: Naming<'a>, n_actors: u32) -> Self {
        Self {
            naming,
            n_actors,
            listen: &[],
            guard: &[],
            fork: None,
            stop_after: None,
            stop_in: None,
            changes: Vec::new(),
            metrics_to: None,
            trace: None,
            placement: Placement::default(),
            status: None,
            learner_stdout: false,
            json: false,
            stderr_log: None,
            options: &[],
            observer: None,
        }
    }
}

/// A launch that has come to its end.
#[derive(Clone, Debug)]
pub struct Launched {
    /// Directory of the run.
    pub run: PathBuf,
    /// How it ended.
    pub ended: Ended,
}

/// Why nothing can be launched.
#[derive(Debug, Error)]
pub enum LaunchError {
    /// The run would wait for ever: nobody else can join where only this program's actors know the address.
    #[error(
        "`run.actors_min` is {n_needed} and --actors is {n_actors}, so the run would never start; allowed: at least \
         {n_needed} actors, or a --listen address where others can join"
    )]
    TooFewActors {
        /// Actors that the run needs.
        n_needed: u32,
        /// Actors that were asked for.
        n_actors: u32,
    },
    /// The run's directory cannot be used.
    #[error(transparent)]
    RunDir(#[from] RunDirError),
    /// A temporary directory or a file in it cannot be made.
    #[error("cannot write {}", path.display())]
    Scratch {
        /// Where it was tried.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The learner cannot be started.
    #[error("starting the learner")]
    Start(#[source] io::Error),
}

/// Reserves a run, and waits for a learner whose supervisor was killed; `None` if it is asked to stop meanwhile.
async fn reserve(
    config: &Config,
    naming: &Naming<'_>,
    shutdown: &CancellationToken,
) -> Result<Option<Reservation>, RunDirError> {
    let deadline = Instant::now() + ORPHAN_PATIENCE;
    let mut is_told = false;
    loop {
        let name = match Reservation::make(config, naming) {
            Err(RunDirError::Orphaned(name)) if Instant::now() < deadline => name,
            made => return made.map(Some),
        };
        if !std::mem::replace(&mut is_told, true) {
            info!("the supervisor of run `{name}` was killed: waiting for its learner to end");
        }
        tokio::select! {
            () = shutdown.cancelled() => return Ok(None),
            () = sleep(ORPHAN_PAUSE) => {}
        }
    }
}

/// Runs learner and actors as child processes until the learner ends.
///
/// # Errors
///
/// [`LaunchError`] if nothing was started.
pub async fn launch(
    config: &Config,
    launch: &Launch<'_>,
    shutdown: &CancellationToken,
) -> Result<Launched, LaunchError> {
    let (n_actors, n_needed) = (launch.n_actors, config.run.actors_min);
    if n_actors < n_needed && launch.listen.is_empty() {
        return Err(LaunchError::TooFewActors { n_needed, n_actors });
    }
    let naming = match launch.naming {
        // A fork is a new run.
        Naming::Resume if launch.fork.is_some() && config.run.name.is_none() => {
            Naming::New(config.domain.as_str())
        }
        naming => naming,
    };
    let Some(reserved) = reserve(config, &naming, shutdown).await? else {
        return Ok(Launched { run: config.run.directory.clone(), ended: Ended::Stopped(None) });
    };
    let failed = |(path, source)| LaunchError::Scratch { path, source };
    let scratch = ScratchDir::make().map_err(failed)?;
    let endpoint = format!("unixsock-stream/{}", scratch.path().join("learner.sock").display());
    let plan = plan(config, launch, &reserved, scratch.path(), &endpoint).map_err(failed)?;
    if let Some(observer) = launch.observer {
        observer(&endpoint, &reserved.name, &reserved.path);
    }
    let ended = supervise(&plan, shutdown).await.map_err(LaunchError::Start)?;
    Ok(Launched { run: plan.run, ended })
}

fn plan(
    config: &Config,
    launch: &Launch<'_>,
    reserved: &Reservation,
    scratch: &Path,
    endpoint: &str,
) -> Result<ProcessPlan, (PathBuf, io::Error)> {
    let file = scratch.join("config.toml");
    std::fs::write(&file, config.table.to_string()).map_err(|error| (file.clone(), error))?;
    let text = |words: &[&str]| words.iter().map(OsString::from).collect::<Vec<_>>();
    let mut learner = text(&["learner", "--supervised", "--name", reserved.name.as_str()]);
    learner.extend(text(&["--listen", endpoint]));
    let n_beside = if launch.placement.is_shared() { launch.n_actors as usize } else { 0 };
    learner.extend(text(&["--local-actors", &n_beside.to_string()]));
    learner.extend(launch.options.iter().cloned());
    // Not through the file, and not as text: a path need not be text.
    let paths = [("-c", &*file), ("--scratch", scratch), ("--runs", &config.run.directory)];
    for (option, path) in paths.into_iter().chain(launch.fork.map(|fork| ("--fork", fork))) {
        learner.extend([option.into(), path.as_os_str().to_owned()]);
    }
    for extra in launch.listen {
        learner.extend(text(&["--listen", extra]));
    }
    learner.extend(launch.guard.iter().cloned());
    if launch.json {
        learner.push("--json".into());
    }
    if let Some(stop_after) = &launch.stop_after {
        learner.extend(text(&["--stop-after", stop_after]));
    }
    for change in &launch.changes {
        learner.extend(text(&["--change", change]));
    }
    if let Some(command) = launch.metrics_to {
        learner.extend(text(&["--metrics-to", command]));
    }
    if let Some(address) = launch.status {
        learner.extend(text(&["--status", address]));
    }
    let trace: Vec<OsString> =
        launch.trace.iter().flat_map(|file| ["--trace".into(), file.into()]).collect();
    learner.extend(trace.iter().cloned());
    let yields: &[&str] = if is_crowded(config, n_beside) { &["--yields-to-learner"] } else { &[] };
    let actor = |number: u32| {
        let id = format!("actor-{number}");
        // The configuration is this user's own, and so is the learner.
        let own = ["actor", "--supervised", "--connect", endpoint, "--id", &id, "--trust-worker"];
        [text(&own), text(yields), launch.options.to_vec(), trace.clone()].concat()
    };
    Ok(ProcessPlan {
        learner,
        actors: (1..=launch.n_actors).map(actor).collect(),
        placement: launch.placement.clone(),
        run: reserved.path.clone(),
        n_updates: config.learner.n_updates(),
        // A time that no clock knows is none.
        stop_at: launch.stop_in.and_then(|time| Instant::now().checked_add(time)),
        others_may_join: !launch.listen.is_empty(),
        learner_stdout: launch.learner_stdout,
        stderr_log: launch.stderr_log.clone(),
    })
}
