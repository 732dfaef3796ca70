//! A run on this disk as the source of a page: a finished one, or one that somebody works on.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use leadtime_config::Config;
use leadtime_runs::history::{self, JournalTail};
use leadtime_runs::layout::read_config;
use leadtime_runs::{BEST_POLICY, LAST_POLICY, LoadedPolicy, RunRecord, Tasks, clock};
use leadtime_watch::{EVENT_PAUSE, FlightThread, Page};
use serde_json::Value;
use tokio::time::{MissedTickBehavior, interval};

use super::{flight_plan, name_of};
use crate::exit::{Blame as _, ExitCode, Failure};

/// Points per curve.
const N_POINTS: usize = 2_000;
/// Looks at the directory are so many flushes apart.
const LOOK_EVERY: u32 = 5;
/// Who works on a run writes at least so often.
const QUIET: Duration = Duration::from_mins(2);

/// A run's directory, and how far it was read.
#[derive(Debug)]
pub(super) struct RunSource {
    directory: PathBuf,
    about: Value,
    /// `None` where another release wrote it.
    config: Option<Config>,
    tail: JournalTail,
    /// The policy that plays: its size and when it was written.
    policy: Option<(u64, Option<Duration>)>,
}

impl RunSource {
    /// Opens a run's directory.
    pub(super) fn open(tasks: &Tasks, directory: &Path) -> Result<Self, Failure> {
        let table = read_config(directory).blame(ExitCode::WrongInput)?;
        let place = format!("the configuration in {}", directory.display());
        let config = Config::stored(&place, &table.to_string(), &[], &tasks.registry).ok();
        let name = name_of(directory);
        let about = match &config {
            Some(config) => history::about(config, &name, directory),
            None => serde_json::json!({"run": name, "config": table.to_string()}),
        };
        let directory = directory.to_owned();
        let tail = JournalTail::new(&directory);
        Ok(Self { directory, about, config, tail, policy: None })
    }

    /// Returns the run's name.
    pub(super) fn name(&self) -> &str {
        self.about["run"].as_str().unwrap_or_default()
    }

    /// Shows what is there now.
    pub(super) fn show(&self, page: &Page) -> Result<(), Failure> {
        let history = history::read(&self.directory, 0, N_POINTS)
            .with_context(|| format!("reading {}/metrics.jsonl", self.directory.display()))
            .blame(ExitCode::WrongInput)?;
        let ended = self.ended();
        page.with(|view, now| {
            view.about(self.about.clone(), now);
            view.history(&history, now);
            view.on_disk(ended, now);
        });
        Ok(())
    }

    /// Returns how the run ended; `None` while somebody works on it.
    fn ended(&self) -> Option<&'static str> {
        let is_finished = RunRecord::read(&self.directory).is_ok_and(|it| it.result.is_some());
        let age = clock::age(&self.directory.join("metrics.jsonl"));
        let is_quiet = age.is_none_or(|age| age > QUIET);
        if is_finished { Some("finished") } else { is_quiet.then_some("stopped") }
    }

    /// Looks at the directory again and again.
    pub(super) async fn follow(
        mut self,
        tasks: &Tasks,
        page: &Arc<Page>,
        plays: bool,
    ) -> Result<(), Failure> {
        self.tail.skip_to_end();
        let flight = if plays {
            let watcher: Arc<Page> = Arc::clone(page);
            Some(FlightThread::start(watcher).blame(ExitCode::Failed)?)
        } else {
            None
        };
        if let Some(flight) = &flight {
            let config = self.config.as_ref().ok_or("another release made this run".to_owned());
            flight.plan(config.and_then(|config| flight_plan(tasks, config)));
        }
        let mut ticks = interval(EVENT_PAUSE);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        for tick in 0_u32.. {
            ticks.tick().await;
            if tick % LOOK_EVERY == 0 {
                self.look(tasks, page, flight.as_ref())?;
            }
            page.flush(Instant::now());
        }
        Ok(())
    }

    fn look(
        &mut self,
        tasks: &Tasks,
        page: &Page,
        flight: Option<&FlightThread>,
    ) -> Result<(), Failure> {
        match self.tail.new_lines() {
            Ok(Some(lines)) => page.with(|view, now| {
                for line in lines {
                    view.update(line, now);
                }
            }),
            // It was rewound: a learner went on from an earlier checkpoint.
            Ok(None) => self.show(page)?,
            Err(error) => tracing::debug!(%error, "metrics not read"),
        }
        let ended = self.ended();
        page.with(|view, now| view.on_disk(ended, now));
        if let Some(flight) = flight.filter(|_| page.n_clients() > 0) {
            self.offer_policy(tasks, flight);
        }
        Ok(())
    }

    /// Gives the newest policy to whoever plays it, if it is another one than before.
    fn offer_policy(&mut self, tasks: &Tasks, flight: &FlightThread) {
        let files = [LAST_POLICY, BEST_POLICY].map(|name| self.directory.join(name));
        let Some(path) = files.iter().find(|path| path.is_file()) else { return };
        let Ok(found) = fs::metadata(path) else { return };
        let written =
            found.modified().ok().and_then(|at| at.duration_since(std::time::UNIX_EPOCH).ok());
        let seen = Some((found.len(), written));
        if self.policy == seen {
            return;
        }
        self.policy = seen;
        match LoadedPolicy::load(&tasks.registry, Path::new("."), path, &[]) {
            Ok(policy) => match fs::read(path) {
                Ok(bytes) => flight.policy(policy.n_updates, bytes),
                Err(error) => tracing::debug!(%error, "policy not read"),
            },
            Err(error) => flight.plan(Err(format!("the policy cannot be read: {error}"))),
        }
    }
}
