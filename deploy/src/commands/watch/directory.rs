//! A run on this disk as the source of a page: a finished one, or one at work.

use std::convert::Infallible;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant, UNIX_EPOCH};

use anyhow::Context as _;
use leadtime_config::Config;
use leadtime_runs::history::{self, JournalTail};
use leadtime_runs::layout::read_config;
use leadtime_runs::prune::is_in_use;
use leadtime_runs::{BEST_POLICY, LAST_POLICY, LoadedPolicy, RunDirError, RunRecord, Tasks, clock};
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

/// A file as it was read: its size and when it was written.
type SeenFile = (u64, Option<Duration>);

/// A run's directory, and how far it was read.
#[derive(Debug)]
pub(super) struct RunSource {
    directory: PathBuf,
    about: Value,
    /// `None` where another release wrote it.
    config: Option<Config>,
    config_seen: Option<SeenFile>,
    tail: JournalTail,
    /// Whether no process had the run open when its locks were tried.
    is_left: bool,
    tried_at: Option<Instant>,
    /// The policy that plays.
    policy: Option<SeenFile>,
}

/// The thread that plays the run's policies, and what it plays.
struct PlannedFlight {
    flight: FlightThread,
    plan: Result<FlightPlan, String>,
}

impl RunSource {
    /// Opens a run's directory.
    pub(super) fn open(tasks: &Tasks, directory: &Path) -> Result<Self, Failure> {
        // Seen before it is read: one that is written meanwhile is read again.
        let config_seen = seen(&config_file(directory));
        let (about, config) = described(tasks, directory).blame(ExitCode::WrongInput)?;
        let directory = directory.to_owned();
        let tail = JournalTail::new(&directory);
        let (is_left, tried_at, policy) = (false, None, None);
        Ok(Self { directory, about, config, config_seen, tail, is_left, tried_at, policy })
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
        let mut play = if plays {
            let watcher: Arc<Page> = Arc::clone(page);
            let flight = FlightThread::start(watcher).blame(ExitCode::Failed)?;
            let plan = self.plan(tasks);
            flight.plan(plan.clone());
            Some(PlannedFlight { flight, plan })
        } else {
            None
        };
        let mut ticks = interval(LOOK_PAUSE);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            ticks.tick().await;
            self.look(tasks, page, play.as_mut())?;
        }
    }

    /// Plans to play the run's task, or says why it cannot be played.
    fn plan(&self, tasks: &Tasks) -> Result<FlightPlan, String> {
        let config = self.config.as_ref().ok_or("another release made this run".to_owned());
        config.and_then(|config| flight_plan(tasks, config))
    }

    /// Reads the configuration again once it was written anew: the run goes on for longer, or with other settings.
    fn follow_config(&mut self, tasks: &Tasks, page: &Page, play: Option<&mut PlannedFlight>) {
        let found = seen(&config_file(&self.directory));
        if found.is_none() || found == self.config_seen {
            return;
        }
        match described(tasks, &self.directory) {
            Ok((about, config)) => (self.about, self.config) = (about, config),
            Err(error) => return tracing::debug!(%error, "configuration not read"),
        }
        self.config_seen = found;
        page.with(|view, now| view.about(self.about.clone(), now));
        if let Some(play) = play {
            // The policy is given anew, with this plan.
            (play.plan, self.policy) = (self.plan(tasks), None);
        }
    }

    fn look(
        &mut self,
        tasks: &Tasks,
        page: &Page,
        mut play: Option<&mut PlannedFlight>,
    ) -> Result<(), Failure> {
        self.follow_config(tasks, page, play.as_deref_mut());
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
        let found = seen(path);
        if found.is_none() || self.policy == found {
            return;
        }
        self.policy = found;
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

/// Returns a file's size and when it was written; `None` if it cannot be looked at.
fn seen(path: &Path) -> Option<SeenFile> {
    let found = fs::metadata(path).ok()?;
    let written = found.modified().ok().and_then(|at| at.duration_since(UNIX_EPOCH).ok());
    Some((found.len(), written))
}

fn config_file(directory: &Path) -> PathBuf {
    directory.join("config.toml")
}

/// Reads what the run is, and its configuration if this release can read it.
fn described(tasks: &Tasks, directory: &Path) -> Result<(Value, Option<Config>), RunDirError> {
    let table = read_config(directory)?;
    let place = format!("the configuration in {}", directory.display());
    let config = Config::stored(&place, &table.to_string(), &[], &tasks.registry).ok();
    let name = name_of(directory);
    let about = match &config {
        Some(config) => history::about(config, &name, directory),
        None => serde_json::json!({"run": name, "config": table.to_string()}),
    };
    Ok((about, config))
}

#[cfg(test)]
mod tests {
    use leadtime_config::{ConfigSource, Override};

    use super::*;

    #[test]
    fn a_run_that_goes_on_for_longer_is_shown_with_its_new_length() {
        let (tasks, place) = (Tasks::new(), tempfile::tempdir().unwrap());
        let directory = place.path().join("r");
        fs::create_dir(&directory).unwrap();
        let write = |steps: &str| {
            let steps = format!("learner.total_steps={steps}");
            let set = vec![Override::parse(&steps).unwrap()];
            let source = ConfigSource { set, ..ConfigSource::default() };
            let config = tasks.configure(Some(Path::new("cartpole")), source).unwrap();
            fs::write(config_file(&directory), config.table.to_string()).unwrap();
        };
        write("51200");
        let mut source = RunSource::open(&tasks, &directory).unwrap();
        let page = Page::new(source.name(), clock::unix_seconds);
        let total = |page: &Page| {
            page.with(|view, now| view.state_json(now))["total_updates"].as_u64().unwrap()
        };
        source.look(&tasks, &page, None).unwrap();
        assert_eq!(total(&page), 0, "what it is was not shown yet");
        source.show(&page).unwrap();
        assert_eq!(total(&page), 100);
        write("5120000");
        source.look(&tasks, &page, None).unwrap();
        assert_eq!(total(&page), 10_000);
    }
}
