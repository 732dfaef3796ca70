//! `leadtime check`: would it work here?

use std::path::Path;
use std::time::Duration;

use anyhow::Context as _;
use leadtime_certs::Role;
use leadtime_config::{Config, Override};
use leadtime_link::{ConnectSettings, ObserverLink};
use leadtime_proto::limits::MAX_LAG;
use leadtime_proto::phrase::counted;
use leadtime_proto::{RunName, TaskSpec};
use leadtime_runs::{Tasks, build, clock};
use leadtime_sims::env_check::check_environment;
use leadtime_sims::registry::{self, WorldOnly};
use leadtime_table::wrapped;
use leadtime_watch::{Attachment, Page};
use leadtime_worker::{PythonSettings, check_worker};
use serde_json::Value;

use crate::cli::CheckArgs;
use crate::credentials::{connect_settings, dialling_failure};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output::{self, WIDTH};
use crate::threads;

/// A round trip that limits nobody.
const SHORT_TRIP: Duration = Duration::from_millis(5);

pub(super) async fn run(tasks: &Tasks, args: &CheckArgs) -> Result<(), Failure> {
    let worker =
        |command: &String| Override::new("world.worker", command.as_str()).given_by("--worker");
    let source = args.source.changed(&args.worker.iter().map(worker).collect::<Vec<_>>());
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
    let (cpu, n_threads) = (build::cpu_class(), threads::configured());
    let cores = counted(build::n_cores(), "core");
    report("machine", &format!("{cores}, {cpu}, numeric threads: {n_threads}"));
    writable(&config).blame(ExitCode::WrongInput)?;
    report("runs", &format!("{} can be written", config.run.directory.display()));
    if !args.connect.is_empty() {
        let (runs, line) = look(args).await?;
        report("learner", &format!("runs at {}: {}", args.connect.join(", "), runs.join(", ")));
        if let Some(line) = line {
            report("round trip", &line.advice());
        }
    }
    if n_defects > 0 {
        let error = format!("domain {domain} has defects: its runs are not reproducible, or fail");
        return Err(Failure::of(ExitCode::Failed, anyhow::Error::msg(error)));
    }
    Ok(())
}

/// The way to a learner, and how long its updates take.
#[derive(Clone, Copy, Debug)]
struct LearnerLine {
    round_trip: Duration,
    /// How long an update trains; `None` where that could not be asked.
    update: Option<Duration>,
}

impl LearnerLine {
    /// Says how long the way is, and, where that limits a run, which lag makes up for it.
    ///
    /// An update needs rollouts that were made with the weights of `lag` updates before. Weights and rollouts take a round trip
    /// each, so `lag` updates take two round trips at least.
    fn advice(self) -> String {
        let ms = |time: Duration| format!("{:.1} ms", time.as_secs_f64() * 1e3);
        let shown = ms(self.round_trip);
        if self.round_trip < SHORT_TRIP {
            return shown;
        }
        let rate = 1.0 / (2.0 * self.round_trip.as_secs_f64());
        let (one, eight) = (rate, 8.0 * rate);
        let needed = self.update.map_or_else(String::new, |update| {
            let lag = lag_needed(self.round_trip, update);
            format!(
                "; an update trains for {}, for which learner.lag = {lag} is needed",
                ms(update)
            )
        });
        format!(
            "{shown}: with learner.lag = 1 at most {one:.0} updates a second, with 8 at most {eight:.0}{needed}; same seed, same bits as \
             well"
        )
    }
}

/// Returns the smallest lag at which the way does not hold up updates that take so long, or the largest that is allowed.
fn lag_needed(round_trip: Duration, update: Duration) -> u64 {
    let lag = (2 * round_trip.as_nanos()).div_ceil(update.as_nanos().max(1));
    u64::try_from(lag).unwrap_or(u64::MAX).clamp(1, MAX_LAG)
}

