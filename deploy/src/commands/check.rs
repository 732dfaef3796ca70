//! `leadtime check`: would it work here?

use std::path::Path;
use std::thread::available_parallelism;
use std::time::Duration;

use anyhow::Context as _;
use leadtime_certs::Role;
use leadtime_config::{Config, Override};
use leadtime_link::ObserverLink;
use leadtime_proto::TaskSpec;
use leadtime_proto::phrase::counted;
use leadtime_runs::{Tasks, build};
use leadtime_sims::env_check::check_environment;
use leadtime_sims::registry::{self, WorldOnly};
use leadtime_table::wrapped;
use leadtime_worker::{PythonSettings, check_worker};

use crate::cli::CheckArgs;
use crate::credentials::{connect_settings, is_wrong_input};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output::{self, WIDTH};
use crate::threads;

/// A round trip that limits nobody.
const SHORT_TRIP: Duration = Duration::from_millis(5);

pub(super) async fn run(tasks: &Tasks, args: &CheckArgs) -> Result<(), Failure> {
    let worker = args.worker.iter().map(|command| Override::new("world.worker", command.as_str()));
    let source = args.source.changed(&worker.collect::<Vec<_>>());
    let config = source.load(tasks, None).blame(ExitCode::WrongInput)?;
    let (domain, n_updates, n_envs) =
        (&config.domain, config.learner.n_updates(), config.learner.n_envs);
    let (updates, envs) = (counted(n_updates, "update"), counted(n_envs, "environment"));
    report("configuration", &format!("domain {domain}, {updates}, {envs}"));
    config.rounded_steps().iter().for_each(|rounded| report("notice", rounded));
    let (obs_dim, heads) = (config.env.obs_dim, &config.env.actions.heads);
    let heads: Vec<String> =
        heads.iter().map(|head| format!("{} {}", head.name, head.n_choices)).collect();
    report("task", &format!("{obs_dim} inputs, heads: {}", heads.join(", ")));
    let mut n_defects = play(tasks, &config.task).blame(ExitCode::WrongInput)?;
    n_defects += compare_workers(tasks, &config.task).blame(ExitCode::WrongInput)?;
    if config.evaluation.task != config.task {
        report("evaluation", "its task differs from that of training");
        n_defects += play(tasks, &config.evaluation.task).blame(ExitCode::WrongInput)?;
    }
    let cores = available_parallelism().map_or(1, usize::from);
    let (cpu, n_threads) = (build::cpu_class(), threads::configured());
    let cores = counted(cores, "core");
    report("machine", &format!("{cores}, {cpu}, numeric threads: {n_threads}"));
    writable(&config).blame(ExitCode::WrongInput)?;
    report("runs", &format!("{} can be written", config.run.directory.display()));
    if !args.connect.is_empty() {
        let (runs, round_trip) = look(args).await?;
        report("learner", &format!("runs at {}: {}", args.connect.join(", "), runs.join(", ")));
        if let Some(time) = round_trip {
            report("round trip", &advice(time));
        }
    }
    if n_defects > 0 {
        let error = format!("domain {domain} has defects: its runs are not reproducible, or fail");
        return Err(Failure::of(ExitCode::Failed, anyhow::Error::msg(error)));
    }
    Ok(())
}

/// Says how long the way is, and, where that limits a run, which lag makes up for it.
///
/// An update needs rollouts that were made with the weights of `lag` updates before. Weights and rollouts take a round trip
/// each, so `lag` updates take two round trips at least.
fn advice(round_trip: Duration) -> String {
    let shown = format!("{:.1} ms", round_trip.as_secs_f64() * 1e3);
    if round_trip < SHORT_TRIP {
        return shown;
    }
    let rate = 1.0 / (2.0 * round_trip.as_secs_f64());
    let (one, eight) = (rate, 8.0 * rate);
    format!(
        "{shown}: with learner.lag = 1 at most {one:.0} updates a second, with 8 at most {eight:.0}; same seed, same bits as well"
    )
}

/// Has two workers of a world in Python take the same steps, if it is one; returns the number of defects.
fn compare_workers(tasks: &Tasks, task: &TaskSpec) -> anyhow::Result<usize> {
    if task.domain != leadtime_worker::DOMAIN {
        return Ok(0);
    }
    let settings: WorldOnly<PythonSettings> =
        registry::read(leadtime_worker::DOMAIN, &task.settings)?;
    let found = check_worker(&tasks.workers, &settings.world)?;
    report("packages", &found.versions.join(", "));
    let n_steps = found.n_steps;
    if found.defects.is_empty() {
        report("workers", &format!("two processes, {n_steps} steps, equal in every byte"));
    }
    found.defects.iter().for_each(|defect| report("defect", defect));
    Ok(found.defects.len())
}

/// Plays a task, and prints what it showed; returns the number of defects.
fn play(tasks: &Tasks, task: &TaskSpec) -> anyhow::Result<usize> {
    if !tasks.registry.build(task)?.is_restorable() {
        report("played", "not at all: an environment that moves begins an episode");
        return Ok(0);
    }
    let found = check_environment(|| tasks.registry.build(task))?;
    let (episodes, steps, restored) = (found.n_episodes, found.n_steps, found.n_restored);
    report("played", &format!("{episodes} episodes, {steps} steps, restored {restored} times"));
    let (largest, bound) = (found.largest_snapshot, found.snapshot_bound);
    report("snapshots", &format!("up to {largest} bytes, at most {bound} promised"));
    report("rewards", &found.rewards.to_string());
    found.rewards.notice().iter().for_each(|notice| report("notice", notice));
    found.defects.iter().for_each(|defect| report("defect", &defect.to_string()));
    Ok(found.defects.len())
}

fn report(what: &str, finding: &str) {
    const COLUMN: usize = 15;
    let text = wrapped(&format!("{:COLUMN$}{finding}", ""), WIDTH, COLUMN);
    output::line(&format!("{what:<COLUMN$}{}", text.trim_start()));
}

/// Makes sure that a run could be made, without leaving anything behind.
fn writable(config: &Config) -> anyhow::Result<()> {
    let wanted = &config.run.directory;
    let there = wanted.ancestors().find(|path| path.exists());
    let directory = there.filter(|path| !path.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let refused = || format!("`run.directory` {}: nothing can be written there", wanted.display());
    tempfile::tempfile_in(directory).with_context(refused).map(|_file| ())
}

/// Lists the runs at an address, and measures the way to the first one's learner, as far as we may ask it.
async fn look(args: &CheckArgs) -> Result<(Vec<String>, Option<Duration>), Failure> {
    let settings = connect_settings(&args.connect, &args.tls, args.connect_timeout, &Role::ALL);
    let settings = settings.blame(ExitCode::WrongInput)?;
    let failure = |error| {
        let is_input = is_wrong_input(&error);
        Failure::of(if is_input { ExitCode::WrongInput } else { ExitCode::PeerLost }, error)
    };
    let (link, _events) = ObserverLink::open(&settings).await.map_err(failure)?;
    let runs = link.runs().await.blame(ExitCode::PeerLost)?;
    let mut round_trip = None;
    if let Some(run) = runs.first() {
        round_trip = link.round_trip(run).await.ok();
    }
    link.close().await.blame(ExitCode::PeerLost)?;
    if runs.is_empty() {
        let at = args.connect.join(", ");
        let error = anyhow::anyhow!("someone answers at {at}, but no learner is there");
        return Err(Failure::of(ExitCode::PeerLost, error));
    }
    Ok((runs.iter().map(ToString::to_string).collect(), round_trip))
}
