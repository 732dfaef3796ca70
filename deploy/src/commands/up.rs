//! `leadtime up`: a run with its learner and actors on this machine, with what is wanted beside it.

use std::ffi::OsString;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use leadtime_certs::Role;
use leadtime_config::Config;
use leadtime_process::TraceFile;
use leadtime_proto::RunName;
use leadtime_runs::launch::{Launch, LearnerPlace};
use leadtime_runs::{Naming, Placement, Tasks, clock};
use leadtime_watch::Page;
use tokio::time::sleep;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use super::lag;
use super::launch::{goes_on, launch_or_drain};
use super::watch::{PageServer, beside};
use crate::cli::{StopAfter, UpArgs};
use crate::credentials::{check_listening, guard_options};
use crate::ending::{Watch, drain_on_request, unless_drained, watch};
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output::{self, DRAW, EVALUATE, REPORT};

pub(super) async fn up(tasks: &Tasks, args: &UpArgs, options: &[OsString]) -> Result<(), Failure> {
    let mut config = args.run.load(tasks, &args.source).blame(ExitCode::WrongInput)?;
    check_listening(&args.listen, &args.guard, Role::Learner).blame(ExitCode::WrongInput)?;
    let shutdown = watch(Watch::SignalsAsSupervisor).blame(ExitCode::Failed)?;
    let drained = drain_on_request(&shutdown).blame(ExitCode::Failed)?;
    let beside = match &args.watch {
        Some(http) => Some(Arc::new(BesidePage::bind(tasks, http, args).await?)),
        None if args.access.token.is_some() => {
            return Err(Failure::input("--token is for the page of the run: add --watch ADDRESS"));
        }
        None => None,
    };
    let placement = if args.pin { place(&config, args.actors) } else { Placement::default() };
    if args.choose_lag {
        let chosen = lag::choose(tasks, args, &config, &placement, &shutdown).await;
        let Some(lag) = unless_drained(chosen, &drained)? else { return Ok(()) };
        let source = args.source.changed(&[lag]);
        config = args.run.load(tasks, &source).blame(ExitCode::WrongInput)?;
    }
    let told = beside.clone();
    let observe = move |endpoint: &str, run: &RunName, _: &Path| {
        if let Some(beside) = &told {
            beside.begin(endpoint, run);
        }
    };
    let guard = guard_options(&args.guard);
    let trace = args.run.trace.file.as_deref();
    let made = TraceFile::create(trace).blame(ExitCode::WrongInput)?;
    let what = Launch {
        observer: beside.is_some().then_some(&observe as &LearnerPlace),
        listen: &args.listen,
        guard: &guard,
        fork: args.run.fork.as_deref(),
        stop_after: args.run.stop_after.and_then(StopAfter::amount),
        stop_in: args.run.stop_after.and_then(StopAfter::time),
        changes: args.run.change.iter().map(ToString::to_string).collect(),
        metrics_to: args.run.metrics_to.as_deref(),
        trace,
        placement,
        status: args.status.as_deref(),
        learner_stdout: true,
        json: args.json,
        options,
        ..Launch::new(Naming::Resume, args.actors)
    };
    let launched = launch_or_drain(&config, &what, &shutdown, &drained).await;
    if let Some(beside) = &beside {
        beside.end().await;
    }
    if let Some(told) = made.and_then(TraceFile::finish) {
        output::note(&told);
    }
    let run = launched?;
    if !goes_on(&run, &what) {
        output::next(&run, &[EVALUATE, DRAW, REPORT]);
    }
    Ok(())
}

/// Gives learner and actors CPUs of their own, where there are enough, and says which.
fn place(config: &Config, n_actors: u32) -> Placement {
    match Placement::choose(config, n_actors as usize) {
        Ok(placement) => {
            output::note(&format!("Pinned: {placement}."));
            placement
        }
        Err(why) => {
            output::note(&format!("Nothing is pinned: {why}."));
            Placement::default()
        }
    }
}

/// How long the page waits for the learner's last words after it has ended, and the pause between two looks.
const LAST_WORDS: Duration = Duration::from_millis(500);
const LOOK_PAUSE: Duration = Duration::from_millis(20);

/// The page that is served beside a run.
struct BesidePage {
    tasks: Tasks,
    stop: CancellationToken,
    /// Taken when the run begins.
    server: Mutex<Option<PageServer>>,
    page: Mutex<Option<Arc<Page>>>,
    working: TaskTracker,
}

impl BesidePage {
    async fn bind(tasks: &Tasks, http: &str, args: &UpArgs) -> Result<Self, Failure> {
        let server = PageServer::bind("--watch", http, &args.access).await?;
        server.announce(args.json);
        let (stop, working) = (CancellationToken::new(), TaskTracker::new());
        let (tasks, server, page) = (tasks.clone(), Mutex::new(Some(server)), Mutex::default());
        Ok(Self { tasks, stop, server, page, working })
    }

    /// Serves the page of a run whose learner will be reached at this address.
    fn begin(&self, endpoint: &str, run: &RunName) {
        let server = self.server.lock().unwrap_or_else(PoisonError::into_inner).take();
        let Some(server) = server else { return };
        let page = Page::new(run.as_str(), clock::unix_seconds);
        *self.page.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::clone(&page));
        let serving = server.serve(&page, &self.stop);
        self.working.spawn(serving);
        let (tasks, stop) = (self.tasks.clone(), self.stop.clone());
        self.working.spawn(beside(tasks, page, endpoint.to_owned(), run.clone(), stop));
    }

    /// Lets the page show how the run ended, and ends it.
    async fn end(&self) {
        let page = self.page.lock().unwrap_or_else(PoisonError::into_inner).clone();
        if let Some(page) = page {
            let deadline = Instant::now() + LAST_WORDS;
            while Instant::now() < deadline && !page.with(|view, now| view.is_over(now)) {
                sleep(LOOK_PAUSE).await;
            }
        }
        self.working.close();
        self.stop.cancel();
        self.working.wait().await;
    }
}