/// Returns how long an update of a run trains, in the middle of all, from what a page knows of it; `None` before the first.
fn update_time(page: &Value) -> Option<Duration> {
    let longest = page["history"]["scalars"]["system/train_seconds"]["max"].as_array()?;
    let mut seconds: Vec<f64> = longest.iter().filter_map(Value::as_f64).collect();
    seconds.sort_by(f64::total_cmp);
    let middle = seconds.get(seconds.len() / 2)?;
    Duration::try_from_secs_f64(*middle).ok().filter(|time| !time.is_zero())
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
    // A link that leads nowhere is there, and in the way.
    let there = wanted.ancestors().find(|path| path.symlink_metadata().is_ok());
    let directory = there.filter(|path| !path.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let refused = || format!("`run.directory` {}: nothing can be written there", wanted.display());
    tempfile::tempfile_in(directory).with_context(refused).map(|_file| ())
}

/// Lists the runs at an address, and measures the way to the first one's learner, as far as we may ask it.
async fn look(args: &CheckArgs) -> Result<(Vec<String>, Option<LearnerLine>), Failure> {
    let settings = connect_settings(&args.connect, &args.tls, args.connect_timeout, &Role::ALL);
    let settings = settings.blame(ExitCode::WrongInput)?;
    let (link, _events) = ObserverLink::open(&settings).await.map_err(dialling_failure)?;
    let runs = link.runs().await.blame(ExitCode::PeerLost)?;
    let mut line = None;
    if let Some(run) = runs.first()
        && let Ok(round_trip) = link.round_trip(run).await
    {
        let limits = round_trip >= SHORT_TRIP;
        let update = if limits { trained_for(&settings, run).await } else { None };
        line = Some(LearnerLine { round_trip, update });
    }
    link.close().await.blame(ExitCode::PeerLost)?;
    if runs.is_empty() {
        let at = args.connect.join(", ");
        let error = anyhow::anyhow!("someone answers at {at}, but no learner is there");
        return Err(Failure::of(ExitCode::PeerLost, error));
    }
    Ok((runs.iter().map(ToString::to_string).collect(), line))
}

/// Asks a run's learner how long its updates train; `None` where it has made none, or we may not ask.
async fn trained_for(settings: &ConnectSettings, run: &RunName) -> Option<Duration> {
    let attachment = Attachment::open(settings, Some(run.clone())).await.ok()?;
    let page = Page::new(run.as_str(), clock::unix_seconds);
    attachment.look_once(&page, Duration::ZERO).await.ok()?;
    update_time(&page.with(|view, now| view.json(now)))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn the_lag_that_is_needed_covers_two_round_trips_with_updates() {
        let needed = |trip: u64, update: u64| {
            lag_needed(Duration::from_millis(trip), Duration::from_millis(update))
        };
        assert_eq!(needed(100, 24), 9);
        assert_eq!((needed(100, 25), needed(100, 50)), (8, 4), "not one more than that");
        assert_eq!((needed(5, 400), needed(2_000, 1)), (1, MAX_LAG), "as far as is allowed");
        assert_eq!(lag_needed(Duration::from_millis(5), Duration::ZERO), MAX_LAG);
    }

    #[test]
    fn a_slow_line_is_told_with_the_lag_that_its_updates_need() {
        let told = |trip: u64, update: Option<u64>| {
            let round_trip = Duration::from_millis(trip);
            LearnerLine { round_trip, update: update.map(Duration::from_millis) }.advice()
        };
        assert_eq!(told(4, Some(1)), "4.0 ms");
        let unknown = "100.0 ms: with learner.lag = 1 at most 5 updates a second, with 8 at most 40; same seed, same bits as well";
        assert_eq!(told(100, None), unknown);
        let known = unknown.replace(
            "; same",
            "; an update trains for 24.0 ms, for which learner.lag = 9 is needed; same",
        );
        assert_eq!(told(100, Some(24)), known);
    }

    #[test]
    fn an_updates_time_is_that_in_the_middle_of_all() {
        let page = |seconds: Value| json!({"history": {"scalars": {"system/train_seconds": {"max": seconds}}}});
        assert_eq!(update_time(&page(json!([9.0, 0.02, 0.024]))), Some(Duration::from_millis(24)));
        assert_eq!(update_time(&page(json!([]))), None);
        assert_eq!(update_time(&json!({"history": {"scalars": {}}})), None);
    }
}
