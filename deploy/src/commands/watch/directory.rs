//! A run on this disk as the source of a page: a finished one, or one at work.

use std::convert::Infallible;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use leadtime_config::Config;
use leadtime_runs::history::{self, JournalTail};
use leadtime_runs::layout::read_config;
use leadtime_runs::prune::is_in_use;
use leadtime_runs::{BEST_POLICY, LAST_POLICY, LoadedPolicy, RunRecord, Tasks, clock};
use leadtime_watch::{FlightPlan, FlightThread, MAX_POINTS, Page};
use serde_json::Value;
use tokio::time::{MissedTickBehavior, interval};

use super::{flight_plan, name_of};
use crate::exit::{Blame as _, ExitCode, Failure};

/// Pause between two looks at the directory.
const LOOK_PAUSE: Duration = Duration::from_secs(1);
/// A run whose metrics are older may have been left, which its locks tell.
const QUIET: Duration = Duration::from_secs(10);
/// The shortest time between two tries of its locks: a process that wants one at that very moment is refused.
const LOCK_PAUSE: Duration = Duration::from_secs(10);

/// A run's directory, and how far it was read.
#[derive(Debug)]
pub(super) struct RunSource {
    directory: PathBuf,
    about: Value,
    /// `None` where another release wrote it.
    config: Option<Config>,
    tail: JournalTail,
    /// Whether no process had the run open when its locks were tried.
    is_left: bool,
    tried_at: Option<Instant>,
    /// The policy that plays: its size and when it was written.
    policy: Option<(u64, Option<Duration>)>,
}

/// The thread that plays the run's policies, and what it plays.
struct PlannedFlight {
    flight: FlightThread,
    plan: Result<FlightPlan, String>,
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
        Ok(Self { directory, about, config, tail, is_left: false, tried_at: None, policy: None })
    }

    /// Returns the run's name.
    pub(super) fn name(&self) -> &str {
        self.about["run"].as_str().unwrap_or_default()
    }

    /// Shows what is there now.
    pub(super) fn show(&mut self, page: &Page) -> Result<(), Failure> {
        let (history, (ended, books)) = (self.read_history()?, self.ended());
        page.with(|view, now| {
            view.about(self.about.clone(), now);
            view.history(&history, now);
            view.on_disk(ended, now);
            view.settle(books);
        });
        Ok(())
    }

    /// Reads the history; what is appended from now on comes from the tail.
    fn read_history(&mut self) -> Result<Value, Failure> {
        self.tail.skip_to_end();
        let history = history::read(&self.directory, 0, MAX_POINTS)
            .with_context(|| format!("reading {}/metrics.jsonl", self.directory.display()))
            .blame(ExitCode::WrongInput)?;
        if history["skipped"] != 0 {
            // A line was being written: the tail may stand in the middle of it. The page knows the lines before.
            self.tail = JournalTail::new(&self.directory);
        }
        Ok(history)
    }

    /// Returns how the run ended, `None` while it is at work, and its books if it is finished.
    fn ended(&mut self) -> (Option<&'static str>, Option<Value>) {
        if let Some(result) = RunRecord::read(&self.directory).ok().and_then(|it| it.result) {
            return (Some("finished"), Some(result.books));
        }
        let age = clock::age(&self.directory.join("metrics.jsonl"));
        let is_quiet = age.is_none_or(|age| age > QUIET);
        if is_quiet && self.tried_at.is_none_or(|at| at.elapsed() >= LOCK_PAUSE) {
            (self.is_left, self.tried_at) = (!is_in_use(&self.directory), Some(Instant::now()));
        }
        ((is_quiet && self.is_left).then_some("stopped"), None)
    }

    /// Looks at the directory again and again, for as long as it can be read.
    pub(super) async fn follow(
        mut self,
        tasks: &Tasks,
        page: &Arc<Page>,
        plays: bool,
    ) -> Result<Infallible, Failure> {
        let play = if plays {
            let watcher: Arc<Page> = Arc::clone(page);
            let flight = FlightThread::start(watcher).blame(ExitCode::Failed)?;
            let config = self.config.as_ref().ok_or("another release made this run".to_owned());
            let plan = config.and_then(|config| flight_plan(tasks, config));
            flight.plan(plan.clone());
            Some(PlannedFlight { flight, plan })
        } else {
            None
        };
        let mut ticks = interval(LOOK_PAUSE);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            ticks.tick().await;
            self.look(tasks, page, play.as_ref())?;
        }
    }

    fn look(
        &mut self,
        tasks: &Tasks,
        page: &Page,
        play: Option<&PlannedFlight>,
    ) -> Result<(), Failure> {
        match self.tail.new_lines() {
            Ok(Some(lines)) => page.with(|view, now| {
                for line in lines {
                    view.update(line, now);
                }
            }),
            // It was rewound: a learner went on from an earlier checkpoint.
            Ok(None) => {
                let history = self.read_history()?;
                page.with(|view, now| {
                    view.rewound(history["to"].as_u64().unwrap_or(0), now);
                    view.history(&history, now);
                });
            }
            Err(error) => tracing::debug!(%error, "metrics not read"),
        }
        let (ended, books) = self.ended();
        page.with(|view, now| {
            view.on_disk(ended, now);
            view.settle(books);
        });
        if let Some(play) = play.filter(|_| page.n_watching() > 0) {
            self.offer_policy(tasks, play);
        }
        Ok(())
    }

    /// Gives the newest policy to the playthrough, if it is another one than before.
    fn offer_policy(&mut self, tasks: &Tasks, play: &PlannedFlight) {
        let PlannedFlight { flight, plan } = play;
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
                Ok(bytes) => {
                    // One before it may have been unreadable, which ended the plan.
                    flight.plan(plan.clone());
                    flight.policy(policy.n_updates, bytes);
                }
                Err(error) => tracing::debug!(%error, "policy not read"),
            },
            Err(error) => flight.plan(Err(format!("the policy cannot be read: {error}"))),
        }
    }
}
